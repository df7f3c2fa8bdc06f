/** The LZF compression of PCD files (Marc Lehmann's LibLZF format). */

/** The `size` bytes that were compressed to `data`; null where they are damaged.
 *
 * A control byte below 32 announces that many plus one literal bytes. Any other holds a length in
 * its upper three bits (7: one more byte of length follows) and the upper five bits of a distance
 * whose lower eight follow: length + 2 bytes are copied from distance + 1 bytes back. */
export function lzfDecompress(data: Uint8Array, size: number): Uint8Array | null {
  const out = new Uint8Array(size);
  let at = 0;
  let filled = 0;
  while (at < data.length) {
    const control = data[at++];
    if (control < 32) {
      const count = control + 1;
      if (at + count > data.length || filled + count > size) return null;
      out.set(data.subarray(at, at + count), filled);
      at += count;
      filled += count;
      continue;
    }
    const length = (control >> 5 === 7 ? 7 + data[at++] : control >> 5) + 2;
    let from = filled - ((control & 31) << 8) - data[at++] - 1;
    if (!(from >= 0) || filled + length > size) return null;
    // byte by byte: a copy that overlaps what it writes repeats it
    for (let i = 0; i < length; i++) out[filled++] = out[from++];
  }
  return filled === size ? out : null;
}
