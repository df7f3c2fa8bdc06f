/** A cloud on the screen. Buffers are made once for as many points as will come, and refilled. */

import {
  Box3,
  BufferAttribute,
  BufferGeometry,
  type DataTexture,
  DynamicDrawUsage,
  GLSL3,
  Points,
  ShaderMaterial,
  Vector3,
  Vector4,
} from "three";
import { placed, type Space, type Vector } from "./space";

export type PointColors = "ink" | "scan" | "round" | "distance";
const MODES: PointColors[] = ["ink", "scan", "round", "distance"];

export interface CloudData {
  /** n x 3; Uint16 codes count from 0 to 1. */
  positions: Float32Array | Uint16Array;
  origin: Vector;
  scale: number;
  colors?: Uint8Array | null;
  born?: Uint8Array | null;
  values?: Float32Array | null;
}

const VERTEX = `
in vec3 shade;
in float born;
in float value;
uniform float dot_size, most_size, fade, top, rounds;
uniform int newest, mode;
uniform vec3 ink, paper, crop_low, crop_high;
uniform vec4 clip;
uniform sampler2D ramp, ages;
out vec3 tint;
void main() {
  vec4 world = modelMatrix * vec4(position, 1.0);
  vec4 seen = viewMatrix * world;
  gl_Position = projectionMatrix * seen;
  // a little nearer than they are, so that a mesh through them does not hide them
  vec4 nearer = projectionMatrix * vec4(seen.xy, seen.z + 0.006, 1.0);
  gl_Position.z = nearer.z / nearer.w * gl_Position.w;
  bool is_new = newest > 0 && int(born + 0.5) == newest;
  float size = clamp(dot_size / -seen.z, 1.4, most_size);
  gl_PointSize = is_new ? size * fade * (1.0 + 1.6 * (1.0 - fade)) : size;
  tint = ink;
  if (mode == 1) tint = shade;
  if (mode == 2 && born > 0.5) {
    float place = rounds > 1.0 ? (born - 1.0) / (rounds - 1.0) : 0.5;
    tint = texture(ages, vec2(place, 0.5)).rgb;
  }
  if (mode == 3) tint = texture(ramp, vec2(value / top, 0.5)).rgb;
  vec3 kept = clamp(world.xyz, crop_low, crop_high);
  if (any(notEqual(kept, world.xyz))) tint = mix(tint, paper, 0.8);
  if (dot(clip.xyz, world.xyz) > clip.w) gl_Position = vec4(2.0, 2.0, 2.0, 1.0);
}`;

const FRAGMENT = `
in vec3 tint;
out vec4 color;
void main() {
  vec2 at = 2.0 * gl_PointCoord - 1.0;
  if (dot(at, at) > 1.0) discard;
  color = vec4(tint, 1.0);
}`;

/** In scene coordinates all data lies within half a unit of the centre. */
const EVERYWHERE = new Box3(new Vector3(-9, -9, -9), new Vector3(9, 9, 9));

export class PointsLayer {
  readonly object: Points<BufferGeometry, ShaderMaterial>;
  /** Points that are drawn. */
  count = 0;
  private capacity = 0;

  constructor(ramp: DataTexture, ages: DataTexture) {
    const material = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      uniforms: {
        dot_size: { value: 1 },
        most_size: { value: 8 },
        fade: { value: 1 },
        newest: { value: 0 },
        mode: { value: 0 },
        rounds: { value: 1 },
        top: { value: 1 },
        paper: { value: new Vector3(1, 1, 1) },
        crop_low: { value: EVERYWHERE.min },
        crop_high: { value: EVERYWHERE.max },
        ink: { value: new Vector3(0.2, 0.25, 0.3) },
        clip: { value: new Vector4(0, 0, 0, 1) },
        ramp: { value: ramp },
        ages: { value: ages },
      },
    });
    this.object = new Points(new BufferGeometry(), material);
    this.object.frustumCulled = false;
    this.object.visible = false;
  }

  /** Shows a cloud. room: points to make place for now, because they will come. */
  show(data: CloudData, space: Space, room = 0): void {
    const count = data.positions.length / 3;
    this.reserve(Math.max(count, room), data.positions instanceof Uint16Array);
    const { attributes } = this.object.geometry;
    fill(attributes.position as BufferAttribute, data.positions);
    if (data.colors) fill(attributes.shade as BufferAttribute, data.colors);
    if (data.born) fill(attributes.born as BufferAttribute, data.born);
    if (data.values) fill(attributes.value as BufferAttribute, data.values);
    this.object.geometry.setDrawRange(0, count);
    this.count = count;
    this.object.position.set(...placed(space, data.origin));
    this.object.scale.setScalar(data.scale / space.extent);
    this.object.updateMatrixWorld();
  }

  /** What is outside of the box becomes faint; null: nothing does. */
  crop(box: Box3 | null): void {
    const { min, max } = box ?? EVERYWHERE;
    this.uniforms.crop_low.value = min;
    this.uniforms.crop_high.value = max;
  }

  /** New values, one a point. */
  setValues(values: Float32Array, top: number): void {
    fill(this.object.geometry.attributes.value as BufferAttribute, values);
    this.uniforms.top.value = top;
  }

  set mode(mode: PointColors) {
    this.uniforms.mode.value = MODES.indexOf(mode);
  }

  get uniforms(): ShaderMaterial["uniforms"] {
    return this.object.material.uniforms;
  }

  /** Gives the buffers back. */
  dispose(): void {
    this.object.geometry.dispose();
    this.object.material.dispose();
  }

  private reserve(count: number, coded: boolean): void {
    const { attributes } = this.object.geometry;
    const isCoded = attributes.position?.array instanceof Uint16Array;
    if (count <= this.capacity && attributes.position && isCoded === coded) return;
    this.object.geometry.dispose();
    const geometry = new BufferGeometry();
    const size = 3 * count;
    const positions = coded ? new Uint16Array(size) : new Float32Array(size);
    const parts = {
      position: new BufferAttribute(positions, 3, coded),
      shade: new BufferAttribute(new Uint8Array(size), 3, true),
      born: new BufferAttribute(new Uint8Array(count), 1),
      value: new BufferAttribute(new Float32Array(count), 1),
    };
    for (const [name, attribute] of Object.entries(parts)) {
      attribute.setUsage(DynamicDrawUsage);
      geometry.setAttribute(name, attribute);
    }
    this.object.geometry = geometry;
    this.capacity = count;
  }
}

function fill(attribute: BufferAttribute, values: ArrayLike<number> & { length: number }): void {
  (attribute.array as Float32Array).set(values);
  attribute.clearUpdateRanges();
  attribute.addUpdateRange(0, values.length);
  attribute.needsUpdate = true;
}
