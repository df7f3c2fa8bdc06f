/** How long things are, and which way they lie. */

import { length, roundStep } from "../pure/format";
import { preview } from "../state/draft";
import { frames, result } from "../state/job";
import { view } from "../state/look";

const LONGEST = 130; // pixels of the scale bar
const SIZE = 46;
const ARM = 15;
const NAMES = ["x", "y", "z"] as const;

export function Measures() {
  const found = view.value;
  const isEmpty = !preview.value && !frames.value.points && !result.value;
  if (!found || isEmpty) return null;
  const whole = roundStep(LONGEST * found.perPixel);
  const words = `${length(whole)} in the units of the scan`;
  return (
    <div class="measures">
      <Axes axes={found.axes} />
      <div class="scale" role="img" aria-label={`Scale: the bar is ${words}`} title={words}>
        <span>{length(whole)}</span>
        <i style={{ width: `${whole / found.perPixel}px` }} />
      </div>
    </div>
  );
}

/** The directions of the axes, the nearest drawn last. */
function Axes({ axes }: { axes: readonly [number, number, number][] }) {
  const middle = SIZE / 2;
  const order = [0, 1, 2].sort((first, second) => axes[first][2] - axes[second][2]);
  return (
    <svg class="compass" width={SIZE} height={SIZE} aria-hidden="true">
      {order.map((axis) => {
        const [right, up] = axes[axis];
        const at = (reach: number) => [middle + reach * right, middle - reach * up];
        const [[x, y], [tx, ty]] = [at(ARM), at(ARM + 6)];
        return (
          <g key={axis} class={`axis-${NAMES[axis]}`}>
            <line x1={middle} y1={middle} x2={x} y2={y} />
            <text x={tx} y={ty}>
              {NAMES[axis]}
            </text>
          </g>
        );
      })}
    </svg>
  );
}
