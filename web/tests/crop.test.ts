import { expect, test } from "vitest";
import { Collector } from "../src/pure/formats/collector";
import { Cutter } from "../src/pure/formats/crop";
import { readInto, readScan } from "../src/pure/formats/index";
import { nextUp, UPS, upInWords, upVector } from "../src/pure/up";

const BOX = { low: [500_000, 0, 0], high: [500_001, 1, 1] };

function reader(blob: Blob) {
  return (from: number, to: number) => blob.slice(from, to).arrayBuffer();
}

test("what is in the box becomes a file of its own, colours and millimetres kept", async () => {
  const rows = ["500000.001 1 0 9 8 7", "500000.5 0.5 1.001 1 2 3", "500001 0 1 255 0 4"];
  const text = new Blob([rows.join("\n")]);
  const cutter = new Cutter(BOX);
  await readInto(reader(text), text.size, cutter);
  const file = cutter.file();
  const scan = await readScan(reader(file), file.size, 10);
  expect(scan).toMatchObject({ format: "ply", total: 2, low: [500_000.001, 0, 0] });
  expect([...(scan.colors ?? [])]).toEqual([9, 8, 7, 255, 0, 4]);
});

test("many points without colours", async () => {
  const cutter = new Cutter({ low: [0, 0, 0], high: [69_999, 1, 1] });
  for (let i = 0; i < 80_000; i++) cutter.add(i, 0.5, 0.25);
  const file = cutter.file();
  const scan = await readScan(reader(file), file.size, 100);
  expect(scan).toMatchObject({ total: 70_000, high: [69_999, 0.5, 0.25], hasColors: false });
});

test("an empty box is said in words", () => {
  const cutter = new Cutter(BOX);
  cutter.add(Number.NaN, 0, 0);
  expect(() => cutter.file()).toThrow("no point in the box");
});

test("a collector and a cutter see the same points", async () => {
  const text = new Blob(["0 0 0\n1 1 1\nnan 0 0\n"]);
  const collector = new Collector(10);
  await readInto(reader(text), text.size, collector);
  expect(collector.finish("text")).toMatchObject({ total: 2, dropped: 1 });
});

test("each way of being up comes once, with its direction and its words", () => {
  let up = UPS[0];
  const seen = UPS.map(() => {
    up = nextUp(up);
    return up;
  });
  expect(new Set(seen)).toEqual(new Set(UPS));
  expect(up).toBe("z");
  expect(upVector("-y")).toEqual([0, -1, 0]);
  expect(upVector("x")).toEqual([1, 0, 0]);
  expect([upInWords("z"), upInWords("-y")]).toEqual(["Z up", "Y down"]);
});
