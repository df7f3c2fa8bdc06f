/** The edges of a box. */

import { Box3, Box3Helper, type LineBasicMaterial, Vector3 } from "three";
import type { Box } from "../pure/formats/crop";
import { placed, type Space } from "./space";

export class CropBox {
  readonly object = new Box3Helper(new Box3());

  constructor() {
    this.object.visible = false;
    this.object.frustumCulled = false;
  }

  /** Shows a box in world coordinates; null takes it away. */
  show(box: Box | null, space: Space): void {
    this.object.visible = box !== null;
    if (!box) return;
    const corner = (at: readonly number[]) =>
      new Vector3(...placed(space, at as [number, number, number]));
    this.object.box.set(corner(box.low), corner(box.high));
  }

  set color(color: Vector3) {
    (this.object.material as LineBasicMaterial).color.setRGB(color.x, color.y, color.z);
  }

  dispose(): void {
    this.object.dispose();
  }
}
