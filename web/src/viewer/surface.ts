/** A mesh on the screen. A surface without inside or outside: both sides look the same. */

import {
  BufferAttribute,
  BufferGeometry,
  DoubleSide,
  GLSL3,
  Group,
  Mesh,
  ShaderMaterial,
  Vector3,
  Vector4,
} from "three";
import { placed, type Space, type Vector } from "./space";

export type MeshColors = "plain" | "scan" | "normals";
const MODES: MeshColors[] = ["plain", "scan", "normals"];

export interface MeshData {
  positions: Float32Array | Uint16Array;
  indices: Uint32Array;
  origin: Vector;
  scale: number;
  colors?: Uint8Array | null;
}

const VERTEX = `
in vec3 shade;
out vec3 seen, turned, tint, world;
void main() {
  vec4 at = modelMatrix * vec4(position, 1.0);
  world = at.xyz;
  seen = (viewMatrix * at).xyz;
  turned = normalMatrix * normal;
  tint = shade;
  gl_Position = projectionMatrix * vec4(seen, 1.0);
}`;

const FRAGMENT = `
in vec3 seen, turned, tint, world;
uniform int mode, flat_faces;
uniform vec3 plain;
uniform vec4 clip;
uniform mat4 back;
out vec4 color;
void main() {
  if (dot(clip.xyz, world) > clip.w) discard;
  vec3 face = cross(dFdx(seen), dFdy(seen));
  vec3 n = normalize(flat_faces == 1 || dot(turned, turned) < 1e-12 ? face : turned);
  if (dot(n, seen) > 0.0) n = -n;
  float light = 0.46 + 0.56 * max(dot(n, vec3(-0.42, 0.6, 0.68)), 0.0)
    + 0.14 * max(dot(n, vec3(0.78, -0.12, 0.61)), 0.0);
  vec3 base = mode == 1 ? tint : plain;
  color = vec4(base * light, 1.0);
  if (mode == 2) color.rgb = 0.5 + 0.5 * normalize((back * vec4(n, 0.0)).xyz);
}`;

const WIRE_VERTEX = `
out vec3 world;
void main() {
  vec4 at = modelMatrix * vec4(position, 1.0);
  world = at.xyz;
  gl_Position = projectionMatrix * viewMatrix * at;
}`;

const WIRE_FRAGMENT = `
in vec3 world;
uniform vec3 ink;
uniform vec4 clip;
out vec4 color;
void main() {
  if (dot(clip.xyz, world) > clip.w) discard;
  color = vec4(ink, 0.45);
}`;

export class SurfaceLayer {
  readonly object = new Group();
  private readonly mesh: Mesh<BufferGeometry, ShaderMaterial>;
  private readonly wire: Mesh<BufferGeometry, ShaderMaterial>;
  triangles = 0;

  constructor() {
    const clip = { value: new Vector4(0, 0, 0, 1) };
    const surface = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: VERTEX,
      fragmentShader: FRAGMENT,
      side: DoubleSide,
      polygonOffset: true,
      polygonOffsetFactor: 1,
      polygonOffsetUnits: 1,
      uniforms: {
        mode: { value: 0 },
        flat_faces: { value: 0 },
        plain: { value: new Vector3(0.86, 0.86, 0.84) },
        clip,
        back: { value: null },
      },
    });
    const wire = new ShaderMaterial({
      glslVersion: GLSL3,
      vertexShader: WIRE_VERTEX,
      fragmentShader: WIRE_FRAGMENT,
      wireframe: true,
      transparent: true,
      uniforms: { ink: { value: new Vector3(0, 0, 0) }, clip },
    });
    this.mesh = new Mesh(new BufferGeometry(), surface);
    this.wire = new Mesh(this.mesh.geometry, wire);
    this.wire.visible = false;
    for (const part of [this.mesh, this.wire]) part.frustumCulled = false;
    this.object.add(this.mesh, this.wire);
    this.object.visible = false;
  }

  show(data: MeshData, space: Space): void {
    this.mesh.geometry.dispose();
    const geometry = new BufferGeometry();
    const coded = data.positions instanceof Uint16Array;
    geometry.setAttribute("position", new BufferAttribute(data.positions, 3, coded));
    geometry.setIndex(new BufferAttribute(data.indices, 1));
    geometry.setAttribute("normal", normalsOf(data.positions, data.indices));
    const colors = data.colors ?? new Uint8Array(data.positions.length);
    geometry.setAttribute("shade", new BufferAttribute(colors, 3, true));
    this.mesh.geometry = geometry;
    this.wire.geometry = geometry;
    this.triangles = data.indices.length / 3;
    this.object.position.set(...placed(space, data.origin));
    this.object.scale.setScalar(data.scale / space.extent);
    this.object.updateMatrixWorld();
  }

  set mode(mode: MeshColors) {
    this.uniforms.mode.value = MODES.indexOf(mode);
  }

  set wireframe(shown: boolean) {
    this.wire.visible = shown;
  }

  set ink(color: Vector3) {
    this.wire.material.uniforms.ink.value = color;
  }

  get uniforms(): ShaderMaterial["uniforms"] {
    return this.mesh.material.uniforms;
  }

  dispose(): void {
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
    this.wire.material.dispose();
  }
}

/** Means of the normals of the faces around each vertex, larger faces counting more. */
function normalsOf(positions: Float32Array | Uint16Array, indices: Uint32Array): BufferAttribute {
  const sums = new Float32Array(positions.length);
  for (let t = 0; t < indices.length; t += 3) {
    const [a, b, c] = [3 * indices[t], 3 * indices[t + 1], 3 * indices[t + 2]];
    const ux = positions[b] - positions[a];
    const uy = positions[b + 1] - positions[a + 1];
    const uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a];
    const vy = positions[c + 1] - positions[a + 1];
    const vz = positions[c + 2] - positions[a + 2];
    const normal = [uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx];
    for (const corner of [a, b, c]) {
      sums[corner] += normal[0];
      sums[corner + 1] += normal[1];
      sums[corner + 2] += normal[2];
    }
  }
  const codes = new Int8Array(sums.length);
  for (let i = 0; i < sums.length; i += 3) {
    const length = Math.hypot(sums[i], sums[i + 1], sums[i + 2]) || 1;
    for (let j = 0; j < 3; j++) codes[i + j] = Math.round((127 * sums[i + j]) / length);
  }
  return new BufferAttribute(codes, 3, true);
}
