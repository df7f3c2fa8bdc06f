/** What the picture is made of: clouds, mesh, slice and crop box, and how they are shown. */

import {
  type Box3,
  Color,
  DataTexture,
  LinearFilter,
  type PerspectiveCamera,
  Scene,
  Vector3,
  Vector4,
} from "three";
import { ageTable, type MapName, table } from "../pure/colormap";
import type { Slice } from "../pure/slice";
import { CropBox } from "./crop_box";
import { type PointColors, PointsLayer } from "./points";
import { SliceLayer } from "./slice";
import type { Space } from "./space";
import { type MeshColors, SurfaceLayer } from "./surface";

export interface Look {
  points: boolean;
  mesh: boolean;
  wireframe: boolean;
  flat: boolean;
  meshColors: MeshColors;
  pointColors: PointColors;
  slice: boolean;
  /** Where input and result meet, 0 to 1 of the width; null shows both together. */
  split: number | null;
}

export interface Palette {
  background: string;
  ink: string;
  plain: string;
}

/** What is shown before anything is chosen. */
export const FIRST_LOOK: Look = {
  points: true,
  mesh: true,
  wireframe: false,
  flat: false,
  meshColors: "plain",
  pointColors: "ink",
  slice: false,
  split: null,
};

export class Layers {
  readonly scene = new Scene();
  private readonly ramp = new DataTexture(table("viridis"), 256, 1);
  private readonly ages = new DataTexture(ageTable(), 256, 1);
  readonly cloud = new PointsLayer(this.ramp, this.ages);
  /** The measured points alone. */
  readonly input = new PointsLayer(this.ramp, this.ages);
  readonly surface = new SurfaceLayer();
  readonly slice = new SliceLayer(this.ramp);
  readonly cropBox = new CropBox();
  private clipAxis: { axis: number; at: number } | null = null;

  constructor() {
    for (const texture of [this.ramp, this.ages]) {
      texture.minFilter = LinearFilter;
      texture.magFilter = LinearFilter;
      texture.needsUpdate = true;
    }
    this.scene.add(...this.all.map((layer) => layer.object), this.cropBox.object);
  }

  /** Takes everything away. */
  clear(): void {
    for (const layer of this.all) layer.object.visible = false;
    this.cloud.count = 0;
    this.input.count = 0;
    this.surface.triangles = 0;
    this.clipAxis = null;
  }

  /** Shows a slice across an axis, at a place in the world. The scale of its colours. */
  showSlice(
    slice: Slice,
    axis: number,
    at: number,
    space: Space,
    box: Box3,
  ): { top: number; step: number } {
    this.clipAxis = { axis, at: (at - space.centre[axis]) / space.extent };
    return this.slice.show(slice, space, box);
  }

  apply(look: Look): void {
    const alone = look.pointColors === "distance" && this.input.count > 0;
    this.input.object.visible = look.points && alone;
    this.cloud.object.visible =
      look.points && !alone && this.cloud.count > 0 && look.split === null;
    this.surface.object.visible = look.mesh && this.surface.triangles > 0;
    this.slice.object.visible = look.slice && this.clipAxis !== null;
    this.cloud.mode = look.pointColors;
    this.input.mode = look.pointColors === "round" ? "ink" : look.pointColors;
    this.surface.mode = look.meshColors;
    this.surface.wireframe = look.wireframe;
    this.surface.uniforms.flat_faces.value = look.flat ? 1 : 0;
  }

  /** One half of the split view: the measured points, or the mesh. */
  showHalf(input: boolean): void {
    this.input.object.visible = input;
    this.surface.object.visible = !input;
  }

  setMap(name: MapName): void {
    (this.ramp.image.data as Uint8Array).set(table(name));
    this.ramp.needsUpdate = true;
  }

  setPalette(palette: Palette): void {
    const [ink, paper, plain] = [palette.ink, palette.background, palette.plain].map(vectorOf);
    for (const layer of [this.cloud, this.input]) layer.uniforms.ink.value = ink;
    this.surface.ink = ink;
    this.cropBox.color = ink;
    this.cloud.uniforms.paper.value = paper;
    this.surface.uniforms.plain.value = plain;
  }

  /** Before each picture, of so many pixels: sizes of the dots, and what is cut away. */
  prepare(camera: PerspectiveCamera, height: number, ratio: number, look: Look): void {
    this.dots(height / (2 * Math.tan((camera.fov * Math.PI) / 360)), ratio);
    this.clip(camera, look);
    this.surface.uniforms.back.value = camera.matrixWorld;
  }

  dispose(): void {
    for (const layer of this.all) layer.dispose();
    this.cropBox.dispose();
    this.ramp.dispose();
    this.ages.dispose();
  }

  private get all() {
    return [this.input, this.cloud, this.surface, this.slice];
  }

  /** Dots cover the surface about as far as they are apart. */
  private dots(scale: number, ratio: number): void {
    for (const layer of [this.cloud, this.input]) {
      const apart = Math.sqrt(2.2 / Math.max(layer.count, 500));
      layer.uniforms.dot_size.value = 0.46 * apart * scale;
      layer.uniforms.most_size.value = 9 * ratio;
    }
  }

  /** With a slice, the half towards the viewer is cut away. */
  private clip(camera: PerspectiveCamera, look: Look): void {
    const clip = new Vector4(0, 0, 0, 1);
    if (look.slice && this.clipAxis) {
      const { axis, at } = this.clipAxis;
      const side = camera.position.getComponent(axis) >= at ? 1 : -1;
      clip.setComponent(axis, side);
      clip.w = side * at + 1e-4;
    }
    for (const layer of [this.cloud, this.input, this.surface]) {
      layer.uniforms.clip.value.copy(clip);
    }
  }
}

function vectorOf(color: string): Vector3 {
  const { r, g, b } = new Color(color);
  return new Vector3(r, g, b);
}
