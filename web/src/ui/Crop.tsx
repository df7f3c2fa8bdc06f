/** A box around the part of the scan that is to be sent. */

import { count, placeWithin } from "../pure/format";
import type { Scan } from "../pure/formats/collector";
import * as draft from "../state/draft";

const AXES = ["x", "y", "z"] as const;
const LEAST = 0.01; // of an axis, that stays between the two ends

export function Crop({ scan }: { scan: Scan }) {
  const box = draft.crop.value;
  const share = draft.keptShare.value;
  const about = scan.positions.length / 3 < scan.total ? "about " : "";
  return (
    <details class="crop">
      <summary>Crop{box && ` · ${about}${count(share * scan.total)} points are kept`}</summary>
      {AXES.map((name, axis) => (
        <Range key={name} scan={scan} axis={axis} />
      ))}
      <p class="quiet">
        What is faint is not sent.{" "}
        {box && (
          <button type="button" class="plain" onClick={clear}>
            Send all of it
          </button>
        )}
      </p>
    </details>
  );
}

function clear(): void {
  draft.crop.value = null;
}

/** Two ends on one line. */
function Range({ scan, axis }: { scan: Scan; axis: number }) {
  const [low, high] = [scan.low[axis], scan.high[axis]];
  const size = high - low || 1;
  const box = draft.crop.value ?? scan;
  const from = (box.low[axis] - low) / size;
  const to = (box.high[axis] - low) / size;
  const name = AXES[axis];
  const shown = (value: number) => placeWithin(value, size);
  const end = (label: string, value: number, set: (value: number) => void) => (
    <input
      class="end"
      type="range"
      min="0"
      max="1"
      step="0.002"
      value={value}
      aria-label={`${label} ${name}`}
      aria-valuetext={shown(low + value * size)}
      onInput={(event) => {
        set(event.currentTarget.valueAsNumber);
        // what was refused jumps back
        event.currentTarget.value = String(shareOf(label));
      }}
    />
  );
  const shareOf = (label: string) => {
    const now = draft.crop.value ?? scan;
    return ((label === "Least" ? now.low : now.high)[axis] - low) / size;
  };
  return (
    <div class="crop-row">
      <span>{name.toUpperCase()}</span>
      <div class="two-ends" style={{ "--from": from, "--to": to }}>
        {end("Least", from, (value) => cut(scan, axis, Math.min(value, to - LEAST), to))}
        {end("Largest", to, (value) => cut(scan, axis, from, Math.max(value, from + LEAST)))}
      </div>
      <output>
        {shown(box.low[axis])} … {shown(box.high[axis])}
      </output>
    </div>
  );
}

/** Sets the ends along an axis, as shares of the scan. */
function cut(scan: Scan, axis: number, from: number, to: number): void {
  const now = draft.crop.value ?? { low: [...scan.low], high: [...scan.high] };
  const size = scan.high[axis] - scan.low[axis];
  const at = (share: number) =>
    share <= 0 ? scan.low[axis] : share >= 1 ? scan.high[axis] : scan.low[axis] + share * size;
  draft.crop.value = {
    low: now.low.map((value, i) => (i === axis ? at(from) : value)),
    high: now.high.map((value, i) => (i === axis ? at(to) : value)),
  };
}
