/** Any file to a preview: told from its content, like the service does. */

import { lasLayout, npyLayout, pcdHeader, pcdLayout } from "./binary";
import { Collector, NoPreview, type Scan } from "./collector";
import { plyHeader, plyLayout, vertexNames } from "./ply";
import { type ReadPart, readRecords } from "./records";
import { guessRows, RowReader, type Rows } from "./text";

const HEAD = 1 << 16;
const TEXT_CHUNK = 1 << 22;

/** The points of a file, at most `most` of them.
 * @throws NoPreview with the reason in words.
 */
export async function readScan(read: ReadPart, size: number, most: number): Promise<Scan> {
  if (size === 0) throw new NoPreview("The file is empty.");
  const head = new Uint8Array(await read(0, Math.min(size, HEAD)));
  const start = new TextDecoder("latin1").decode(head.subarray(0, 512));
  const collector = new Collector(most);
  if (start.startsWith("ply")) return readPly(read, size, head, collector);
  if (start.startsWith("\x93NUMPY")) {
    await readRecords(read, size, npyLayout(head), collector);
    return collector.finish("npy");
  }
  if (start.startsWith("LASF")) {
    const layout = lasLayout(head);
    collector.hasColors = layout.color !== undefined;
    await readRecords(read, size, layout, collector);
    return collector.finish("las");
  }
  if (/^(#[^\n]*\n)*\s*(VERSION|FIELDS)\s/.test(start)) return readPcd(read, size, head, collector);
  if (head.subarray(0, 512).some((byte) => byte < 9)) {
    throw new NoPreview("There is no preview of this kind of file; the service may read it.");
  }
  return readText(read, size, head, collector);
}

async function readPly(
  read: ReadPart,
  size: number,
  head: Uint8Array,
  collector: Collector,
): Promise<Scan> {
  const header = plyHeader(head);
  const layout = plyLayout(header);
  const names = vertexNames(header);
  collector.hasColors = layout.color !== undefined;
  collector.hasNormals = names.includes("nx");
  if (header.encoding !== "ascii") {
    await readRecords(read, size, layout, collector);
    return collector.finish("ply");
  }
  const red = names.findIndex((name) => ["red", "diffuse_red", "r"].includes(name));
  await readRows(read, header.size, size, collector, {
    at: ["x", "y", "z"].map((name) => names.indexOf(name)) as Rows["at"],
    color: red < 0 ? null : red,
    colorMost: layout.colorMost ?? 255,
    most: layout.count,
  });
  return collector.finish("ply");
}

async function readPcd(
  read: ReadPart,
  size: number,
  head: Uint8Array,
  collector: Collector,
): Promise<Scan> {
  const { words, start } = pcdHeader(head);
  const names = words.get("FIELDS") ?? [];
  collector.hasNormals = names.includes("normal_x");
  const kind = words.get("DATA")?.[0];
  if (kind === "binary") {
    const layout = pcdLayout(head);
    collector.hasColors = layout.color !== undefined;
    await readRecords(read, size, layout, collector);
  } else if (kind === "ascii") {
    const at = ["x", "y", "z"].map((name) => names.indexOf(name)) as Rows["at"];
    const rows = { at, color: null, colorMost: 255, most: Number(words.get("POINTS")?.[0]) };
    await readRows(read, start, size, collector, rows);
  } else {
    throw new NoPreview("Compressed PCD files have no preview here; the service reads them.");
  }
  return collector.finish("pcd");
}

async function readText(
  read: ReadPart,
  size: number,
  head: Uint8Array,
  collector: Collector,
): Promise<Scan> {
  const lines = new TextDecoder().decode(head).split("\n").slice(0, 200);
  const isObj = lines.some((line) => /^v\s+[-+.\d]/.test(line));
  if (isObj) {
    const rows: Rows = { at: [0, 1, 2], color: null, colorMost: 1, most: Infinity };
    await readRows(read, 0, size, collector, rows, "v ");
    return collector.finish("obj");
  }
  await readRows(read, 0, size, collector, guessRows(lines.slice(0, -1).slice(0, 50)));
  return collector.finish("text");
}

async function readRows(
  read: ReadPart,
  from: number,
  size: number,
  collector: Collector,
  rows: Rows,
  prefix = "",
): Promise<void> {
  const reader = new RowReader(rows, collector, prefix);
  const decoder = new TextDecoder();
  for (let at = from; at < size; at += TEXT_CHUNK) {
    const part = await read(at, Math.min(size, at + TEXT_CHUNK));
    reader.push(decoder.decode(part, { stream: true }));
  }
  reader.end();
}
