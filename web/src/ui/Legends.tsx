/** What the colours mean, in numbers. */

import { ageColor, css, gradient, type MapName } from "../pure/colormap";
import { length, placeWithin } from "../pure/format";
import { draft } from "../state/draft";
import { compared, frames, result, scan } from "../state/job";
import * as look from "../state/look";
import { sentence } from "./parts";

export function Legends() {
  return (
    <div class="legends">
      {look.slicing.value && result.value && <SliceLegend />}
      {look.heat.value && result.value && <HeatLegend />}
      {!result.value && !draft.value && <RoundLegend />}
    </div>
  );
}

/** Measured points, and those of each round. */
function RoundLegend() {
  const frame = frames.value.points;
  if (!frame || frame.round === 0) return null;
  const stops = [0, 0.2, 0.4, 0.6, 0.8, 1].map((place) => css(ageColor(place)));
  return (
    <div class="legend" role="img" aria-label={`Points by round, 1 to ${frame.rounds}`}>
      <p>
        <i class="dot" /> measured
      </p>
      <p class="scale-title">added in round</p>
      <i
        class="ramp"
        style={{
          background: `linear-gradient(to right, ${stops.join(", ")})`,
        }}
      />
      <p class="ends">
        <span>1</span>
        <span>{frame.rounds}</span>
      </p>
    </div>
  );
}

function HeatLegend() {
  const found = compared.value;
  if (!found) return <div class="legend">Measuring distances…</div>;
  const share = look.heatShare.value;
  return (
    <div class="legend">
      <p class="scale-title">Distance of the scan from the mesh</p>
      <i class="ramp" style={{ background: gradient(look.map.value) }} />
      <p class="ends">
        <span>0</span>
        <span>{length(look.heatTop.value)}</span>
      </p>
      <label class="row">
        <span>Colours reach {Math.round(1000 * share) / 10} % of the points</span>
        <input
          type="range"
          min="0.5"
          max="1"
          step="0.005"
          value={share}
          onInput={(event) => {
            look.heatShare.value = Number(event.currentTarget.value);
          }}
        />
      </label>
      <MapChoice />
    </div>
  );
}

function SliceLegend() {
  const scale = look.sliceScale.value;
  const about = scan.value;
  if (look.sliceProblem.value)
    return <div class="legend bad">{sentence(look.sliceProblem.value)}</div>;
  return (
    <div class="legend">
      <p class="scale-title">Distance to the surface</p>
      <i class="ramp turned" style={{ background: gradient(look.map.value) }} />
      <p class="ends">
        <span>0</span>
        <span>{scale ? length(scale.top) : "…"}</span>
      </p>
      <p class="note">
        <i class="line" /> surface
        {scale && <span>lines every {length(scale.step)}</span>}
      </p>
      <div class="row slice-row">
        <fieldset class="axes">
          <legend class="unseen">Across the axis</legend>
          {(["x", "y", "z"] as const).map((axis) => (
            <button
              type="button"
              key={axis}
              aria-pressed={look.sliceAxis.value === axis}
              onClick={() => {
                look.sliceAxis.value = axis;
                look.askForSlice();
              }}
            >
              {axis.toUpperCase()}
            </button>
          ))}
        </fieldset>
        <input
          type="range"
          aria-label={`Place along ${look.sliceAxis.value}`}
          min="0"
          max="1"
          step="0.005"
          value={look.slicePlace.value}
          onInput={(event) => {
            look.slicePlace.value = Number(event.currentTarget.value);
            look.askForSlice();
          }}
        />
        <output>{about ? placeWithin(look.sliceAt.value, Math.max(...about.extent)) : ""}</output>
      </div>
      {!look.heat.value && <MapChoice />}
    </div>
  );
}

function MapChoice() {
  return (
    <label class="row">
      <span>Colours</span>
      <select
        value={look.map.value}
        onChange={(event) => {
          look.map.value = event.currentTarget.value as MapName;
        }}
      >
        {(["viridis", "magma", "plasma", "cividis"] as const).map((name) => (
          <option key={name} value={name}>
            {name}
          </option>
        ))}
      </select>
    </label>
  );
}
