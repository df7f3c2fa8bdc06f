/** Reads a dropped file beside the page, so that the page never stands still. */

import { NoPreview, type Scan } from "../pure/formats/collector";
import { type Box, Cutter } from "../pure/formats/crop";
import { readInto, readScan } from "../pure/formats/index";

export type ScanQuestion =
  | { ask: "preview"; file: Blob; most: number }
  | { ask: "crop"; file: Blob; box: Box };

export type ScanAnswer = { scan: Scan } | { cropped: Blob } | { problem: string };

self.onmessage = async ({ data }: MessageEvent<ScanQuestion>) => {
  try {
    if (data.ask === "preview") await preview(data.file, data.most);
    else await crop(data.file, data.box);
  } catch (error) {
    const words = error instanceof NoPreview ? error.message : "This file cannot be previewed.";
    self.postMessage({ problem: words });
  }
};

async function preview(file: Blob, most: number): Promise<void> {
  const scan = await readScan(partsOf(file), file.size, most);
  const parts = [scan.positions.buffer, ...(scan.colors ? [scan.colors.buffer] : [])];
  self.postMessage({ scan }, { transfer: parts });
}

async function crop(file: Blob, box: Box): Promise<void> {
  const cutter = new Cutter(box);
  await readInto(partsOf(file), file.size, cutter);
  self.postMessage({ cropped: cutter.file() });
}

function partsOf(file: Blob): (from: number, to: number) => Promise<ArrayBuffer> {
  return (from, to) => file.slice(from, to).arrayBuffer();
}
