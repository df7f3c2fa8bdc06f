/** Distances from points to a triangle mesh: exact, by a grid of cells that know their triangles. */

export interface Triangles {
  positions: Float32Array;
  indices: Uint32Array;
}

/** Looks for the nearest triangle ring by ring around a point's cell. */
export class DistanceGrid {
  private readonly low: [number, number, number];
  private readonly cell: number;
  private readonly size: [number, number, number];
  /** Triangles of cell c: members[starts[c]] to members[starts[c + 1] - 1]. */
  private readonly starts: Uint32Array;
  private readonly members: Uint32Array;
  private readonly seen: Uint32Array;
  private query = 0;

  constructor(private readonly mesh: Triangles) {
    const { low, high } = bounds(mesh.positions);
    const extent = Math.max(...high.map((value, i) => value - low[i])) || 1;
    const triangles = mesh.indices.length / 3;
    const along = Math.min(160, Math.max(4, Math.round(Math.sqrt(triangles / 3))));
    this.low = low;
    this.cell = (extent / along) * 1.0001;
    this.size = high.map((value, i) => Math.floor((value - low[i]) / this.cell) + 1) as never;
    this.seen = new Uint32Array(triangles);
    const cells = this.size[0] * this.size[1] * this.size[2];
    this.starts = new Uint32Array(cells + 1);
    this.eachCell((cell) => this.starts[cell + 1]++);
    for (let c = 0; c < cells; c++) this.starts[c + 1] += this.starts[c];
    this.members = new Uint32Array(this.starts[cells]);
    const next = this.starts.slice(0, cells);
    this.eachCell((cell, triangle) => {
      this.members[next[cell]++] = triangle;
    });
  }

  /** The distance from a point to the nearest triangle. */
  distance(x: number, y: number, z: number): number {
    const home = [x, y, z].map((value, i) =>
      clamp(Math.floor((value - this.low[i]) / this.cell), 0, this.size[i] - 1),
    );
    this.query++;
    let best = Number.POSITIVE_INFINITY;
    const last = Math.max(...this.size);
    for (let ring = 0; ring <= last; ring++) {
      // no triangle of this ring or a later one is nearer than this
      const least = Math.max(0, (ring - 1) * this.cell);
      if (best < least * least) break;
      best = Math.min(best, this.ring(home, ring, x, y, z));
    }
    return Math.sqrt(best);
  }

  private ring(home: number[], ring: number, x: number, y: number, z: number): number {
    let best = Number.POSITIVE_INFINITY;
    const [nx, ny, nz] = this.size;
    for (let k = Math.max(0, home[2] - ring); k <= Math.min(nz - 1, home[2] + ring); k++) {
      for (let j = Math.max(0, home[1] - ring); j <= Math.min(ny - 1, home[1] + ring); j++) {
        const edge = Math.abs(k - home[2]) === ring || Math.abs(j - home[1]) === ring;
        const step = edge || ring === 0 ? 1 : 2 * ring;
        for (let i = home[0] - ring; i <= home[0] + ring; i += step) {
          if (i < 0 || i >= nx) continue;
          best = Math.min(best, this.inCell((k * ny + j) * nx + i, x, y, z));
        }
      }
    }
    return best;
  }

  private inCell(cell: number, x: number, y: number, z: number): number {
    let best = Number.POSITIVE_INFINITY;
    for (let at = this.starts[cell]; at < this.starts[cell + 1]; at++) {
      const triangle = this.members[at];
      if (this.seen[triangle] === this.query) continue;
      this.seen[triangle] = this.query;
      best = Math.min(best, squaredDistance(this.mesh, triangle, x, y, z));
    }
    return best;
  }

  /** Calls back for every cell that the box of a triangle touches. */
  private eachCell(visit: (cell: number, triangle: number) => void): void {
    const { positions, indices } = this.mesh;
    const [nx, ny] = this.size;
    for (let t = 0; t < indices.length / 3; t++) {
      const from = [0, 0, 0];
      const to = [0, 0, 0];
      for (let axis = 0; axis < 3; axis++) {
        const a = positions[3 * indices[3 * t] + axis];
        const b = positions[3 * indices[3 * t + 1] + axis];
        const c = positions[3 * indices[3 * t + 2] + axis];
        from[axis] = this.along(Math.min(a, b, c), axis);
        to[axis] = this.along(Math.max(a, b, c), axis);
      }
      for (let k = from[2]; k <= to[2]; k++)
        for (let j = from[1]; j <= to[1]; j++)
          for (let i = from[0]; i <= to[0]; i++) visit((k * ny + j) * nx + i, t);
    }
  }

  private along(value: number, axis: number): number {
    return clamp(Math.floor((value - this.low[axis]) / this.cell), 0, this.size[axis] - 1);
  }
}

/** The squared distance from a point to a triangle of the mesh (Ericson, Real-Time Collision
 * Detection, 5.1.5). */
export function squaredDistance(
  mesh: Triangles,
  triangle: number,
  x: number,
  y: number,
  z: number,
): number {
  const { positions: p, indices } = mesh;
  const ia = 3 * indices[3 * triangle];
  const ib = 3 * indices[3 * triangle + 1];
  const ic = 3 * indices[3 * triangle + 2];
  const abx = p[ib] - p[ia];
  const aby = p[ib + 1] - p[ia + 1];
  const abz = p[ib + 2] - p[ia + 2];
  const acx = p[ic] - p[ia];
  const acy = p[ic + 1] - p[ia + 1];
  const acz = p[ic + 2] - p[ia + 2];
  const apx = x - p[ia];
  const apy = y - p[ia + 1];
  const apz = z - p[ia + 2];
  const d1 = abx * apx + aby * apy + abz * apz;
  const d2 = acx * apx + acy * apy + acz * apz;
  const bb = abx * abx + aby * aby + abz * abz;
  const bc = abx * acx + aby * acy + abz * acz;
  const cc = acx * acx + acy * acy + acz * acz;
  let v = 0;
  let w = 0;
  const determinant = bb * cc - bc * bc;
  if (determinant > 1e-30) {
    v = (cc * d1 - bc * d2) / determinant;
    w = (bb * d2 - bc * d1) / determinant;
  }
  if (determinant <= 1e-30 || v < 0 || w < 0 || v + w > 1) {
    return nearestEdge(apx, apy, apz, abx, aby, abz, acx, acy, acz);
  }
  return (
    (apx - v * abx - w * acx) ** 2 + (apy - v * aby - w * acy) ** 2 + (apz - v * abz - w * acz) ** 2
  );
}

/** Squared distance from p to the edges of the triangle 0, b, c. */
function nearestEdge(
  px: number,
  py: number,
  pz: number,
  bx: number,
  by: number,
  bz: number,
  cx: number,
  cy: number,
  cz: number,
): number {
  return Math.min(
    toSegment(px, py, pz, bx, by, bz),
    toSegment(px, py, pz, cx, cy, cz),
    toSegment(px - bx, py - by, pz - bz, cx - bx, cy - by, cz - bz),
  );
}

/** Squared distance from p to the segment from 0 to d. */
function toSegment(px: number, py: number, pz: number, dx: number, dy: number, dz: number): number {
  const length = dx * dx + dy * dy + dz * dz;
  const t = length > 0 ? clamp((px * dx + py * dy + pz * dz) / length, 0, 1) : 0;
  return (px - t * dx) ** 2 + (py - t * dy) ** 2 + (pz - t * dz) ** 2;
}

/** Low and high corner of positions. */
export function bounds(positions: ArrayLike<number>): {
  low: [number, number, number];
  high: [number, number, number];
} {
  const low: [number, number, number] = [Infinity, Infinity, Infinity];
  const high: [number, number, number] = [-Infinity, -Infinity, -Infinity];
  for (let i = 0; i < positions.length; i++) {
    const axis = i % 3;
    if (positions[i] < low[axis]) low[axis] = positions[i];
    if (positions[i] > high[axis]) high[axis] = positions[i];
  }
  return { low, high };
}

function clamp(value: number, low: number, high: number): number {
  return Math.min(Math.max(value, low), high);
}
