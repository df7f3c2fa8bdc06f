import { expect, test } from "vitest";
import { readFrame } from "../src/pure/frame";

/** A frame as the service's tests describe it. */
function frame(kind: number, count: number, triangles: number): ArrayBuffer {
  const padded = Math.ceil((6 * count) / 4) * 4;
  const hasRounds = kind === 1;
  const buffer = new ArrayBuffer(64 + padded + 12 * triangles + (hasRounds ? count : 0));
  const view = new DataView(buffer);
  new Uint8Array(buffer).set([0x55, 0x44, 0x46, 0x50, 1, kind]);
  view.setUint16(6, hasRounds ? 1 : 0, true);
  [77, count, triangles, 900].forEach((value, i) => {
    view.setUint32(8 + 4 * i, value, true);
  });
  view.setUint16(24, 3, true);
  view.setUint16(26, 13, true);
  [512000.5, -2, 3].forEach((value, i) => {
    view.setFloat64(32 + 8 * i, value, true);
  });
  view.setFloat64(56, 2.5, true);
  for (let i = 0; i < 3 * count; i++) view.setUint16(64 + 2 * i, 1000 + i, true);
  for (let i = 0; i < 3 * triangles; i++) view.setUint32(64 + padded + 4 * i, i % count, true);
  if (hasRounds) new Uint8Array(buffer, 64 + padded).fill(3);
  return buffer;
}

test("points come with their rounds, and are views of the message", () => {
  const buffer = frame(1, 5, 0);
  const found = readFrame(buffer);
  expect(found).toMatchObject({ kind: "points", sequence: 77, total: 900, round: 3, rounds: 13 });
  expect(found.origin).toEqual([512000.5, -2, 3]);
  expect(found.scale).toBe(2.5);
  expect([...found.positions.slice(0, 3)]).toEqual([1000, 1001, 1002]);
  expect([...found.born]).toEqual([3, 3, 3, 3, 3]);
  expect(found.positions.buffer).toBe(buffer);
});

test("triangles stand behind an odd number of vertices", () => {
  const found = readFrame(frame(2, 7, 4));
  expect(found.kind).toBe("mesh");
  expect(found.positions).toHaveLength(21);
  expect([...found.indices]).toEqual([0, 1, 2, 3, 4, 5, 6, 0, 1, 2, 3, 4]);
});

test.each([
  ["too short", new ArrayBuffer(20)],
  ["foreign", new ArrayBuffer(200)],
  ["cut off", frame(1, 50, 0).slice(0, 300)],
])("a message that is %s is refused", (_, buffer) => {
  expect(() => readFrame(buffer)).toThrow(/preview frame/);
});
