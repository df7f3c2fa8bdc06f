import { expect, test } from "vitest";
import { readSlice, Slice } from "../src/pure/slice";

const HEADERS: Record<string, string> = {
  "X-Slice-First": "1.0,2.0,3.5",
  "X-Slice-Right": "0.5,0.0,0.0",
  "X-Slice-Down": "0.0,0.0,-0.5",
};

function npy(rows: number, columns: number, type: string, values: number[]): ArrayBuffer {
  const text = `{'descr': '${type}', 'fortran_order': False, 'shape': (${rows}, ${columns}), }`;
  const header = new TextEncoder().encode(`${text.padEnd(117)}\n`);
  const buffer = new ArrayBuffer(10 + header.length + 4 * values.length);
  const bytes = new Uint8Array(buffer);
  bytes.set([0x93, 0x4e, 0x55, 0x4d, 0x50, 0x59, 1, 0]);
  new DataView(buffer).setUint16(8, header.length, true);
  bytes.set(header, 10);
  new Float32Array(buffer, 10 + header.length).set(values);
  return buffer;
}

test("a slice is read with its place", () => {
  const slice = readSlice(npy(2, 3, "<f4", [0, 1, 2, 3, 4, 5]), (name) => HEADERS[name]);
  expect([slice.rows, slice.columns, slice.cell, slice.largest]).toEqual([2, 3, 0.5, 5]);
  expect(slice.first).toEqual([1, 2, 3.5]);
  expect(slice.down).toEqual([0, 0, -0.5]);
});

test("what is no slice is refused", () => {
  expect(() => readSlice(npy(2, 3, "<f8", [0, 1]), () => null)).toThrow("no slice");
});

test("values between cells are mixed, and there are none outside", () => {
  const down = [0, -1, 0] as const;
  const slice = new Slice(Float32Array.from([0, 2, 4, 6]), 2, 2, [0, 0, 0], [1, 0, 0], down);
  expect(slice.valueAt(0, 0)).toBe(0);
  expect(slice.valueAt(1, 1)).toBe(6);
  expect(slice.valueAt(0.5, 0.5)).toBe(3);
  expect(slice.valueAt(0.25, 1)).toBe(4.5);
  for (const [column, row] of [
    [-0.1, 0],
    [0, 1.01],
    [Number.NaN + 2, 3],
  ]) {
    expect(slice.valueAt(column, row)).toBeNull();
  }
});
