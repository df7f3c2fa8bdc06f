/** What is seen before there is a scan: a shell that grows in rounds, like a scan that is
 * densified. Made by formula, so that nothing is loaded for it. */

import type { Frame } from "./frame";

const TURNS = 2.6;
const GROWTH = 0.19;
const WIDTH = 0.62;
const ROUNDS = 9;
const FIRST = 2600;
const EACH = 1500;

/** The shell after so many rounds, 0 to `heroRounds`. */
export function heroFrame(round: number): Frame {
  const count = FIRST + EACH * round;
  const random = generator(7);
  const positions = new Uint16Array(3 * count);
  const born = new Uint8Array(count);
  for (let i = 0; i < count; i++) {
    const [x, y, z] = shellPoint(random(), random());
    positions.set([code(x), code(y), code(z)], 3 * i);
    born[i] = i < FIRST ? 0 : Math.floor((i - FIRST) / EACH) + 1;
  }
  return {
    kind: "points",
    sequence: round,
    total: count,
    round,
    rounds: ROUNDS,
    origin: [-0.5, -0.5, -0.5],
    scale: 1,
    positions,
    indices: new Uint32Array(0),
    born,
  };
}

export const heroRounds = ROUNDS;
export const heroPoints = FIRST + EACH * ROUNDS;

/** A point of a logarithmic spiral tube, more where it is wide. */
function shellPoint(along: number, around: number): [number, number, number] {
  const turn = 2 * Math.PI * TURNS * along ** 0.42;
  const reach = Math.exp(GROWTH * (turn - 2 * Math.PI * TURNS)) / 2.35;
  const angle = 2 * Math.PI * around;
  const rib = 1 + 0.025 * Math.cos(9 * turn);
  const wide = WIDTH * reach * rib;
  const from = reach + wide * Math.cos(angle);
  return [from * Math.cos(turn) + 0.06, 0.8 * wide * Math.sin(angle), from * Math.sin(turn) + 0.05];
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
