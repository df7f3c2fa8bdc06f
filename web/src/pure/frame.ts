/** Preview frames of a running fit. The layout stands in `jobs/previews.py`. */

export interface Frame {
  kind: "points" | "mesh";
  sequence: number;
  /** Points of the whole cloud, of which `positions` are a choice. */
  total: number;
  round: number;
  rounds: number;
  /** position = origin + scale * code / 65535 */
  origin: [number, number, number];
  scale: number;
  /** Views into the message; nothing is copied. */
  positions: Uint16Array;
  indices: Uint32Array;
  born: Uint8Array;
}

const HEADER = 64;
const KINDS = ["", "points", "mesh"] as const;

/** Reads a frame.
 * @throws Error when the bytes are no frame of a known version.
 */
export function readFrame(buffer: ArrayBuffer): Frame {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEADER || view.getUint32(0) !== 0x55444650) {
    throw new Error("not a preview frame");
  }
  const kind = KINDS[view.getUint8(5)];
  if (view.getUint8(4) !== 1 || !kind) throw new Error("a preview frame of an unknown version");
  const hasRounds = (view.getUint16(6, true) & 1) === 1;
  const count = view.getUint32(12, true);
  const triangles = view.getUint32(16, true);
  const indicesAt = padded(HEADER + 6 * count);
  const bornAt = indicesAt + 12 * triangles;
  if (bornAt + (hasRounds ? count : 0) > buffer.byteLength) {
    throw new Error("a preview frame that was cut off");
  }
  return {
    kind,
    sequence: view.getUint32(8, true),
    total: view.getUint32(20, true),
    round: view.getUint16(24, true),
    rounds: view.getUint16(26, true),
    origin: [32, 40, 48].map((at) => view.getFloat64(at, true)) as [number, number, number],
    scale: view.getFloat64(56, true),
    positions: new Uint16Array(buffer, HEADER, 3 * count),
    indices: new Uint32Array(buffer, indicesAt, 3 * triangles),
    born: new Uint8Array(buffer, bornAt, hasRounds ? count : 0),
  };
}

function padded(size: number): number {
  return Math.ceil(size / 4) * 4;
}
