/** Points on their way from a file to the screen: all are counted, an even choice is kept. */

import type { Rgb } from "../colormap";

export interface Scan {
  format: string;
  /** Finite points in the file. */
  total: number;
  /** Points that are not finite. */
  dropped: number;
  low: [number, number, number];
  high: [number, number, number];
  hasColors: boolean;
  hasNormals: boolean;
  /** Relative to `origin`, n x 3. */
  positions: Float32Array;
  colors: Uint8Array | null;
  origin: [number, number, number];
  /** Why there is nothing to draw although the file can be read; null where there is. */
  note: string | null;
}

/** Takes the points of a file one after the other. */
export interface Sink {
  hasColors: boolean;
  hasNormals: boolean;
  /** color: each part 0 to 255. */
  add(x: number, y: number, z: number, color?: Rgb): void;
}

/** Raised for files that cannot be previewed. The service decides whether it can read them. */
export class NoPreview extends Error {}

/** Keeps every k-th point; when there are too many, every second of those, and k doubles. */
export class Collector implements Sink {
  private positions: Float32Array;
  private colors: Uint8Array;
  private kept = 0;
  private stride = 1;
  private total = 0;
  private dropped = 0;
  private origin: [number, number, number] = [0, 0, 0];
  private readonly low: [number, number, number] = [Infinity, Infinity, Infinity];
  private readonly high: [number, number, number] = [-Infinity, -Infinity, -Infinity];
  hasColors = false;
  hasNormals = false;

  constructor(private readonly most: number) {
    this.positions = new Float32Array(3 * most);
    this.colors = new Uint8Array(3 * most);
  }

  add(x: number, y: number, z: number, color?: Rgb): void {
    if (!Number.isFinite(x + y + z)) {
      this.dropped++;
      return;
    }
    if (this.total === 0) this.origin = [x, y, z];
    this.widen(0, x);
    this.widen(1, y);
    this.widen(2, z);
    if (this.total++ % this.stride !== 0) return;
    if (this.kept === this.most) {
      this.halve();
      if ((this.total - 1) % this.stride !== 0) return;
    }
    const at = 3 * this.kept++;
    this.positions[at] = x - this.origin[0];
    this.positions[at + 1] = y - this.origin[1];
    this.positions[at + 2] = z - this.origin[2];
    if (color) this.colors.set(color, at);
  }

  /** @throws NoPreview when there is no point. */
  finish(format: string): Scan {
    if (this.total === 0) throw new NoPreview("There is no point in this file.");
    return {
      format,
      total: this.total,
      dropped: this.dropped,
      low: this.low,
      high: this.high,
      hasColors: this.hasColors,
      hasNormals: this.hasNormals,
      positions: this.positions.slice(0, 3 * this.kept),
      colors: this.hasColors ? this.colors.slice(0, 3 * this.kept) : null,
      origin: this.origin,
      note: null,
    };
  }

  private widen(axis: number, value: number): void {
    if (value < this.low[axis]) this.low[axis] = value;
    if (value > this.high[axis]) this.high[axis] = value;
  }

  private halve(): void {
    for (let i = 0; i < this.kept; i += 2) {
      this.positions.copyWithin((3 * i) / 2, 3 * i, 3 * i + 3);
      this.colors.copyWithin((3 * i) / 2, 3 * i, 3 * i + 3);
    }
    this.kept = Math.ceil(this.kept / 2);
    this.stride *= 2;
  }
}
