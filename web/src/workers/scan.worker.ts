/** Reads a dropped file beside the page, so that the page never stands still. */

import { NoPreview, type Scan } from "../pure/formats/collector";
import { readScan } from "../pure/formats/index";

export interface ScanQuestion {
  file: Blob;
  most: number;
}

export type ScanAnswer = { scan: Scan } | { problem: string };

self.onmessage = async ({ data: { file, most } }: MessageEvent<ScanQuestion>) => {
  try {
    const read = (from: number, to: number) => file.slice(from, to).arrayBuffer();
    const scan = await readScan(read, file.size, most);
    const parts = [scan.positions.buffer, ...(scan.colors ? [scan.colors.buffer] : [])];
    self.postMessage({ scan }, { transfer: parts });
  } catch (error) {
    const words = error instanceof NoPreview ? error.message : "This file cannot be previewed.";
    self.postMessage({ problem: words });
  }
};
