/** Records of a fixed size: what PLY, PCD, NPY and LAS have in common. */

import { type Collector, NoPreview } from "./collector";

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

/** Feeds all records to the collector.
 * @throws NoPreview when the file is shorter than it says.
 */
export async function readRecords(
  read: ReadPart,
  fileSize: number,
  layout: Layout,
  collector: Collector,
): Promise<void> {
  const { start, count, stride } = layout;
  if (start + count * stride > fileSize) {
    throw new NoPreview(`The file ends early: its header promises ${count} points.`);
  }
  const together = Math.max(1, Math.floor(CHUNK / stride));
  for (let first = 0; first < count; first += together) {
    const until = Math.min(count, first + together);
    const part = await read(start + first * stride, start + until * stride);
    takeAll(new DataView(part), until - first, layout, collector);
  }
}

function takeAll(view: DataView, count: number, layout: Layout, collector: Collector): void {
  const { little, stride, scale = [1, 1, 1], offset = [0, 0, 0] } = layout;
  const axes = [layout.x, layout.y, layout.z].map((field) => getter(view, field, little));
  const shades = layout.color?.map((field) => getter(view, field, little));
  const bright = 255 / (layout.colorMost ?? 255);
  for (let i = 0; i < count; i++) {
    const at = i * stride;
    collector.add(
      offset[0] + scale[0] * axes[0](at),
      offset[1] + scale[1] * axes[1](at),
      offset[2] + scale[2] * axes[2](at),
      shades && [shades[0](at) * bright, shades[1](at) * bright, shades[2](at) * bright],
    );
  }
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
