import { expect, test } from "vitest";
import { bounds, DistanceGrid, squaredDistance, type Triangles } from "../src/pure/distance";

/** Numbers that look random, the same each time. */
function numbers(seed: number): () => number {
  let state = seed;
  return () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
}

/** A soup of small triangles. */
function soup(count: number, size: number): Triangles {
  const random = numbers(5);
  const positions = new Float32Array(9 * count);
  for (let t = 0; t < count; t++) {
    const centre = [random(), random(), random()];
    for (let i = 0; i < 9; i++) positions[9 * t + i] = centre[i % 3] + size * (random() - 0.5);
  }
  return { positions, indices: Uint32Array.from({ length: 3 * count }, (_, i) => i) };
}

/** The nearest of many points spread over a triangle. */
function bySampling(mesh: Triangles, x: number, y: number, z: number): number {
  const p = mesh.positions;
  let best = Infinity;
  for (let i = 0; i <= 300; i++) {
    for (let j = 0; j <= 300 - i; j++) {
      const [u, v] = [i / 300, j / 300];
      const at = (k: number) => p[k] + u * (p[3 + k] - p[k]) + v * (p[6 + k] - p[k]);
      best = Math.min(best, (at(0) - x) ** 2 + (at(1) - y) ** 2 + (at(2) - z) ** 2);
    }
  }
  return best;
}

test("one triangle: face, edges and corners", () => {
  const mesh: Triangles = {
    positions: Float32Array.from([0, 0, 0, 2, 0.5, 0, 0.25, 1.5, 0.5]),
    indices: Uint32Array.from([0, 1, 2]),
  };
  const random = numbers(9);
  for (let i = 0; i < 60; i++) {
    const [x, y, z] = [4 * random() - 1, 4 * random() - 1, 3 * random() - 1];
    const exact = squaredDistance(mesh, 0, x, y, z);
    expect(Math.sqrt(bySampling(mesh, x, y, z)) - Math.sqrt(exact)).toBeGreaterThanOrEqual(-1e-6);
    expect(Math.sqrt(bySampling(mesh, x, y, z)) - Math.sqrt(exact)).toBeLessThan(0.01);
  }
});

test("a triangle without area is a line", () => {
  const mesh: Triangles = {
    positions: Float32Array.from([0, 0, 0, 1, 0, 0, 2, 0, 0]),
    indices: Uint32Array.from([0, 1, 2]),
  };
  expect(squaredDistance(mesh, 0, 1.5, 3, 4)).toBeCloseTo(25, 10);
});

test("the grid finds what looking at every triangle finds, inside and far outside", () => {
  const mesh = soup(400, 0.08);
  const grid = new DistanceGrid(mesh);
  const random = numbers(3);
  for (let i = 0; i < 400; i++) {
    const reach = i % 4 === 0 ? 6 : 1.2;
    const point = [0, 0, 0].map(() => 0.5 + reach * (random() - 0.5)) as [number, number, number];
    let best = Infinity;
    for (let t = 0; t < 400; t++) best = Math.min(best, squaredDistance(mesh, t, ...point));
    expect(grid.distance(...point)).toBeCloseTo(Math.sqrt(best), 6);
  }
});

test("bounds", () => {
  expect(bounds([1, 5, 3, -1, 6, 2])).toEqual({ low: [-1, 5, 2], high: [1, 6, 3] });
});
