/** PLY: the header, vertices as a layout, and whole meshes as the service writes them. */

import { NoPreview } from "./collector";
import { type Field, getter, type Layout, type NumberType, SIZES } from "./records";

const TYPES: Record<string, NumberType> = {
  char: "i1",
  int8: "i1",
  uchar: "u1",
  uint8: "u1",
  short: "i2",
  int16: "i2",
  ushort: "u2",
  uint16: "u2",
  int: "i4",
  int32: "i4",
  uint: "u4",
  uint32: "u4",
  float: "f4",
  float32: "f4",
  double: "f8",
  float64: "f8",
};
const MOST_HEADER = 1 << 16;

export interface PlyProperty {
  name: string;
  type: NumberType;
  list: boolean;
}

export interface PlyElement {
  name: string;
  count: number;
  properties: PlyProperty[];
}

export interface PlyHeader {
  encoding: "ascii" | "little" | "big";
  elements: PlyElement[];
  /** Bytes of the header. */
  size: number;
}

/** Reads the header from the first bytes of a file.
 * @throws NoPreview when it is none, or broken.
 */
export function plyHeader(head: Uint8Array): PlyHeader {
  const text = new TextDecoder("latin1").decode(head.subarray(0, MOST_HEADER));
  const end = /end_header\r?\n/.exec(text);
  if (!end) throw new NoPreview("The header of this PLY file has no end.");
  const elements: PlyElement[] = [];
  let encoding: PlyHeader["encoding"] | null = null;
  for (const line of text.slice(0, end.index).split(/\r?\n/)) {
    const words = line.trim().split(/\s+/);
    if (words[0] === "format") encoding = encodingOf(words[1]);
    if (words[0] === "element") {
      elements.push({ name: words[1], count: Number(words[2]), properties: [] });
    }
    if (words[0] === "property") elements.at(-1)?.properties.push(property(words));
  }
  if (!encoding || elements.some((each) => !Number.isSafeInteger(each.count) || each.count < 0)) {
    throw new NoPreview("The header of this PLY file is broken.");
  }
  return { encoding, elements, size: end.index + end[0].length };
}

/** Where the vertices of a binary file are.
 * @throws NoPreview when there are none that can be found.
 */
export function plyLayout(header: PlyHeader): Layout {
  const vertex = header.elements[0];
  if (vertex?.name !== "vertex") throw new NoPreview("This PLY file does not begin with vertices.");
  const { fields, stride } = fieldsOf(vertex);
  const [x, y, z] = ["x", "y", "z"].map((name) => fields.get(name));
  if (!x || !y || !z) throw new NoPreview("The vertices of this PLY file have no x, y and z.");
  const base = { start: header.size, count: vertex.count, stride, x, y, z };
  const little = header.encoding === "little";
  const color = colorOf(fields);
  if (!color) return { ...base, little };
  return { ...base, little, color, colorMost: color[0].type === "u1" ? 255 : 1 };
}

/** The names of the properties of the vertices, in order. */
export function vertexNames(header: PlyHeader): string[] {
  return header.elements[0]?.properties.map((each) => each.name) ?? [];
}

export interface PlyMesh {
  /** Relative to `origin`, n x 3. */
  positions: Float32Array;
  origin: [number, number, number];
  colors: Uint8Array | null;
  /** Empty for a cloud. */
  indices: Uint32Array;
}

/** A whole little-endian file of triangles, or of points alone.
 * @throws NoPreview when it is something else.
 */
export function readPlyMesh(buffer: ArrayBuffer): PlyMesh {
  const header = plyHeader(new Uint8Array(buffer, 0, Math.min(buffer.byteLength, MOST_HEADER)));
  const layout = plyLayout(header);
  const end = layout.start + layout.count * layout.stride;
  const faces = header.elements.find((each) => each.name === "face");
  if (header.encoding !== "little" || end + (faces?.count ?? 0) * 13 > buffer.byteLength) {
    throw new NoPreview("The mesh cannot be shown: its file is not what it says.");
  }
  const view = new DataView(buffer);
  const axes = [layout.x, layout.y, layout.z].map((field) => getter(view, field, layout.little));
  const origin = axes.map((axis) => (layout.count ? axis(layout.start) : 0)) as PlyMesh["origin"];
  const positions = new Float32Array(3 * layout.count);
  const colors = layout.color ? new Uint8Array(3 * layout.count) : null;
  for (let i = 0; i < layout.count; i++) {
    const at = layout.start + i * layout.stride;
    for (let axis = 0; axis < 3; axis++) positions[3 * i + axis] = axes[axis](at) - origin[axis];
    layout.color?.forEach((field, j) => {
      (colors as Uint8Array)[3 * i + j] = view.getUint8(at + field.at);
    });
  }
  return { positions, origin, colors, indices: triangles(view, end, faces?.count ?? 0) };
}

function triangles(view: DataView, start: number, count: number): Uint32Array {
  const indices = new Uint32Array(3 * count);
  for (let i = 0; i < count; i++) {
    const at = start + 13 * i;
    if (view.getUint8(at) !== 3) throw new NoPreview("The mesh has faces that are no triangles.");
    for (let j = 0; j < 3; j++) indices[3 * i + j] = view.getInt32(at + 1 + 4 * j, true);
  }
  return indices;
}

function encodingOf(word: string | undefined): PlyHeader["encoding"] | null {
  if (word === "ascii") return "ascii";
  return word === "binary_little_endian" ? "little" : word === "binary_big_endian" ? "big" : null;
}

function property(words: string[]): PlyProperty {
  const list = words[1] === "list";
  const type = TYPES[words[list ? 3 : 1]];
  if (!type) throw new NoPreview("The header of this PLY file names an unknown type.");
  return { name: words[list ? 4 : 2] ?? "", type, list };
}

function fieldsOf(element: PlyElement): { fields: Map<string, Field>; stride: number } {
  const fields = new Map<string, Field>();
  let stride = 0;
  for (const { name, type, list } of element.properties) {
    if (list) throw new NoPreview("The vertices of this PLY file hold lists.");
    fields.set(name, { type, at: stride });
    stride += SIZES[type];
  }
  return { fields, stride };
}

function colorOf(fields: Map<string, Field>): [Field, Field, Field] | null {
  for (const names of [
    ["red", "green", "blue"],
    ["diffuse_red", "diffuse_green", "diffuse_blue"],
    ["r", "g", "b"],
  ]) {
    const found = names.map((name) => fields.get(name));
    if (found.every((field) => field !== undefined)) return found as [Field, Field, Field];
  }
  return null;
}
