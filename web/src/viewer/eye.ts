/** Where the picture is seen from. */

import { PerspectiveCamera, Quaternion, Spherical, Vector3 } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";

const FRAMED = 0.84; // of the width that the data fills at most
const EDGE = 58; // pixels above and below it: tools and measures lie there
const HOME = new Vector3(-0.52, -1, 0.46).normalize(); // with z up
const Z = new Vector3(0, 0, 1);
const Y = new Vector3(0, 1, 0);
const STEEPEST = 0.07; // radians from straight above

/** Measures of the view, for a scale bar and a sign of the axes. */
export interface View {
  /** Scene lengths per CSS pixel, at the depth of what is looked at. */
  perPixel: number;
  /** Where x, y and z point on the screen: right, up, towards the viewer. */
  axes: readonly [number, number, number][];
}

export class Eye {
  readonly camera = new PerspectiveCamera(30, 1, 0.01, 20);
  /** Whether people have moved it themselves. */
  hasMoved = false;
  private controls: OrbitControls;
  private up = Z.clone();

  constructor(
    private readonly canvas: HTMLCanvasElement,
    private readonly onChange: () => void,
  ) {
    this.controls = this.attached();
  }

  /** Another direction is up from now on. */
  setUp(direction: readonly [number, number, number]): void {
    this.up = new Vector3(...direction);
    this.controls.dispose(); // they know the direction from when they were made
    this.controls = this.attached();
  }

  /** Stands where all points (n x 3, in the scene) are seen, as near as can be.
   *
   * A point with the coordinates a to the right and c towards the viewer is seen where
   * |a - shift| <= wide * (distance - c): two bounds for each direction of the screen, of which
   * the best shift makes both equal. */
  frame(points: Float32Array): void {
    const towards = HOME.clone().applyQuaternion(turned(Z, this.up));
    const right = this.up.clone().cross(towards).normalize();
    const over = towards.clone().cross(right);
    const half = Math.tan((this.camera.fov * Math.PI) / 360);
    const tall = half * Math.max(0.5, 1 - (2 * EDGE) / (this.canvas.clientHeight || 1));
    const wide = half * this.camera.aspect * FRAMED;
    const most = [right, over].flatMap((way, i) => {
      const slope = way.clone().divideScalar(i === 0 ? wide : tall);
      return [towards.clone().add(slope), towards.clone().sub(slope)];
    });
    const [east, west, north, south] = most.map((way) => farthest(points, way));
    const distance = Math.max((east + west) / 2, (north + south) / 2, 0.05);
    this.controls.target
      .copy(right)
      .multiplyScalar((wide * (east - west)) / 2)
      .addScaledVector(over, (tall * (north - south)) / 2);
    this.camera.position.copy(this.controls.target).addScaledVector(towards, distance);
    this.controls.update();
    this.hasMoved = false;
  }

  /** Turns by degrees, and comes nearer by a factor. */
  move(turn: number, tilt: number, nearer: number): void {
    const toY = turned(this.up, Y);
    const away = this.camera.position.clone().sub(this.controls.target).applyQuaternion(toY);
    const place = new Spherical().setFromVector3(away);
    place.theta += (turn * Math.PI) / 180;
    const steep = place.phi - (tilt * Math.PI) / 180;
    place.phi = Math.min(Math.max(steep, STEEPEST), Math.PI - STEEPEST);
    place.radius *= nearer;
    away.setFromSpherical(place).applyQuaternion(toY.invert());
    this.camera.position.copy(away).add(this.controls.target);
    this.hasMoved = true;
    this.controls.update();
    this.onChange();
  }

  resize(width: number, height: number): void {
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
  }

  /** Before each picture: as much depth as there is to see. */
  focus(): void {
    const distance = this.distance;
    this.camera.near = Math.max(0.005, distance - 3);
    this.camera.far = distance + 3;
    this.camera.updateProjectionMatrix();
  }

  /** height: of the picture in CSS pixels. */
  view(height: number): View {
    const tall = 2 * this.distance * Math.tan((this.camera.fov * Math.PI) / 360);
    const { elements: e } = this.camera.matrixWorldInverse;
    const axes = [0, 4, 8].map((at) => [e[at], e[at + 1], e[at + 2]] as [number, number, number]);
    return { perPixel: tall / height, axes };
  }

  dispose(): void {
    this.controls.dispose();
  }

  private get distance(): number {
    return this.camera.position.distanceTo(this.controls.target);
  }

  private attached(): OrbitControls {
    this.camera.up.copy(this.up);
    const controls = new OrbitControls(this.camera, this.canvas);
    controls.addEventListener("change", this.onChange);
    controls.addEventListener("start", () => {
      this.hasMoved = true;
    });
    return controls;
  }
}

/** How far points reach in a direction. */
function farthest(points: Float32Array, { x, y, z }: Vector3): number {
  let most = Number.NEGATIVE_INFINITY;
  for (let i = 0; i < points.length; i += 3) {
    most = Math.max(most, points[i] * x + points[i + 1] * y + points[i + 2] * z);
  }
  return most;
}

function turned(from: Vector3, to: Vector3): Quaternion {
  return new Quaternion().setFromUnitVectors(from, to);
}
