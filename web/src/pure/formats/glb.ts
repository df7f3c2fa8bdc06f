/** Vertices of binary glTF 2.0 files, placed by their node transforms. */

import { NoPreview, type Sink } from "./collector";
import {
  type Column,
  type NumberType,
  type ReadPart,
  SIZES,
  type Three,
  takeColumns,
} from "./records";

const TYPES: Record<number, NumberType> = {
  5120: "i1",
  5121: "u1",
  5122: "i2",
  5123: "u2",
  5125: "u4",
  5126: "f4",
};
const MOST: Partial<Record<NumberType, number>> = { i1: 127, u1: 255, i2: 32767, u2: 65535 };
const JSON_CHUNK = 0x4e4f534a;
const MOST_DESCRIPTION = 1 << 22;

interface Node {
  mesh?: number;
  children?: number[];
  matrix?: number[];
  translation?: Three<number>;
  rotation?: readonly [number, number, number, number];
  scale?: Three<number>;
}

interface Accessor {
  bufferView: number;
  byteOffset?: number;
  componentType: number;
  normalized?: boolean;
  count: number;
  type: string;
}

interface Document {
  scene?: number;
  scenes?: { nodes?: number[] }[];
  nodes?: Node[];
  meshes?: { primitives: { attributes: Record<string, number> }[] }[];
  accessors?: Accessor[];
  bufferViews?: { byteOffset?: number; byteStride?: number }[];
  extensionsRequired?: string[];
}

/** Columns of a 4 x 4 matrix one after the other, as in the file. */
type Matrix = readonly number[];

const UNMOVED: Matrix = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1];

/** Feeds the vertices of all meshes of the scene to a sink.
 * @throws NoPreview when they are compressed, or the file is damaged.
 */
export async function readGlb(read: ReadPart, size: number, sink: Sink): Promise<void> {
  const head = new DataView(await read(0, Math.min(20, size)));
  const length = head.getUint32(12, true);
  if (head.getUint32(16, true) !== JSON_CHUNK || length > MOST_DESCRIPTION) {
    throw new NoPreview("The header of this GLB file is damaged.");
  }
  const document: Document = JSON.parse(new TextDecoder().decode(await read(20, 20 + length)));
  if (document.extensionsRequired?.some((name) => /draco|meshopt/.test(name))) {
    throw new NoPreview("The meshes of this GLB file are compressed; export it without.");
  }
  const view = new DataView(await read(28 + length, size));
  const parts = [...placedParts(document)];
  sink.hasColors = parts.length > 0 && parts.every(({ part }) => "COLOR_0" in part);
  sink.hasNormals = parts.some(({ part }) => "NORMAL" in part);
  for (const { part, matrix } of parts) take(document, view, part, matrix, sink);
}

type Part = Record<string, number>;

/** The attributes of all that the scene shows, each vertex once, with where it is placed. */
function* placedParts(document: Document): Generator<{ part: Part; matrix: Matrix }> {
  const nodes = document.nodes ?? [];
  const children = new Set(nodes.flatMap((node) => node.children ?? []));
  const roots =
    document.scenes?.[document.scene ?? 0]?.nodes ??
    [...nodes.keys()].filter((index) => !children.has(index));
  const stack = roots.map((index) => ({ index, above: UNMOVED }));
  for (let visits = 0; stack.length > 0 && visits < nodes.length; visits++) {
    const { index, above } = stack.pop() as { index: number; above: Matrix };
    const node = nodes[index];
    const matrix = product(above, ownMatrix(node));
    const seen = new Set<number>();
    const found = node.mesh === undefined ? [] : (document.meshes?.[node.mesh].primitives ?? []);
    for (const { attributes } of found) {
      if (!("POSITION" in attributes) || seen.has(attributes.POSITION)) continue;
      seen.add(attributes.POSITION);
      yield { part: attributes, matrix };
    }
    for (const child of node.children ?? []) stack.push({ index: child, above: matrix });
  }
}

function take(document: Document, view: DataView, part: Part, m: Matrix, sink: Sink): void {
  const positions = columns(document, view, part.POSITION);
  const colors = sink.hasColors ? columns(document, view, part.COLOR_0) : null;
  const most = (colors && MOST[colors.columns[0].type]) ?? 1;
  const unit = positions.normalized ? (MOST[positions.columns[0].type] ?? 1) : 1;
  const place = (x: number, y: number, z: number): Three<number> => [
    m[0] * x + m[4] * y + m[8] * z + m[12],
    m[1] * x + m[5] * y + m[9] * z + m[13],
    m[2] * x + m[6] * y + m[10] * z + m[14],
  ];
  const scale = [1 / unit, 1 / unit, 1 / unit];
  const meaning = { little: true, scale, place, shade: (value: number) => toSrgb(value / most) };
  takeColumns(view, positions.count, positions.columns, colors?.columns ?? null, meaning, sink);
}

function columns(document: Document, view: DataView, index: number) {
  const accessor = document.accessors?.[index];
  const place = document.bufferViews?.[accessor?.bufferView ?? -1];
  const type = TYPES[accessor?.componentType ?? 0];
  const width = accessor?.type === "VEC4" ? 4 : 3;
  if (!accessor || !place || !type) throw new NoPreview("This kind of GLB file has no preview.");
  const at = (place.byteOffset ?? 0) + (accessor.byteOffset ?? 0);
  const step = place.byteStride ?? width * SIZES[type];
  if (at + (accessor.count - 1) * step + width * SIZES[type] > view.byteLength) {
    throw new NoPreview("This GLB file ends early.");
  }
  const column = (axis: number): Column => ({ type, at: at + axis * SIZES[type], step });
  const three: Three<Column> = [column(0), column(1), column(2)];
  return { count: accessor.count, columns: three, normalized: accessor.normalized === true };
}

function ownMatrix(node: Node): Matrix {
  if (node.matrix) return node.matrix;
  const [x, y, z, w] = node.rotation ?? [0, 0, 0, 1];
  const [sx, sy, sz] = node.scale ?? [1, 1, 1];
  const [tx, ty, tz] = node.translation ?? [0, 0, 0];
  const first = [1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)];
  const second = [2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)];
  const third = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)];
  const scaled = (axis: number[], by: number) => [...axis.map((value) => value * by), 0];
  return [...scaled(first, sx), ...scaled(second, sy), ...scaled(third, sz), tx, ty, tz, 1];
}

function product(a: Matrix, b: Matrix): Matrix {
  const at = (row: number, column: number) =>
    [0, 1, 2, 3].reduce((sum, i) => sum + a[4 * i + row] * b[4 * column + i], 0);
  return Array.from({ length: 16 }, (_, i) => at(i % 4, Math.floor(i / 4)));
}

/** Linear light, 0 to 1, as the screen shows it, 0 to 255. */
function toSrgb(value: number): number {
  const shown = value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
  return Math.round(255 * shown);
}
