/** Any file to a preview: told from its content, like the service does. */

import {
  arrayColumns,
  isLaz,
  lasLayout,
  npyArray,
  npyLayout,
  pcdHeader,
  pcdLayout,
  readCompressedPcd,
} from "./binary";
import { Collector, NoPreview, type Scan, type Sink } from "./collector";
import { Distinct } from "./distinct";
import { readGlb } from "./glb";
import { e57Scan, lazScan } from "./headers";
import { readNpz } from "./npz";
import { plyHeader, plyLayout, vertexNames } from "./ply";
import { type ReadPart, readRecords, takeColumns } from "./records";
import { isBinaryStl, offRows, stlLayouts } from "./shapes";
import { guessRows, RowReader, type Rows } from "./text";

const HEAD = 1 << 16;
const TEXT_CHUNK = 1 << 22;

/** A file as the readers want it. */
interface Source {
  read: ReadPart;
  size: number;
  /** Its first bytes, and those as text. */
  head: Uint8Array;
  start: string;
}

/** The points of a file, at most `most` of them; of files that are read by the service alone, what
 * their headers tell.
 * @throws NoPreview with the reason in words.
 */
export async function readScan(read: ReadPart, size: number, most: number): Promise<Scan> {
  const source = await opened(read, size);
  const told = await fromHeader(source);
  if (told) return told;
  const collector = new Collector(most);
  return collector.finish(await feed(source, collector));
}

/** Feeds all points of a file to a sink.
 * @throws NoPreview with the reason in words.
 */
export async function readInto(read: ReadPart, size: number, sink: Sink): Promise<void> {
  await feed(await opened(read, size), sink);
}

async function opened(read: ReadPart, size: number): Promise<Source> {
  if (size === 0) throw new NoPreview("The file is empty.");
  const head = new Uint8Array(await read(0, Math.min(size, HEAD)));
  return { read, size, head, start: new TextDecoder("latin1").decode(head.subarray(0, 512)) };
}

async function fromHeader({ read, head, start }: Source): Promise<Scan | null> {
  if (start.startsWith("LASF") && isLaz(head)) {
    return lazScan(head, lasLayout(head).color !== undefined);
  }
  return start.startsWith("ASTM-E57") ? e57Scan(read, head) : null;
}

/** Reads points by what a file begins with. The name of the format. */
async function feed(source: Source, sink: Sink): Promise<string> {
  const { read, size, head, start } = source;
  if (start.startsWith("ply")) return readPly(source, sink);
  // the first byte is 0x93, which browsers and programs decode differently
  if (start.startsWith("NUMPY", 1)) return readNpy(source, sink);
  if (start.startsWith("LASF")) {
    const layout = lasLayout(head);
    sink.hasColors = layout.color !== undefined;
    await readRecords(read, size, layout, sink);
    return "las";
  }
  if (start.startsWith("glTF")) {
    await readGlb(read, size, sink);
    return "glb";
  }
  if (start.startsWith("PK\x03\x04")) {
    await readNpz(read, size, sink);
    return "npz";
  }
  if (isBinaryStl(head, size)) {
    const layouts = stlLayouts(head);
    const corners = new Distinct(sink, 3 * layouts[0].count);
    for (const layout of layouts) await readRecords(read, size, layout, corners);
    return "stl";
  }
  if (/^(#[^\n]*\n)*\s*(VERSION|FIELDS)\s/.test(start)) return readPcd(source, sink);
  if (head.subarray(0, 512).some((byte) => byte < 9)) {
    throw new NoPreview("There is no preview of this kind of file; the service may read it.");
  }
  return readText(source, sink);
}

async function readNpy({ read, size, head }: Source, sink: Sink): Promise<string> {
  const array = npyArray(head);
  if (!array.fortran) {
    await readRecords(read, size, npyLayout(array), sink);
    return "npy";
  }
  const { count, columns, little } = arrayColumns(array);
  takeColumns(new DataView(await read(0, size)), count, columns, null, { little }, sink);
  return "npy";
}

async function readPly({ read, size, head }: Source, sink: Sink): Promise<string> {
  const header = plyHeader(head);
  const layout = plyLayout(header);
  const names = vertexNames(header);
  sink.hasColors = layout.color !== undefined;
  sink.hasNormals = names.includes("nx");
  if (header.encoding !== "ascii") {
    await readRecords(read, size, layout, sink);
    return "ply";
  }
  const red = names.findIndex((name) => ["red", "diffuse_red", "r"].includes(name));
  await readRows(read, header.size, size, sink, {
    at: ["x", "y", "z"].map((name) => names.indexOf(name)) as Rows["at"],
    color: red < 0 ? null : red,
    colorMost: layout.colorMost ?? 255,
    most: layout.count,
  });
  return "ply";
}

async function readPcd({ read, size, head }: Source, sink: Sink): Promise<string> {
  const { words, start } = pcdHeader(head);
  const names = words.get("FIELDS") ?? [];
  sink.hasNormals = names.includes("normal_x");
  const kind = words.get("DATA")?.[0];
  if (kind === "binary") {
    const layout = pcdLayout(head);
    sink.hasColors = layout.color !== undefined;
    await readRecords(read, size, layout, sink);
  } else if (kind === "ascii") {
    const at = ["x", "y", "z"].map((name) => names.indexOf(name)) as Rows["at"];
    const rows = { at, color: null, colorMost: 255, most: Number(words.get("POINTS")?.[0]) };
    await readRows(read, start, size, sink, rows);
  } else {
    await readCompressedPcd(read, head, sink);
  }
  return "pcd";
}

const VERTICES: Rows = { at: [0, 1, 2], color: null, colorMost: 1, most: Infinity };

async function readText({ read, size, head }: Source, sink: Sink): Promise<string> {
  const text = new TextDecoder("latin1").decode(head); // a byte a letter, so that places are bytes
  const off = offRows(text);
  if (off) {
    await readRows(read, off.start, size, sink, off.rows);
    sink.hasNormals = off.hasNormals;
    return "off";
  }
  const lines = text.split("\n").slice(0, 200);
  if (/^\s*solid\b/i.test(text) && lines.some((line) => /^\s*facet\b/i.test(line))) {
    // a corner takes 24 bytes at least
    await readRows(read, 0, size, new Distinct(sink, Math.ceil(size / 24)), VERTICES, "vertex ");
    return "stl";
  }
  const isObj = lines.some((line) => /^v\s+[-+.\d]/.test(line));
  if (isObj) {
    await readRows(read, 0, size, sink, objRows(lines), "v ");
    return "obj";
  }
  await readRows(read, 0, size, sink, guessRows(lines.slice(0, -1).slice(0, 50)));
  return "text";
}

/** What stands in the lines of vertices: some programs write colours behind the coordinates. */
function objRows(lines: string[]): Rows {
  const first =
    lines
      .find((line) => line.startsWith("v "))
      ?.trim()
      .split(/\s+/) ?? [];
  if (first.length < 7) return VERTICES;
  return {
    ...VERTICES,
    color: 3,
    colorMost: first.slice(4, 7).some((word) => Number(word) > 1) ? 255 : 1,
  };
}

async function readRows(
  read: ReadPart,
  from: number,
  size: number,
  sink: Sink,
  rows: Rows,
  prefix = "",
): Promise<void> {
  const reader = new RowReader(rows, sink, prefix);
  const decoder = new TextDecoder();
  for (let at = from; at < size; at += TEXT_CHUNK) {
    const part = await read(at, Math.min(size, at + TEXT_CHUNK));
    reader.push(decoder.decode(part, { stream: true }));
  }
  reader.end();
}
