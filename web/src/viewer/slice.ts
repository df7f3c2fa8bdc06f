/** A plane through the field: distances as colours, with lines of equal distance. */

import {
  type Box3,
  BufferAttribute,
  BufferGeometry,
  DataTexture,
  DataUtils,
  DoubleSide,
  GLSL3,
  HalfFloatType,
  LinearFilter,
  Mesh,
  type Ray,
  RedFormat,
  ShaderMaterial,
  Vector3,
} from "three";
import { roundStep } from "../pure/format";
import type { Slice } from "../pure/slice";
import { placed, type Space, type Vector } from "./space";

const VERTEX = `
out vec2 at;
void main() {
  at = uv;
  gl_Position = projectionMatrix * modelViewMatrix * vec4(position, 1.0);
}`;

const FRAGMENT = `
in vec2 at;
uniform sampler2D distances, ramp;
uniform float top, step_size, cell;
uniform vec3 line;
out vec4 color;
void main() {
  float d = texture(distances, at).r;
  color = vec4(texture(ramp, vec2(1.0 - d / top, 0.5)).rgb, 1.0);
  float place = d / step_size;
  float away = abs(fract(place - 0.5) - 0.5) / max(fwidth(place), 1e-6);
  color.rgb = mix(color.rgb, vec3(1.0), 0.4 * (1.0 - smoothstep(0.3, 1.2, away)));
  color.rgb = mix(color.rgb, line, 1.0 - smoothstep(0.5, 0.85, d / cell));
}`;

const MARGIN = 0.05; // that is shown around the scan, of its largest extent

export class SliceLayer {
  readonly object: Mesh<BufferGeometry, ShaderMaterial>;
  private slice: Slice | null = null;

  constructor(ramp: DataTexture) {
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      side: DoubleSide,
      uniforms: {
        distances: { value: null },
        ramp: { value: ramp },
        top: { value: 1 },
        step_size: { value: 1 },
        cell: { value: 1 },
        line: { value: new Vector3(1, 0.36, 0.28) },
      },
    });
    this.object = new Mesh(new BufferGeometry(), material);
    this.object.frustumCulled = false;
    this.object.visible = false;
  }

  /** Shows a slice. The scale of the colours: what is farther than `top` looks the same. */
  show(slice: Slice, space: Space, box: Box3): { top: number; step: number } {
    this.slice = slice;
    const { uniforms } = this.object.material;
    (uniforms.distances.value as DataTexture | null)?.dispose();
    uniforms.distances.value = textureOf(slice);
    const largest = slice.largest;
    const step = roundStep(largest / 9 || 1);
    Object.assign(uniforms.top, { value: largest || 1 });
    Object.assign(uniforms.step_size, { value: step });
    Object.assign(uniforms.cell, { value: slice.cell });
    this.object.geometry.dispose();
    this.object.geometry = quad(slice, space, box);
    return { top: largest, step };
  }

  /** Corners of what is shown, n x 3, in the scene; null where nothing is. */
  get corners(): Float32Array | null {
    const { position } = this.object.geometry.attributes;
    return this.object.visible && position ? (position.array as Float32Array) : null;
  }

  /** The distance where a ray meets the plane, and the place; null beside it. */
  valueAt(ray: Ray, space: Space): { value: number; at: Vector } | null {
    if (!this.slice || !this.object.visible) return null;
    const { first, right, down } = this.slice;
    const corner = new Vector3(...placed(space, first));
    const [u, v] = [right, down].map((way) => new Vector3(...way).divideScalar(space.extent));
    const normal = new Vector3().crossVectors(u, v);
    const steepness = normal.dot(ray.direction);
    if (Math.abs(steepness) < 1e-9 * normal.length()) return null;
    const reach = normal.dot(corner.clone().sub(ray.origin)) / steepness;
    if (reach < 0) return null;
    const hit = ray.at(reach, new Vector3());
    const away = hit.clone().sub(corner);
    const value = this.slice.valueAt(away.dot(u) / u.lengthSq(), away.dot(v) / v.lengthSq());
    if (value === null) return null;
    const at = hit.toArray().map((part, i) => part * space.extent + space.centre[i]);
    return { value, at: at as unknown as Vector };
  }

  dispose(): void {
    (this.object.material.uniforms.distances.value as DataTexture | null)?.dispose();
    this.object.geometry.dispose();
    this.object.material.dispose();
  }
}

function textureOf(slice: Slice): DataTexture {
  const codes = new Uint16Array(slice.values.length);
  for (let i = 0; i < codes.length; i++) codes[i] = DataUtils.toHalfFloat(slice.values[i]);
  const texture = new DataTexture(codes, slice.columns, slice.rows, RedFormat, HalfFloatType);
  texture.magFilter = LinearFilter;
  texture.minFilter = LinearFilter;
  texture.needsUpdate = true;
  return texture;
}

/** First and last of `cells` that are shown, along a way from cell to cell: the service leaves more
 * room around the scan. */
function shownRange(cells: number, corner: Vector3, way: Vector3, box: Box3): [number, number] {
  const at = (reach: number) => (reach - corner.dot(way)) / way.lengthSq();
  const ends = [box.min.dot(way), box.max.dot(way)];
  const room = MARGIN * way.length();
  const first = at(Math.min(...ends) - room);
  const last = at(Math.max(...ends) + room);
  return [Math.max(0, first), Math.min(cells - 1, last)];
}

/** The plane as far as it is shown. */
function quad(slice: Slice, space: Space, box: Box3): BufferGeometry {
  const corner = new Vector3(...placed(space, slice.first));
  const right = new Vector3(...slice.right).divideScalar(space.extent);
  const down = new Vector3(...slice.down).divideScalar(space.extent);
  const [left, rightmost] = shownRange(slice.columns, corner, right, box);
  const [top, bottom] = shownRange(slice.rows, corner, down, box);
  const cells = [
    [left, top],
    [rightmost, top],
    [rightmost, bottom],
    [left, bottom],
  ];
  const corners = cells.map(([column, row]) =>
    corner.clone().addScaledVector(right, column).addScaledVector(down, row),
  );
  const places = cells.flatMap(([column, row]) => [
    (column + 0.5) / slice.columns,
    (row + 0.5) / slice.rows,
  ]);
  const geometry = new BufferGeometry().setFromPoints(corners);
  geometry.setAttribute("uv", new BufferAttribute(new Float32Array(places), 2));
  geometry.setIndex([0, 1, 2, 0, 2, 3]);
  return geometry;
}
