/** Numbers at even steps: what PLY, PCD, NPY, LAS, STL and GLB have in common. */

import type { Rgb } from "../colormap";
import { NoPreview, type Sink } from "./collector";

export type NumberType = "i1" | "u1" | "i2" | "u2" | "i4" | "u4" | "f4" | "f8";

export interface Field {
  type: NumberType;
  /** Bytes from the beginning of a record. */
  at: number;
}

export interface Layout {
  /** Where the first record begins in the file. */
  start: number;
  count: number;
  stride: number;
  little: boolean;
  x: Field;
  y: Field;
  z: Field;
  /** Red, green and blue, 0 to `colorMost`. */
  color?: [Field, Field, Field];
  colorMost?: number;
  /** position = offset + scale * number */
  scale?: readonly number[];
  offset?: readonly number[];
}

/** A part of a file: `Blob.slice().arrayBuffer()`, or the same from memory. */
export type ReadPart = (from: number, to: number) => Promise<ArrayBuffer>;

const CHUNK = 1 << 23;

export const SIZES: Record<NumberType, number> = {
  i1: 1,
  u1: 1,
  i2: 2,
  u2: 2,
  i4: 4,
  u4: 4,
  f4: 4,
  f8: 8,
};

/** One number of every point, at even steps from `at` on. */
export interface Column {
  type: NumberType;
  at: number;
  step: number;
}

export type Three<T> = readonly [T, T, T];

/** What is known of points besides where their numbers are. */
export interface Meaning {
  little: boolean;
  colorMost?: number;
  scale?: readonly number[];
  offset?: readonly number[];
  /** Where a point comes to lie, after scale and offset. */
  place?: (x: number, y: number, z: number) => Three<number>;
  /** A part of a colour as the screen shows it, 0 to 255. */
  shade?: (value: number) => number;
}

/** Feeds all records to a sink.
 * @throws NoPreview when the file is shorter than it says.
 */
export async function readRecords(
  read: ReadPart,
  fileSize: number,
  layout: Layout,
  sink: Sink,
): Promise<void> {
  const { start, count, stride } = layout;
  if (start + count * stride > fileSize) {
    throw new NoPreview(`The file ends early: its header promises ${count} points.`);
  }
  const together = Math.max(1, Math.floor(CHUNK / stride));
  for (let first = 0; first < count; first += together) {
    const until = Math.min(count, first + together);
    const part = await read(start + first * stride, start + until * stride);
    takeAll(new DataView(part), until - first, layout, sink);
  }
}

function takeAll(view: DataView, count: number, layout: Layout, sink: Sink): void {
  const column = ({ type, at }: Field): Column => ({ type, at, step: layout.stride });
  const { x, y, z, color } = layout;
  takeColumns(view, count, [column(x), column(y), column(z)], mapped(color, column), layout, sink);
}

/** Feeds columns of numbers to a sink. */
export function takeColumns(
  view: DataView,
  count: number,
  axes: Three<Column>,
  colors: Three<Column> | null,
  meaning: Meaning,
  sink: Sink,
): void {
  const { little, scale = [1, 1, 1], offset = [0, 0, 0], place } = meaning;
  const [x, y, z] = axes.map((column) => getter(view, column, little));
  const shades = mapped(colors, (column) => getter(view, column, little));
  const bright = 255 / (meaning.colorMost ?? 255);
  const shade = meaning.shade ?? ((value: number) => value * bright);
  for (let i = 0; i < count; i++) {
    const at = [
      offset[0] + scale[0] * x(i * axes[0].step),
      offset[1] + scale[1] * y(i * axes[1].step),
      offset[2] + scale[2] * z(i * axes[2].step),
    ] as const;
    const color = colors && shades?.map((part, j) => shade(part(i * colors[j].step)));
    sink.add(...(place ? place(...at) : at), color ? (color as Rgb) : undefined);
  }
}

function mapped<A, B>(three: Three<A> | null | undefined, change: (one: A) => B): Three<B> | null {
  return three ? [change(three[0]), change(three[1]), change(three[2])] : null;
}

/** Reads one field of the record that begins at a byte. */
export function getter(view: DataView, field: Field, little: boolean): (at: number) => number {
  const from = field.at;
  switch (field.type) {
    case "i1":
      return (at) => view.getInt8(at + from);
    case "u1":
      return (at) => view.getUint8(at + from);
    case "i2":
      return (at) => view.getInt16(at + from, little);
    case "u2":
      return (at) => view.getUint16(at + from, little);
    case "i4":
      return (at) => view.getInt32(at + from, little);
    case "u4":
      return (at) => view.getUint32(at + from, little);
    case "f4":
      return (at) => view.getFloat32(at + from, little);
    case "f8":
      return (at) => view.getFloat64(at + from, little);
  }
}
