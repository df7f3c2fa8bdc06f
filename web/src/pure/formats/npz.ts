/** NPZ: a zip archive of NPY arrays, of which one holds the points. */

import { arrayColumns, npyArray } from "./binary";
import { NoPreview, type Sink } from "./collector";
import { type ReadPart, takeColumns } from "./records";

const POINT_KEYS = ["points", "xyz", "vertices", "positions", "pos", "coords", "pts", "arr_0"];
const COLOR_KEYS = ["colors", "colours", "color", "rgb"];
const NORMAL_KEYS = ["normals", "normal"];
const DIRECTORY = 0x02014b50;
const DIRECTORY_END = 0x06054b50;
const TAIL = 22 + 65535; // the end record and the longest comment
const MOST_BYTES = 2 ** 30;

interface Member {
  name: string;
  deflated: boolean;
  packed: number;
  size: number;
  /** Where its local header is. */
  at: number;
}

/** Feeds the points of an archive to a sink.
 * @throws NoPreview when there are none, or the archive is damaged or of an unusual kind.
 */
export async function readNpz(read: ReadPart, size: number, sink: Sink): Promise<void> {
  const members = await directory(read, size);
  const find = (keys: string[]) =>
    keys.map((key) => members.find((each) => each.name === key)).find((each) => each);
  const chosen = find(POINT_KEYS) ?? (members.length === 1 ? members[0] : undefined);
  if (!chosen) throw new NoPreview("No array of this archive is called points or xyz.");
  const points = await unpacked(read, chosen);
  const colored = find(COLOR_KEYS);
  const { count, columns, little } = arrayColumns(npyArray(points));
  sink.hasNormals = find(NORMAL_KEYS) !== undefined;
  if (!colored) {
    takeColumns(new DataView(points.buffer), count, columns, null, { little }, sink);
    return;
  }
  const shades = await unpacked(read, colored);
  const both = new Uint8Array(points.length + shades.length);
  both.set(points);
  both.set(shades, points.length);
  const color = arrayColumns(npyArray(shades), points.length);
  if (color.count !== count || color.little !== little) {
    throw new NoPreview("The colours of this NPZ file do not fit its points.");
  }
  sink.hasColors = true;
  const colorMost = color.columns[0].type === "u1" ? 255 : 1;
  const meaning = { little, colorMost };
  takeColumns(new DataView(both.buffer), count, columns, color.columns, meaning, sink);
}

/** The members that the directory at the end of an archive names. */
async function directory(read: ReadPart, size: number): Promise<Member[]> {
  const from = Math.max(0, size - TAIL);
  const tail = new DataView(await read(from, size));
  let end = tail.byteLength - 22;
  while (end >= 0 && tail.getUint32(end, true) !== DIRECTORY_END) end--;
  if (end < 0) throw new NoPreview("This archive ends early.");
  const [length, start] = [tail.getUint32(end + 12, true), tail.getUint32(end + 16, true)];
  if (start + length > size) throw new NoPreview("This archive is damaged, or very large.");
  const view = new DataView(await read(start, start + length));
  const members: Member[] = [];
  for (let at = 0; at + 46 <= length && view.getUint32(at, true) === DIRECTORY; ) {
    const long = view.getUint16(at + 28, true);
    const name = new TextDecoder().decode(new Uint8Array(view.buffer, at + 46, long));
    members.push({
      name: name.replace(/\.npy$/, ""),
      deflated: view.getUint16(at + 10, true) === 8,
      packed: view.getUint32(at + 20, true),
      size: view.getUint32(at + 24, true),
      at: view.getUint32(at + 42, true),
    });
    at += 46 + long + view.getUint16(at + 30, true) + view.getUint16(at + 32, true);
  }
  return members;
}

/** The bytes of a member. */
async function unpacked(read: ReadPart, member: Member): Promise<Uint8Array<ArrayBuffer>> {
  if (member.size > MOST_BYTES) throw new NoPreview("This archive is too large for a preview.");
  const head = new DataView(await read(member.at, member.at + 30));
  const start = member.at + 30 + head.getUint16(26, true) + head.getUint16(28, true);
  const packed = await read(start, start + member.packed);
  if (!member.deflated) return new Uint8Array(packed);
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  const bytes = new Uint8Array(await new Response(stream).arrayBuffer());
  if (bytes.length !== member.size) throw new NoPreview("This archive is damaged.");
  return bytes;
}
