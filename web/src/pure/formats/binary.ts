/** NPY, binary PCD and LAS: where their points are. */

import { NoPreview } from "./collector";
import { type Field, type Layout, type NumberType, SIZES } from "./records";

/** The layout of a `.npy` array of shape (n, 3 or more). */
export function npyLayout(head: Uint8Array): Layout {
  const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
  const wide = view.getUint8(6) > 1;
  const size = wide ? view.getUint32(8, true) : view.getUint16(8, true);
  const start = (wide ? 12 : 10) + size;
  const text = new TextDecoder("latin1").decode(head.subarray(wide ? 12 : 10, start));
  const descr = /'descr':\s*'([<>|=])([fiu])(\d)'/.exec(text);
  const shape = /'shape':\s*\((\d+),\s*(\d+),?\)/.exec(text);
  const type = descr && (`${descr[2]}${descr[3]}` as NumberType);
  if (!type || !(type in SIZES) || !shape || text.includes("'fortran_order': True")) {
    throw new NoPreview("This kind of NPY array has no preview here.");
  }
  const [count, columns] = [Number(shape[1]), Number(shape[2])];
  if (columns < 3) throw new NoPreview("Points need three columns.");
  const at = (column: number): Field => ({ type, at: column * SIZES[type] });
  const stride = columns * SIZES[type];
  const little = descr?.[1] !== ">";
  return { start, count, stride, little, x: at(0), y: at(1), z: at(2) };
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

/** The layout of a PCD file with `DATA binary`. */
export function pcdLayout(head: Uint8Array): Layout {
  const { words, start } = pcdHeader(head);
  const names = words.get("FIELDS") ?? [];
  const sizes = words.get("SIZE") ?? [];
  const kinds = words.get("TYPE") ?? [];
  const counts = words.get("COUNT") ?? names.map(() => "1");
  const fields = new Map<string, Field>();
  let stride = 0;
  names.forEach((name, i) => {
    const type = `${kinds[i]?.toLowerCase()}${sizes[i]}` as NumberType;
    if (!(type in SIZES)) throw new NoPreview("This PCD file holds numbers of an unknown type.");
    fields.set(name, { type, at: stride });
    stride += SIZES[type] * Number(counts[i]);
  });
  const [x, y, z] = ["x", "y", "z"].map((name) => fields.get(name));
  if (!x || !y || !z) throw new NoPreview("The points of this PCD file have no x, y and z.");
  const base = { start, count: Number(words.get("POINTS")?.[0]), stride, little: true, x, y, z };
  const packed = fields.get("rgb") ?? fields.get("rgba");
  if (!packed) return base;
  const part = (byte: number): Field => ({ type: "u1", at: packed.at + byte });
  return { ...base, color: [part(2), part(1), part(0)] };
}

const LAS_COLOR_AT: Record<number, number> = { 2: 20, 3: 28, 5: 28, 7: 30, 8: 30, 10: 30 };

/** The layout of a LAS file that is not compressed. */
export function lasLayout(head: Uint8Array): Layout {
  const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
  const format = view.getUint8(104);
  if (format & 0xc0) throw new NoPreview("Compressed LAZ files have no preview here.");
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
