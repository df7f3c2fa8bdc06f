/** The picture: a scan, what grows from it, the mesh, a slice. Draws only when something changed. */

import {
  Box3,
  Color,
  ColorManagement,
  DataTexture,
  LinearFilter,
  LinearSRGBColorSpace,
  Raycaster,
  Scene,
  Vector2,
  Vector3,
  Vector4,
  WebGLRenderer,
} from "three";
import { ageTable, type MapName, table } from "../pure/colormap";
import type { Box } from "../pure/formats/crop";
import type { Frame } from "../pure/frame";
import type { Slice } from "../pure/slice";
import { type Up, upVector } from "../pure/up";
import { CropBox } from "./crop_box";
import { Eye, type View } from "./eye";
import { type CloudData, type PointColors, PointsLayer } from "./points";
import { Relief } from "./relief";
import { SliceLayer } from "./slice";
import { cornersOf, type Space, sampleOf, spaceOf, type Vector } from "./space";
import { type MeshColors, type MeshData, SurfaceLayer } from "./surface";

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

export interface Hover {
  value: number;
  at: Vector;
  x: number;
  y: number;
}

const FRAME_TO_DRAW = "udflow:frame-to-draw";
const FADE_MS = 900;
ColorManagement.enabled = false; // all colours here are as the screen shows them

export class Viewer {
  onHover: (hover: Hover | null) => void = () => {};
  onLost: (lost: boolean) => void = () => {};
  /** After each picture. Lengths are those of the world. */
  onView: (view: View) => void = () => {};
  private readonly renderer: WebGLRenderer;
  private readonly scene = new Scene();
  private readonly eye: Eye;
  private readonly relief = new Relief();
  private readonly ramp = new DataTexture(table("viridis"), 256, 1);
  private readonly ages = new DataTexture(ageTable(), 256, 1);
  private readonly cloud = new PointsLayer(this.ramp, this.ages);
  private readonly input = new PointsLayer(this.ramp, this.ages);
  private readonly surface = new SurfaceLayer();
  private readonly slice = new SliceLayer(this.ramp);
  private readonly cropBox = new CropBox();
  private readonly watching: ResizeObserver;
  private space: Space = { centre: [0, 0, 0], extent: 1 };
  private kept: Box | null = null;
  /** Some of what is shown, in the scene: the picture is framed by it. */
  private sample: Float32Array | null = null;
  private box = new Box3(new Vector3(-0.5, -0.5, -0.5), new Vector3(0.5, 0.5, 0.5));
  private clipAxis: { axis: number; at: number } | null = null;
  private look: Look = {
    points: true,
    mesh: true,
    wireframe: false,
    flat: false,
    meshColors: "plain",
    pointColors: "ink",
    slice: false,
    split: null,
  };
  private scheduled = 0;
  private bornAt = 0;
  private arrivedAt: number | null = null;

  /** @throws Error where the browser has no WebGL 2. */
  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly still: () => boolean,
  ) {
    this.renderer = new WebGLRenderer({ canvas, antialias: false, powerPreference: "low-power" });
    this.renderer.outputColorSpace = LinearSRGBColorSpace;
    this.renderer.autoClear = false;
    for (const texture of [this.ramp, this.ages]) {
      texture.minFilter = LinearFilter;
      texture.magFilter = LinearFilter;
      texture.needsUpdate = true;
    }
    const layers = [this.input, this.cloud, this.surface, this.slice];
    this.scene.add(...layers.map((layer) => layer.object), this.cropBox.object);
    this.eye = new Eye(canvas, () => this.invalidate());
    canvas.addEventListener("webglcontextlost", this.lost);
    canvas.addEventListener("webglcontextrestored", this.restored);
    canvas.addEventListener("pointermove", this.hover);
    canvas.addEventListener("pointerleave", () => this.onHover(null));
    this.watching = new ResizeObserver(() => this.resize());
    this.watching.observe(canvas.parentElement ?? canvas);
    this.frame();
  }

  /** Makes place for data in this box, in world coordinates. coming: what will fill it, if that is
   * known; else the picture is framed by what comes first. */
  setBounds(low: Vector, high: Vector, coming?: CloudData): void {
    this.space = spaceOf(low, high);
    const half = high.map((value, i) => (value - low[i]) / 2 / this.space.extent);
    this.box = new Box3(
      new Vector3(...half.map((value) => -value)),
      new Vector3(...(half as [number, number, number])),
    );
    this.sample = coming ? sampleOf(coming, this.space) : null;
    this.setCrop(this.kept);
    if (!this.eye.hasMoved) this.frame();
  }

  /** Takes everything away. */
  clear(): void {
    for (const layer of [this.cloud, this.input, this.surface, this.slice]) {
      layer.object.visible = false;
    }
    this.cloud.count = 0;
    this.input.count = 0;
    this.surface.triangles = 0;
    this.clipAxis = null;
    this.eye.hasMoved = false;
    this.sample = null;
    this.apply();
  }

  /** The scan itself, or the points of a finished job. */
  showCloud(data: CloudData): void {
    this.cloud.uniforms.newest.value = 0;
    this.cloud.show(data, this.space);
    this.lookAt(data);
    this.apply();
  }

  /** The measured points alone, for heat map and split view. */
  showInput(data: CloudData): void {
    this.input.show(data, this.space);
    this.apply();
  }

  showMesh(data: MeshData): void {
    this.surface.show(data, this.space);
    this.apply();
  }

  /** A preview of a running fit. */
  showFrame(frame: Frame, room: number): void {
    this.arrivedAt = performance.now();
    if (frame.kind === "mesh") {
      this.surface.show({ ...frame, positions: frame.positions.slice() }, this.space);
    } else {
      this.cloud.show(frame, this.space, room);
      if (!this.sample) this.lookAt(frame);
      this.cloud.uniforms.rounds.value = frame.rounds;
      if (frame.round > this.cloud.uniforms.newest.value) this.bornAt = performance.now();
      this.cloud.uniforms.newest.value = frame.round;
    }
    this.apply();
  }

  showSlice(slice: Slice, axis: number, at: number): { top: number; step: number } {
    const scale = this.slice.show(slice, this.space, this.box);
    this.clipAxis = { axis, at: (at - this.space.centre[axis]) / this.space.extent };
    this.apply();
    if (!this.eye.hasMoved) this.frame();
    return scale;
  }

  /** Distances of the measured points; colours reach from 0 to `top`. */
  setDistances(values: Float32Array, top: number): void {
    this.input.setValues(values, top);
    this.invalidate();
  }

  setLook(look: Look): void {
    const isOther = look.slice !== this.look.slice;
    this.look = look;
    this.apply();
    if (isOther && !this.eye.hasMoved) this.frame();
  }

  setMap(name: MapName): void {
    (this.ramp.image.data as Uint8Array).set(table(name));
    this.ramp.needsUpdate = true;
    this.invalidate();
  }

  setPalette(palette: Palette): void {
    this.renderer.setClearColor(new Color(palette.background), 1);
    const ink = new Color(palette.ink);
    const vector = new Vector3(ink.r, ink.g, ink.b);
    for (const layer of [this.cloud, this.input]) layer.uniforms.ink.value = vector;
    this.surface.ink = vector;
    this.cropBox.color = vector;
    const paper = new Color(palette.background);
    this.cloud.uniforms.paper.value = new Vector3(paper.r, paper.g, paper.b);
    const plain = new Color(palette.plain);
    this.surface.uniforms.plain.value = new Vector3(plain.r, plain.g, plain.b);
    this.invalidate();
  }

  /** Stands where all of the data is seen. */
  frame(): void {
    const seen = this.sample ?? cornersOf(this.box);
    this.eye.frame(Float32Array.from([...seen, ...(this.slice.corners ?? [])]));
    this.invalidate();
  }

  /** Another direction is up from now on. */
  setUp(up: Up): void {
    this.eye.setUp(upVector(up));
    this.frame();
  }

  /** Keyboard: turns by degrees, and comes nearer by a factor. */
  move(turn: number, tilt: number, nearer: number): void {
    this.eye.move(turn, tilt, nearer);
  }

  /** The box that is to be kept, with what is outside of it faint; null shows all alike. */
  setCrop(box: Box | null): void {
    this.kept = box;
    this.cropBox.show(box, this.space);
    this.cloud.crop(this.cropBox.object.visible ? this.cropBox.object.box : null);
    this.invalidate();
  }

  invalidate(): void {
    if (!this.scheduled) this.scheduled = requestAnimationFrame(this.draw);
  }

  dispose(): void {
    cancelAnimationFrame(this.scheduled);
    this.watching.disconnect();
    this.eye.dispose();
    for (const layer of [this.cloud, this.input, this.surface, this.slice]) layer.dispose();
    this.cropBox.dispose();
    this.relief.dispose();
    this.ramp.dispose();
    this.ages.dispose();
    this.renderer.dispose();
  }

  private readonly draw = (now: number): void => {
    this.scheduled = 0;
    this.dots();
    this.animate(now);
    const { camera } = this.eye;
    this.eye.focus();
    this.clip();
    this.surface.uniforms.back.value = camera.matrixWorld;
    const { target } = this.relief;
    target.scissorTest = false;
    this.renderer.setRenderTarget(target);
    this.renderer.clear();
    if (this.look.split === null) this.renderer.render(this.scene, this.eye.camera);
    else this.drawSplit(target.width, target.height, this.look.split);
    this.relief.draw(this.renderer, camera);
    const { perPixel, axes } = this.eye.view(this.canvas.clientHeight);
    this.onView({ perPixel: perPixel * this.space.extent, axes });
    if (this.arrivedAt !== null) {
      performance.measure(FRAME_TO_DRAW, { start: this.arrivedAt });
      performance.clearMeasures(FRAME_TO_DRAW); // observers have it; a list would only grow
      this.arrivedAt = null;
    }
  };

  /** Frames what is shown by its points. */
  private lookAt(data: CloudData): void {
    this.sample = sampleOf(data, this.space);
    if (!this.eye.hasMoved) this.frame();
  }

  private drawSplit(width: number, height: number, share: number): void {
    const { target } = this.relief;
    const at = Math.round(width * share);
    target.scissorTest = true;
    const halves = [
      { from: 0, to: at, input: true },
      { from: at, to: width, input: false },
    ];
    for (const { from, to, input } of halves) {
      target.scissor.set(from, 0, to - from, height);
      this.renderer.setRenderTarget(target);
      this.input.object.visible = input;
      this.surface.object.visible = !input;
      this.renderer.render(this.scene, this.eye.camera);
    }
    target.scissorTest = false;
  }

  private animate(now: number): void {
    const age = (now - this.bornAt) / FADE_MS;
    const share = this.still() ? 1 : Math.min(Math.max(age, 0), 1);
    this.cloud.uniforms.fade.value = 1 - (1 - share) ** 3;
    if (share < 1 && this.cloud.object.visible) this.invalidate();
  }

  /** Sizes of the dots: they cover the surface about as far as they are apart. */
  private dots(): void {
    const { height } = this.relief.target;
    const scale = height / (2 * Math.tan((this.eye.camera.fov * Math.PI) / 360));
    for (const layer of [this.cloud, this.input]) {
      const apart = Math.sqrt(2.2 / Math.max(layer.count, 500));
      layer.uniforms.dot_size.value = 0.46 * apart * scale;
      layer.uniforms.most_size.value = 9 * this.renderer.getPixelRatio();
    }
  }

  /** With a slice, the half towards the viewer is cut away. */
  private clip(): void {
    const clip = new Vector4(0, 0, 0, 1);
    if (this.look.slice && this.clipAxis) {
      const { axis, at } = this.clipAxis;
      const side = this.eye.camera.position.getComponent(axis) >= at ? 1 : -1;
      clip.setComponent(axis, side);
      clip.w = side * at + 1e-4;
    }
    for (const layer of [this.cloud, this.input, this.surface]) {
      layer.uniforms.clip.value.copy(clip);
    }
  }

  private apply(): void {
    const { look } = this;
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
    this.invalidate();
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.canvas.parentElement ?? this.canvas;
    if (width === 0 || height === 0) return;
    const most = matchMedia("(pointer: coarse)").matches ? 1.5 : 2;
    const ratio = Math.min(devicePixelRatio, most);
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(width, height, false);
    this.relief.setSize(Math.round(width * ratio), Math.round(height * ratio), ratio);
    this.eye.resize(width, height);
    if (this.eye.hasMoved) this.invalidate();
    else this.frame();
  }

  private readonly hover = (event: PointerEvent): void => {
    if (!this.look.slice) return;
    const box = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - box.left, event.clientY - box.top];
    const caster = new Raycaster();
    caster.setFromCamera(
      new Vector2((2 * x) / box.width - 1, 1 - (2 * y) / box.height),
      this.eye.camera,
    );
    const found = this.slice.valueAt(caster.ray, this.space);
    this.onHover(found && { ...found, x, y });
  };

  private readonly lost = (event: Event): void => {
    event.preventDefault(); // else it never comes back
    cancelAnimationFrame(this.scheduled);
    this.scheduled = -1;
    this.onLost(true);
  };

  private readonly restored = (): void => {
    this.scheduled = 0;
    this.onLost(false);
    this.invalidate();
  };
}
