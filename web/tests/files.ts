/** Files of several formats, made by hand. */

export type Part = string | ArrayBufferView<ArrayBuffer>;

/** Parts as one piece of bytes. */
export async function joined(parts: Part[]): Promise<Uint8Array<ArrayBuffer>> {
  return new Uint8Array(await new Blob(parts).arrayBuffer());
}

/** The head of an array file. */
export function npy(type: string, shape: string, fortran = false): Uint8Array<ArrayBuffer> {
  const order = fortran ? "True" : "False";
  const text = `{'descr': '${type}', 'fortran_order': ${order}, 'shape': ${shape}, }\n`;
  const head = new Uint8Array(10 + text.length);
  head.set([0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59, 1, 0, text.length, 0]);
  head.set(new TextEncoder().encode(text), 10);
  return head;
}

/** A zip archive as NumPy writes it. */
export async function zip(
  members: Record<string, Part[]>,
  deflated = false,
): Promise<Uint8Array<ArrayBuffer>> {
  const files: Part[] = [];
  const directory: Part[] = [];
  let at = 0;
  for (const [name, parts] of Object.entries(members)) {
    const data = await joined(parts);
    const packed = deflated ? await deflate(data) : data;
    const about = new DataView(new ArrayBuffer(26));
    about.setUint16(4, deflated ? 8 : 0, true);
    about.setUint32(14, packed.length, true);
    about.setUint32(18, data.length, true);
    about.setUint16(22, name.length, true);
    files.push("PK\x03\x04", about, name, packed);
    const more = new DataView(new ArrayBuffer(14));
    more.setUint32(10, at, true);
    directory.push("PK\x01\x02\0\0", about, more, name);
    at += 30 + name.length + packed.length;
  }
  const list = await joined(directory);
  const end = new DataView(new ArrayBuffer(18));
  end.setUint32(8, list.length, true);
  end.setUint32(12, at, true);
  return joined([...files, list, "PK\x05\x06", end]);
}

/** A binary glTF file of one buffer. */
export function glb(
  document: unknown,
  body: ArrayBufferView<ArrayBuffer>,
): Promise<Uint8Array<ArrayBuffer>> {
  const text = JSON.stringify(document);
  const padded = text.padEnd(4 * Math.ceil(text.length / 4));
  const head = Uint32Array.of(2, 28 + padded.length + body.byteLength, padded.length);
  return joined(["glTF", head, "JSON", padded, Uint32Array.of(body.byteLength), "BIN\0", body]);
}

async function deflate(data: Uint8Array<ArrayBuffer>): Promise<Uint8Array<ArrayBuffer>> {
  const stream = new Blob([data]).stream().pipeThrough(new CompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
