/** World coordinates to those of the scene, where the data is centred and about 1 large. The
 * difference is taken in double precision, so that map coordinates keep their millimetres. */

export type Vector = readonly [number, number, number];

export interface Space {
  centre: Vector;
  extent: number;
}

/** The space of a box. */
export function spaceOf(low: Vector, high: Vector): Space {
  const centre = low.map((value, i) => (value + high[i]) / 2) as unknown as Vector;
  const extent = Math.max(...high.map((value, i) => value - low[i])) || 1;
  return { centre, extent };
}

/** Where an origin lies in the scene. */
export function placed(space: Space, origin: Vector): [number, number, number] {
  return origin.map((value, i) => (value - space.centre[i]) / space.extent) as [
    number,
    number,
    number,
  ];
}
