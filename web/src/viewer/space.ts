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

/** Where the numbers of points stand in the scene. */
interface Placed {
  positions: Float32Array | Uint16Array;
  origin: Vector;
  scale: number;
}

const ENOUGH = 4000; // points, to frame a picture by

/** An even choice of points, n x 3, in the scene. */
export function sampleOf({ positions, origin, scale }: Placed, space: Space): Float32Array | null {
  const step = 3 * Math.ceil(positions.length / 3 / ENOUGH);
  if (positions.length === 0) return null;
  const start = placed(space, origin);
  const unit = scale / space.extent / (positions instanceof Uint16Array ? 65535 : 1);
  const sample = new Float32Array(3 * Math.ceil(positions.length / step));
  for (let i = 0, at = 0; i < positions.length; i += step) {
    for (let axis = 0; axis < 3; axis++) sample[at++] = start[axis] + unit * positions[i + axis];
  }
  return sample;
}

/** The eight corners of a box, n x 3. */
export function cornersOf({ min, max }: { min: Corner; max: Corner }): Float32Array {
  const corners = Array.from({ length: 8 }, (_, i) => [
    i & 1 ? max.x : min.x,
    i & 2 ? max.y : min.y,
    i & 4 ? max.z : min.z,
  ]);
  return Float32Array.from(corners.flat());
}

interface Corner {
  x: number;
  y: number;
  z: number;
}
