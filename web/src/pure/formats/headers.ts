/** Files whose points the page cannot read: what their headers tell. */

import { NoPreview, type Scan } from "./collector";
import type { ReadPart } from "./records";

const PAGE = 1024; // of E57: the last four bytes of each are a checksum
const CONTENT = PAGE - 4;
const MOST_XML = 1 << 22;

/** Count and box of a compressed LAZ file. */
export function lazScan(head: Uint8Array, hasColors: boolean): Scan {
  const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
  const modern = view.getUint8(25) >= 4;
  const many = modern ? Number(view.getBigUint64(247, true)) : 0;
  const bound = (high: boolean) =>
    [0, 16, 32].map((at) => view.getFloat64(179 + at + (high ? 0 : 8), true)) as Scan["low"];
  const total = many || view.getUint32(107, true);
  return told("laz", total, bound(false), bound(true), hasColors);
}

/** Count and box of an E57 file, from the XML at its end. */
export async function e57Scan(read: ReadPart, head: Uint8Array): Promise<Scan> {
  const view = new DataView(head.buffer, head.byteOffset, head.byteLength);
  const start = Number(view.getBigUint64(24, true));
  const length = Number(view.getBigUint64(32, true));
  if (length > MOST_XML) throw new NoPreview("The description of this E57 file is too long.");
  const first = Math.floor(start / PAGE);
  const last = first + Math.ceil((start - first * PAGE + length) / CONTENT) + 1;
  const pages = new Uint8Array(await read(first * PAGE, last * PAGE));
  const content = new Uint8Array(Math.ceil(pages.length / PAGE) * CONTENT);
  for (let at = 0; PAGE * at < pages.length; at++) {
    content.set(pages.subarray(PAGE * at, PAGE * at + CONTENT), CONTENT * at);
  }
  const from = start - first * PAGE;
  const xml = new TextDecoder().decode(content.subarray(from, from + length));
  return fromXml(xml);
}

/** Counts and bounds are read off the text: nothing in it is ever resolved or run. */
function fromXml(xml: string): Scan {
  const counts = [...xml.matchAll(/<points[^>]*\brecordCount="(\d+)"/g)].map(stated);
  const total = counts.reduce((sum, each) => sum + each, 0);
  if (total === 0) throw new NoPreview("There is no point in this file.");
  const ends = (end: string) =>
    ["x", "y", "z"].map((axis) => {
      const found = xml.matchAll(new RegExp(`<${axis}${end}[^>]*>([^<]+)</${axis}${end}>`, "g"));
      return [...found].map(stated);
    });
  // without bounds these are infinite: the box is not known
  const low = ends("Minimum").map((values) => Math.min(...values)) as Scan["low"];
  const high = ends("Maximum").map((values) => Math.max(...values)) as Scan["high"];
  return told("e57", total, low, high, xml.includes("<colorRed"));
}

function stated(found: RegExpMatchArray): number {
  return Number(found[1]);
}

function told(
  format: string,
  total: number,
  low: Scan["low"],
  high: Scan["high"],
  hasColors: boolean,
): Scan {
  const name = format.toUpperCase();
  return {
    format,
    total,
    dropped: 0,
    low,
    high,
    hasColors,
    hasNormals: false,
    positions: new Float32Array(0),
    colors: null,
    origin: low,
    note: `The points of ${name} files are drawn once they are sent. Count and box are those that the file states.`,
  };
}
