/** The picture and what lies over it. */

import { effect, signal, untracked } from "@preact/signals";
import { useEffect, useRef } from "preact/hooks";
import { bounds } from "../pure/distance";
import { length } from "../pure/format";
import type { Frame } from "../pure/frame";
import { heroFrame, heroPoints, heroRounds } from "../pure/hero";
import { colorNow, isDark, prefersStill, route } from "../state/app";
import { crop, draft, handedOver, preview, reading } from "../state/draft";
import { compared, frames, job, result, scan } from "../state/job";
import * as look from "../state/look";
import type { Look, Palette } from "../viewer/layers";
import type { Vector } from "../viewer/space";
import { Viewer } from "../viewer/viewer";
import { Legends } from "./Legends";
import { Measures } from "./Measures";
import { SplitHandle } from "./SplitHandle";
import { Toolbar } from "./Toolbar";

export const viewer = signal<Viewer | null>(null);
const lost = signal(false);
const unable = signal<string | null>(null);
const HERO_STEP_MS = 60;

export function Stage() {
  const canvas = useRef<HTMLCanvasElement>(null);
  useEffect(() => (canvas.current ? attach(canvas.current) : undefined), []);
  return (
    <section class="stage" aria-label="3D view">
      <div class="picture">
        {/* biome-ignore lint/a11y/noInteractiveElementToNoninteractiveRole: what it is to its users */}
        <canvas
          ref={canvas}
          tabIndex={0}
          role="application"
          aria-roledescription="3D viewer"
          aria-label={labelOf()}
          aria-describedby="viewer-help"
        />
        <p id="viewer-help" class="unseen">
          Arrow keys turn the view, plus and minus zoom, F shows everything.
        </p>
        <Notice />
        <SplitHandle />
        <Readout />
        <Measures />
        <Toolbar />
      </div>
      <Legends />
    </section>
  );
}

function labelOf(): string {
  const current = job.value;
  if (result.value) return "The mesh that was made";
  if (current) return `The growing cloud, ${current.points ?? 0} points`;
  return preview.value ? `Preview of ${preview.value.total} points` : "A shell made of points";
}

function Notice() {
  const words =
    unable.value ?? (lost.value ? "The graphics card was lost. Waiting for it…" : absentNow());
  return words && <p class="notice">{words}</p>;
}

/** Why there is nothing to see of a draft. */
function absentNow(): string | null {
  if (job.value?.state === "queued" && handedOver.value !== job.value.id) {
    return "The picture begins when the job does.";
  }
  if (!draft.value || reading.value) return null;
  if (!preview.value) return "There is no picture of this file.";
  return preview.value.note && `${preview.value.format.toUpperCase()} points are drawn once sent.`;
}

/** The distance under the pointer. */
function Readout() {
  const found = look.hover.value;
  if (!found) return null;
  return (
    <output class="readout" style={{ left: `${found.x}px`, top: `${found.y}px` }}>
      {length(found.value)}
    </output>
  );
}

/** Makes the viewer and keeps it showing what the state says. */
function attach(canvas: HTMLCanvasElement): (() => void) | undefined {
  let made: Viewer;
  try {
    made = new Viewer(canvas, () => prefersStill.matches);
  } catch {
    unable.value = "This browser cannot draw in 3D (no WebGL 2). Everything else works.";
    return undefined;
  }
  made.onHover = (found) => {
    look.hover.value = found;
  };
  made.onView = (found) => {
    if (JSON.stringify(found) !== JSON.stringify(look.view.peek())) look.view.value = found;
  };
  made.onLost = (gone) => {
    lost.value = gone;
  };
  viewer.value = made;
  const stops = [
    effect(() => {
      void isDark();
      made.setPalette(paletteNow());
    }),
    showHero(made),
    showDraft(made),
    showBox(made),
    showJob(made),
    effect(() => made.setLook(lookNow())),
    effect(() => made.setMap(look.map.value)),
    effect(() => made.setUp(look.up.value)),
  ];
  return () => {
    for (const stop of stops) stop();
    viewer.value = null;
    made.dispose();
  };
}

/** The shell of the start page, round by round. */
function showHero(made: Viewer): () => void {
  let timer = 0;
  const stop = effect(() => {
    clearTimeout(timer);
    if (route.value.page !== "start" || draft.value) return;
    made.clear();
    const whole = heroFrame(heroRounds);
    made.setBounds(...boundsOf(whole), whole);
    const grow = (round: number) => {
      made.showFrame(heroFrame(round), heroPoints);
      if (round < heroRounds) timer = window.setTimeout(() => grow(round + 1), HERO_STEP_MS);
    };
    grow(prefersStill.matches ? heroRounds : 1);
  });
  return () => {
    clearTimeout(timer);
    stop();
  };
}

function showDraft(made: Viewer): () => void {
  return effect(() => {
    if (!draft.value) return;
    made.clear();
    const found = preview.value;
    if (!found) return;
    if (!Number.isFinite(found.low[0])) return; // a header that tells no box
    made.setBounds(found.low, found.high);
    made.showCloud({ ...found, scale: 1 });
  });
}

/** The box that is kept; of files whose points are not drawn, the box that they fill. */
function showBox(made: Viewer): () => void {
  return effect(() => {
    const found = preview.value;
    const isEmpty = found !== null && found.positions.length === 0;
    made.setCrop(isEmpty && Number.isFinite(found.low[0]) ? found : crop.value);
  });
}

function showJob(made: Viewer): () => void {
  let shownJob = "";
  let seen = 0;
  let bounded = false;
  const bound = (low: Vector, high: Vector) => {
    if (!bounded) made.setBounds(low, high);
    bounded = true;
  };
  const stops = [
    effect(() => {
      const found = route.value;
      const id = found.page === "job" ? found.id : "";
      if (id === shownJob) return;
      shownJob = id;
      seen = 0;
      bounded = false;
      // what was just sent stays until the job shows more
      if (id && handedOver.peek() !== id) made.clear();
    }),
    effect(() => {
      const about = scan.value;
      if (about) bound(about.low, about.high);
    }),
    effect(() => {
      const { points, mesh } = frames.value;
      const newest = [points, mesh]
        .filter((frame): frame is Frame => frame !== null && frame.sequence > seen)
        .sort((first, second) => first.sequence - second.sequence);
      if (untracked(() => result.value) || newest.length === 0) return;
      const target = untracked(() => job.value?.config.densify?.target_points ?? 0);
      for (const frame of newest) {
        seen = Math.max(seen, frame.sequence);
        if (!bounded) bound(...boundsOf(frame));
        made.showFrame(frame, Math.max(target, frame.total));
      }
    }),
    effect(() => {
      const found = result.value;
      if (!found) return;
      const { mesh, cloud, measured } = found;
      const box = bounds(cloud.positions);
      const shifted = (corner: Vector) =>
        corner.map((value, i) => value + cloud.origin[i]) as unknown as Vector;
      bound(shifted(box.low), shifted(box.high));
      const born = new Uint8Array(cloud.positions.length / 3).fill(1, measured);
      made.showCloud({ ...cloud, scale: 1, born });
      const positions = cloud.positions.slice(0, 3 * measured);
      const colors = cloud.colors?.slice(0, 3 * measured) ?? null;
      made.showInput({ positions, colors, origin: cloud.origin, scale: 1 });
      made.showMesh({ ...mesh, scale: 1 });
      look.shown.value = "mesh";
    }),
    effect(() => {
      const found = compared.value;
      if (found) made.setDistances(found.values, look.heatTop.value);
    }),
    effect(() => {
      const found = look.slice.value;
      if (!found) return;
      const axis = "xyz".indexOf(untracked(() => look.sliceAxis.value));
      look.sliceScale.value = made.showSlice(found, axis, found.first[axis]);
    }),
  ];
  return () => {
    for (const stop of stops) stop();
  };
}

/** The box of a frame: its codes span it, but only along its longest side. */
function boundsOf(frame: Frame): [Vector, Vector] {
  const { low, high } = bounds(frame.positions);
  const corner = (codes: Vector) =>
    codes.map((value, i) => frame.origin[i] + (frame.scale * value) / 65535) as unknown as Vector;
  return [corner(low), corner(high)];
}

function lookNow(): Look {
  const isResult = result.value !== null;
  const isGrowing = route.value.page === "job" && !isResult && frames.value.points !== null;
  const isHero = route.value.page === "start" && !draft.value;
  const hasColors = (preview.value?.hasColors || scan.value?.has_colors) ?? false;
  const inColor = look.scanColors.value && hasColors;
  const heat = look.heat.value && compared.value !== null;
  const shown = look.shown.value;
  return {
    points: shown !== "mesh" || heat,
    mesh: shown !== "points" && !isHero,
    wireframe: look.wireframe.value,
    flat: look.flat.value,
    meshColors: meshColorsNow(inColor && isResult && !heat),
    pointColors: heat ? "distance" : isHero || isGrowing ? "round" : inColor ? "scan" : "ink",
    slice: look.slicing.value && isResult,
    split: isResult ? look.split.value : null,
  };
}

function meshColorsNow(inColor: boolean): Look["meshColors"] {
  if (look.normals.value) return "normals";
  return inColor ? "scan" : "plain";
}

function paletteNow(): Palette {
  return {
    background: colorNow("--stage"),
    ink: colorNow("--measured"),
    plain: colorNow("--surface"),
  };
}
