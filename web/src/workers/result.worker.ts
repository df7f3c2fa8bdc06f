/** Holds a finished job's mesh and points; measures the points against the mesh. */

import { DistanceGrid } from "../pure/distance";
import { type PlyMesh, readPlyMesh } from "../pure/formats/ply";
import { type Summary, summarise } from "../pure/histogram";

export type ResultQuestion =
  | { ask: "read"; mesh: ArrayBuffer; cloud: ArrayBuffer; measured: number }
  | { ask: "compare" };

export type ResultAnswer =
  | { answer: "read"; mesh: PlyMesh; cloud: PlyMesh; measured: number }
  | { answer: "compared"; values: Float32Array; summary: Summary }
  | { answer: "problem"; words: string };

let held: { mesh: PlyMesh; cloud: PlyMesh; measured: number } | null = null;

self.onmessage = ({ data }: MessageEvent<ResultQuestion>) => {
  try {
    if (data.ask === "read") {
      const [mesh, cloud] = [readPlyMesh(data.mesh), readPlyMesh(data.cloud)];
      const measured = Math.min(data.measured, cloud.positions.length / 3);
      held = { mesh, cloud, measured };
      self.postMessage({ answer: "read", ...held });
    } else if (held) {
      self.postMessage(compared(held.mesh, held.cloud, held.measured));
    }
  } catch (error) {
    self.postMessage({ answer: "problem", words: (error as Error).message });
  }
};

function compared(mesh: PlyMesh, cloud: PlyMesh, measured: number): ResultAnswer {
  const grid = new DistanceGrid(mesh);
  const shift = cloud.origin.map((value, i) => value - mesh.origin[i]);
  const values = new Float32Array(measured);
  for (let i = 0; i < measured; i++) {
    const [x, y, z] = [0, 1, 2].map((axis) => cloud.positions[3 * i + axis] + shift[axis]);
    values[i] = grid.distance(x, y, z);
  }
  return { answer: "compared", values, summary: summarise(values) };
}
