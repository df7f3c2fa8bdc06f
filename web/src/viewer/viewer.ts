/** The picture: a scan, what grows from it, the mesh, a slice. Draws only when something changed. */

import {
  Box3,
  Color,
  ColorManagement,
  LinearSRGBColorSpace,
  Raycaster,
  Vector2,
  Vector3,
  WebGLRenderer,
} from "three";
import type { MapName } from "../pure/colormap";
import type { Box } from "../pure/formats/crop";
import type { Frame } from "../pure/frame";
import type { Slice } from "../pure/slice";
import { type Up, upVector } from "../pure/up";
import { Eye, type View } from "./eye";
import { FIRST_LOOK, Layers, type Look, type Palette } from "./layers";
import type { CloudData } from "./points";
import { Relief } from "./relief";
import { cornersOf, type Space, sampleOf, spaceOf, type Vector } from "./space";
import type { MeshData } from "./surface";

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
  private readonly eye: Eye;
  private readonly relief = new Relief();
  private readonly layers = new Layers();
  private readonly watching: ResizeObserver;
  private space: Space = { centre: [0, 0, 0], extent: 1 };
  private kept: Box | null = null;
  /** Some of what is shown, in the scene: the picture is framed by it. */
  private sample: Float32Array | null = null;
  private box = new Box3(new Vector3(-0.5, -0.5, -0.5), new Vector3(0.5, 0.5, 0.5));
  private look = FIRST_LOOK;
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
    this.layers.clear();
    this.eye.hasMoved = false;
    this.sample = null;
    this.apply();
  }

  /** The scan itself, or the points of a finished job. */
  showCloud(data: CloudData): void {
    this.layers.cloud.uniforms.newest.value = 0;
    this.layers.cloud.show(data, this.space);
    this.lookAt(data);
    this.apply();
  }

  /** The measured points alone, for heat map and split view. */
  showInput(data: CloudData): void {
    this.layers.input.show(data, this.space);
    this.apply();
  }

  showMesh(data: MeshData): void {
    this.layers.surface.show(data, this.space);
    this.apply();
  }

  /** A preview of a running fit. */
  showFrame(frame: Frame, room: number): void {
    this.arrivedAt = performance.now();
    if (frame.kind === "mesh") {
      this.layers.surface.show({ ...frame, positions: frame.positions.slice() }, this.space);
    } else {
      this.layers.cloud.show(frame, this.space, room);
      if (!this.sample) this.lookAt(frame);
      this.layers.cloud.uniforms.rounds.value = frame.rounds;
      if (frame.round > this.layers.cloud.uniforms.newest.value) this.bornAt = performance.now();
      this.layers.cloud.uniforms.newest.value = frame.round;
    }
    this.apply();
  }

  showSlice(slice: Slice, axis: number, at: number): { top: number; step: number } {
    const scale = this.layers.showSlice(slice, axis, at, this.space, this.box);
    this.apply();
    if (!this.eye.hasMoved) this.frame();
    return scale;
  }

  /** Distances of the measured points; colours reach from 0 to `top`. */
  setDistances(values: Float32Array, top: number): void {
    this.layers.input.setValues(values, top);
    this.invalidate();
  }

  setLook(look: Look): void {
    const isOther = look.slice !== this.look.slice;
    this.look = look;
    this.apply();
    if (isOther && !this.eye.hasMoved) this.frame();
  }

  setMap(name: MapName): void {
    this.layers.setMap(name);
    this.invalidate();
  }

  setPalette(palette: Palette): void {
    this.renderer.setClearColor(new Color(palette.background), 1);
    this.layers.setPalette(palette);
    this.invalidate();
  }

  /** Stands where all of the data is seen. */
  frame(): void {
    const seen = this.sample ?? cornersOf(this.box);
    this.eye.frame(Float32Array.from([...seen, ...(this.layers.slice.corners ?? [])]));
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
    this.layers.cropBox.show(box, this.space);
    this.layers.cloud.crop(
      this.layers.cropBox.object.visible ? this.layers.cropBox.object.box : null,
    );
    this.invalidate();
  }

  invalidate(): void {
    if (!this.scheduled) this.scheduled = requestAnimationFrame(this.draw);
  }

  dispose(): void {
    cancelAnimationFrame(this.scheduled);
    this.watching.disconnect();
    this.eye.dispose();
    this.layers.dispose();
    this.relief.dispose();
    this.renderer.dispose();
  }

  private readonly draw = (now: number): void => {
    this.scheduled = 0;
    this.animate(now);
    const { camera } = this.eye;
    const { target } = this.relief;
    this.eye.focus();
    this.layers.prepare(camera, target.height, this.renderer.getPixelRatio(), this.look);
    target.scissorTest = false;
    this.renderer.setRenderTarget(target);
    this.renderer.clear();
    if (this.look.split === null) this.renderer.render(this.layers.scene, this.eye.camera);
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
      this.layers.showHalf(input);
      this.renderer.render(this.layers.scene, this.eye.camera);
    }
    target.scissorTest = false;
  }

  private animate(now: number): void {
    const age = (now - this.bornAt) / FADE_MS;
    const share = this.still() ? 1 : Math.min(Math.max(age, 0), 1);
    this.layers.cloud.uniforms.fade.value = 1 - (1 - share) ** 3;
    if (share < 1 && this.layers.cloud.object.visible) this.invalidate();
  }

  private apply(): void {
    this.layers.apply(this.look);
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
    const found = this.layers.slice.valueAt(caster.ray, this.space);
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
