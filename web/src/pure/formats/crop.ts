/** A part of a scan as a file of its own. */

import type { Rgb } from "../colormap";
import { NoPreview, type Sink } from "./collector";

/** Corners of a box; what lies on its sides belongs to it. */
export interface Box {
  low: readonly number[];
  high: readonly number[];
}

const TOGETHER = 1 << 15; // points

export function isInside(box: Box, x: number, y: number, z: number): boolean {
  const { low, high } = box;
  return x >= low[0] && x <= high[0] && y >= low[1] && y <= high[1] && z >= low[2] && z <= high[2];
}

/** Writes the points inside a box as binary PLY: in double precision, so that map coordinates keep
 * their millimetres. */
export class Cutter implements Sink {
  hasColors = false;
  hasNormals = false;
  private count = 0;
  private readonly parts: ArrayBuffer[] = [];
  private part = new DataView(new ArrayBuffer(0));
  private filled = 0;

  constructor(private readonly box: Box) {}

  add(x: number, y: number, z: number, color?: Rgb): void {
    if (!isInside(this.box, x, y, z)) return;
    if (this.filled === this.part.byteLength) this.next();
    const { part, filled } = this;
    part.setFloat64(filled, x, true);
    part.setFloat64(filled + 8, y, true);
    part.setFloat64(filled + 16, z, true);
    if (this.hasColors) {
      for (let i = 0; i < 3; i++) part.setUint8(filled + 24 + i, Math.round(color?.[i] ?? 0));
    }
    this.filled += this.stride;
    this.count++;
  }

  /** @throws NoPreview when the box is empty. */
  file(): Blob {
    if (this.count === 0) throw new NoPreview("There is no point in the box.");
    const colors = this.hasColors ? ["red", "green", "blue"] : [];
    const header = [
      "ply",
      "format binary_little_endian 1.0",
      `element vertex ${this.count}`,
      ...["x", "y", "z"].map((name) => `property double ${name}`),
      ...colors.map((name) => `property uchar ${name}`),
      "end_header\n",
    ].join("\n");
    return new Blob([header, ...this.parts, this.part.buffer.slice(0, this.filled)]);
  }

  private get stride(): number {
    return this.hasColors ? 27 : 24;
  }

  private next(): void {
    if (this.filled > 0) this.parts.push(this.part.buffer as ArrayBuffer);
    this.part = new DataView(new ArrayBuffer(TOGETHER * this.stride));
    this.filled = 0;
  }
}
