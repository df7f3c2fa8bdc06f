/** STL and OFF: corners of triangles. */

import { NoPreview } from "./collector";
import type { Layout } from "./records";
import type { Rows } from "./text";

const FACET = 50;

/** Whether the size of a file is the one its binary STL header asks for. */
export function isBinaryStl(head: Uint8Array, size: number): boolean {
  if (head.length < 84) return false;
  const count = new DataView(head.buffer, head.byteOffset).getUint32(80, true);
  return count > 0 && size === 84 + FACET * count;
}

/** The three corners of the facets of a binary STL file, as three layouts. */
export function stlLayouts(head: Uint8Array): Layout[] {
  const count = new DataView(head.buffer, head.byteOffset).getUint32(80, true);
  const base = { start: 84, count, stride: FACET, little: true };
  return [12, 24, 36].map((at) => ({
    ...base,
    x: { type: "f4", at },
    y: { type: "f4", at: at + 4 },
    z: { type: "f4", at: at + 8 },
  }));
}

/** What the rows of an ascii OFF file mean, and where they begin; null if it is none.
 * @throws NoPreview for binary and other unusual kinds.
 */
export function offRows(text: string): { rows: Rows; start: number; hasNormals: boolean } | null {
  const found = /^(?:\s*(?:#[^\n]*)?\n)*\s*(ST)?(C)?(N)?(4)?(n)?OFF\b/.exec(text);
  if (!found) return null;
  const counts = /^(?:\s|#[^\n]*\n)*(\d+)[^\n]*\n/.exec(text.slice(found[0].length));
  if (found[4] || found[5] || !counts) throw new NoPreview("This kind of OFF file has no preview.");
  const color = found[2] ? (found[3] ? 6 : 3) : null;
  const start = found[0].length + counts[0].length;
  const line = text.slice(start).split("\n", 1)[0].trim().split(/\s+/);
  const isWhole =
    color !== null && line.slice(color, color + 3).every((word) => /^\d+$/.test(word));
  return {
    rows: { at: [0, 1, 2], color, colorMost: isWhole ? 255 : 1, most: Number(counts[1]) },
    start,
    hasNormals: found[3] !== undefined,
  };
}
