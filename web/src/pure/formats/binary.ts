/** NPY, binary PCD and LAS: where their points are. */

import { NoPreview, type Sink } from "./collector";
import { lzfDecompress } from "./lzf";
import {
  type Column,
  type Field,
  type Layout,
  type NumberType,
  type ReadPart,
  SIZES,
  type Three,
  takeColumns,
} from "./records";

const MOST_EXPANSION = 100; // 264 bytes of 3 is the most that LZF can do

/** A `.npy` array of shape (n, 3 or more): where its numbers are. */
export interface NpyArray {
  type: NumberType;
  start: number;
  count: number;
  columns: number;
  little: boolean;
  /** Column after column, instead of row after row. */
  fortran: boolean;
}

/** Reads the header of an array.
 * @throws NoPreview when it holds no points.
 */
export function npyArray(head: Uint8Array): NpyArray {
  const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
  const wide = view.getUint8(6) > 1;
  const size = wide ? view.getUint32(8, true) : view.getUint16(8, true);
  const start = (wide ? 12 : 10) + size;
  const text = new TextDecoder("latin1").decode(head.subarray(wide ? 12 : 10, start));
  const descr = /'descr':\s*'([<>|=])([fiu])(\d)'/.exec(text);
  const shape = /'shape':\s*\((\d+),\s*(\d+),?\)/.exec(text);
  const type = descr && (`${descr[2]}${descr[3]}` as NumberType);
  if (!type || !(type in SIZES) || !shape) {
    throw new NoPreview("This kind of NPY array has no preview here.");
  }
  const [count, columns] = [Number(shape[1]), Number(shape[2])];
  if (columns < 3) throw new NoPreview("Points need three columns.");
  const fortran = text.includes("'fortran_order': True");
  return { type, start, count, columns, little: descr?.[1] !== ">", fortran };
}

/** The first three columns of an array that is in memory, `from` bytes after the beginning. */
export function arrayColumns(
  array: NpyArray,
  from = 0,
): { count: number; little: boolean; columns: Three<Column> } {
  const { type, start, count, columns, little, fortran } = array;
  const size = SIZES[type];
  const column = (i: number): Column => ({
    type,
    at: from + start + i * size * (fortran ? count : 1),
    step: size * (fortran ? 1 : columns),
  });
  return { count, little, columns: [column(0), column(1), column(2)] };
}

/** The layout of an array whose rows are one after the other. */
export function npyLayout({ type, start, count, columns, little }: NpyArray): Layout {
  const at = (column: number): Field => ({ type, at: column * SIZES[type] });
  return { start, count, stride: columns * SIZES[type], little, x: at(0), y: at(1), z: at(2) };
}

/** The header lines of a PCD file, and where its data begins. */
export function pcdHeader(head: Uint8Array): { words: Map<string, string[]>; start: number } {
  const text = new TextDecoder("latin1").decode(head);
  const data = /^DATA\s+(\S+)\s*?\r?\n/m.exec(text);
  if (!data) throw new NoPreview("The header of this PCD file has no end.");
  const words = new Map<string, string[]>();
  for (const line of text.slice(0, data.index + data[0].length).split(/\r?\n/)) {
    const [name, ...rest] = line.trim().split(/\s+/);
    words.set(name, rest);
  }
  return { words, start: data.index + data[0].length };
}

interface PcdFields {
  count: number;
  /** Bytes of a point. */
  stride: number;
  fields: Map<string, Field & { size: number }>;
}

/** What a point of a binary PCD file consists of.
 * @throws NoPreview when it has no coordinates.
 */
function pcdFields(words: Map<string, string[]>): PcdFields {
  const names = words.get("FIELDS") ?? [];
  const sizes = words.get("SIZE") ?? [];
  const kinds = words.get("TYPE") ?? [];
  const counts = words.get("COUNT") ?? names.map(() => "1");
  const fields: PcdFields["fields"] = new Map();
  let stride = 0;
  names.forEach((name, i) => {
    const type = `${kinds[i]?.toLowerCase()}${sizes[i]}` as NumberType;
    if (!(type in SIZES)) throw new NoPreview("This PCD file holds numbers of an unknown type.");
    const size = SIZES[type] * Number(counts[i]);
    fields.set(name, { type, at: stride, size });
    stride += size;
  });
  if (["x", "y", "z"].some((name) => !fields.has(name))) {
    throw new NoPreview("The points of this PCD file have no x, y and z.");
  }
  return { count: Number(words.get("POINTS")?.[0]), stride, fields };
}

/** The layout of a PCD file with `DATA binary`. */
export function pcdLayout(head: Uint8Array): Layout {
  const { words, start } = pcdHeader(head);
  const { count, stride, fields } = pcdFields(words);
  const [x, y, z] = ["x", "y", "z"].map((name) => fields.get(name) as Field);
  const base = { start, count, stride, little: true, x, y, z };
  const packed = fields.get("rgb") ?? fields.get("rgba");
  if (!packed) return base;
  const part = (byte: number): Field => ({ type: "u1", at: packed.at + byte });
  return { ...base, color: [part(2), part(1), part(0)] };
}

/** Feeds the points of a PCD file with `DATA binary_compressed`, which holds field after field.
 * @throws NoPreview when it is damaged.
 */
export async function readCompressedPcd(read: ReadPart, head: Uint8Array, sink: Sink) {
  const { words, start } = pcdHeader(head);
  const { count, stride, fields } = pcdFields(words);
  const sizes = new DataView(await read(start, start + 8));
  const [length, size] = [sizes.getUint32(0, true), sizes.getUint32(4, true)];
  const part = new Uint8Array(await read(start + 8, start + 8 + length));
  const data =
    size === count * stride && size <= part.length * MOST_EXPANSION
      ? lzfDecompress(part, size)
      : null;
  if (!data) throw new NoPreview("The compressed points of this PCD file are damaged.");
  const column = (name: string, type?: NumberType, byte = 0): Column => {
    const field = fields.get(name) as Field & { size: number };
    return { type: type ?? field.type, at: field.at * count + byte, step: field.size };
  };
  const packed = ["rgb", "rgba"].find((name) => fields.has(name));
  const colors: Three<Column> | null = packed
    ? [column(packed, "u1", 2), column(packed, "u1", 1), column(packed, "u1", 0)]
    : null;
  sink.hasColors = colors !== null;
  const axes: Three<Column> = [column("x"), column("y"), column("z")];
  takeColumns(new DataView(data.buffer), count, axes, colors, { little: true }, sink);
}

const LAS_COLOR_AT: Record<number, number> = { 2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30 };

/** Whether the points of a LAS file are compressed, which makes it LAZ. */
export function isLaz(head: Uint8Array): boolean {
  return (head[104] & 0xc0) !== 0;
}

/** The layout of a LAS file; of a compressed one, what it would be. */
export function lasLayout(head: Uint8Array): Layout {
  const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
  const format = view.getUint8(104) & 0x3f;
  const modern = view.getUint8(25) >= 4;
  const many = modern ? Number(view.getBigUint64(247, true)) : 0;
  const at = (byte: number): Field => ({ type: "i4", at: byte });
  const doubles = (byte: number) => [0, 8, 16].map((next) => view.getFloat64(byte + next, true));
  const base: Layout = {
    start: view.getUint32(96, true),
    count: many || view.getUint32(107, true),
    stride: view.getUint16(105, true),
    little: true,
    x: at(0),
    y: at(4),
    z: at(8),
    scale: doubles(131),
    offset: doubles(155),
  };
  const colorAt = LAS_COLOR_AT[format];
  if (colorAt === undefined) return base;
  const part = (byte: number): Field => ({ type: "u2", at: colorAt + byte });
  return { ...base, color: [part(0), part(2), part(4)], colorMost: 65535 };
}
