/** What is seen before there is a scan: a shell that grows along its spiral. Made by formula, so
 * that nothing is loaded for it. */

import type { Frame } from "./frame";

const TURNS = 3.1;
const GROWTH = 0.175;
const WIDTH = 0.5; // of the tube, for a spiral of radius 1
const POINTS = 26_000;

export const heroRounds = 24;
export const heroPoints = POINTS;

/** The shell after so many rounds, 1 to `heroRounds`. */
export function heroFrame(round: number): Frame {
  const random = generator(7);
  // even over the surface, which grows with the square of the radius
  const wide = Math.exp(2 * GROWTH * 2 * Math.PI * TURNS) - 1;
  const turns = Array.from(
    { length: POINTS },
    () => Math.log(1 + random() * wide) / (2 * GROWTH),
  ).sort((first, second) => first - second);
  const count = Math.round(
    (POINTS * (Math.exp((3.2 * round) / heroRounds) - 1)) / (Math.exp(3.2) - 1),
  );
  const positions = new Uint16Array(3 * count);
  const born = new Uint8Array(count);
  for (let i = 0; i < count; i++) {
    positions.set(shellPoint(turns[i], random()).map(code), 3 * i);
    born[i] = 1 + Math.floor((heroRounds - 1) * (turns[i] / turns[POINTS - 1]) ** 1.4);
  }
  return {
    kind: "points",
    sequence: round,
    total: count,
    round,
    rounds: heroRounds,
    origin: [-0.5, -0.5, -0.5],
    scale: 1,
    positions,
    indices: new Uint32Array(0),
    born,
  };
}

/** A point of a tube along a logarithmic spiral. */
function shellPoint(turn: number, around: number): [number, number, number] {
  const reach = Math.exp(GROWTH * (turn - 2 * Math.PI * TURNS)) / 2.5;
  const angle = 2 * Math.PI * around;
  const wide = WIDTH * reach * (1 + 0.03 * Math.cos(11 * turn));
  const from = 0.86 * reach + wide * Math.cos(angle);
  const place = turn - 2 * Math.PI * TURNS + 0.6;
  return [
    from * Math.cos(place) - 0.04,
    0.62 * wide * Math.sin(angle),
    from * Math.sin(place) + 0.04,
  ];
}

function code(value: number): number {
  return Math.round(Math.min(Math.max(value + 0.5, 0), 1) * 65535);
}

/** The same numbers each time (mulberry32). */
function generator(seed: number): () => number {
  let state = seed;
  return () => {
    state = (state + 0x6d2b79f5) | 0;
    let mixed = Math.imul(state ^ (state >>> 15), 1 | state);
    mixed = (mixed + Math.imul(mixed ^ (mixed >>> 7), 61 | mixed)) ^ mixed;
    return ((mixed ^ (mixed >>> 14)) >>> 0) / 4294967296;
  };
}
