/** Corners of triangles, each once: files without shared vertices name every corner many times. */

import type { Sink } from "./collector";

/** Passes on what has not been there before. Coordinates count as equal in single precision. */
export class Distinct implements Sink {
  hasColors = false;
  hasNormals = false;
  private readonly known: Float32Array;
  /** Places in `known`, one more than they are; 0 where nothing is. */
  private readonly table: Int32Array;
  private readonly bits = new Int32Array(3);
  private readonly values = new Float32Array(this.bits.buffer);
  private count = 0;

  /** most: how many points will come at most. */
  constructor(
    private readonly inner: Sink,
    most: number,
  ) {
    this.known = new Float32Array(3 * most);
    this.table = new Int32Array(2 ** Math.ceil(Math.log2(2 * most + 2)));
  }

  add(x: number, y: number, z: number): void {
    this.values[0] = x + 0; // -0 becomes 0
    this.values[1] = y + 0;
    this.values[2] = z + 0;
    const mask = this.table.length - 1;
    for (let at = this.hash() & mask; ; at = (at + 1) & mask) {
      const place = this.table[at];
      if (place === 0) {
        this.table[at] = ++this.count;
        this.known.set(this.values, 3 * (this.count - 1));
        this.inner.add(x, y, z);
        return;
      }
      if (this.isAt(3 * (place - 1))) return;
    }
  }

  private isAt(start: number): boolean {
    return this.values.every((value, axis) => Object.is(value, this.known[start + axis]));
  }

  private hash(): number {
    let mixed = 0;
    for (const bits of this.bits) {
      mixed = Math.imul(mixed ^ bits, 0x9e3779b1);
      mixed ^= mixed >>> 15;
    }
    return mixed;
  }
}
