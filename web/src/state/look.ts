/** How the picture is drawn, as far as people choose it. */

import { computed, type Signal, signal } from "@preact/signals";
import { getSlice, Problem } from "../net/api";
import type { MapName } from "../pure/colormap";
import { quantile } from "../pure/histogram";
import { hashOf, routeOf } from "../pure/route";
import { readSlice, type Slice } from "../pure/slice";
import type { Up } from "../pure/up";
import type { View } from "../viewer/eye";
import type { Hover } from "../viewer/viewer";
import { compare, compared, job, scan } from "./job";

export type Shown = "points" | "mesh" | "both";
export type Axis = "x" | "y" | "z";

export const shown = signal<Shown>("both");
export const wireframe = signal(false);
export const flat = signal(false);
export const normals = signal(false);
export const scanColors = signal(true);
export const heat = signal(false);
export const map = signal<MapName>("viridis");
/** Share of the distances that the colours span. */
export const heatShare = signal(0.98);
export const split = signal<number | null>(null);
export const slicing = signal(false);
export const sliceAxis = signal<Axis>("y");
/** 0 to 1 between the sides of the scan. */
export const slicePlace = signal(0.5);
export const slice = signal<Slice | null>(null);
export const sliceScale = signal<{ top: number; step: number } | null>(null);
export const sliceProblem = signal<string | null>(null);
export const hover = signal<Hover | null>(null);
/** Which way is up. Part of the address of a job. */
export const up = signal<Up>("z");
/** How the picture is seen now. */
export const view = signal<View | null>(null);

const COARSE = 96;
const FINE = 256;
const PAUSE_MS = 60;
let timer = 0;
let asking = new AbortController();

/** The distance at the end of the heat map's colours. */
export const heatTop = computed(() => {
  const found = compared.value;
  return found ? Math.max(quantile(found.summary.sorted, heatShare.value), 1e-12) : 1;
});

/** Where the slice is, in units of the scan. */
export const sliceAt = computed(() => {
  const about = scan.value;
  if (!about) return 0;
  const axis = "xyz".indexOf(sliceAxis.value);
  return about.low[axis] + slicePlace.value * (about.high[axis] - about.low[axis]);
});

/** On to off, and back. */
export function flip(choice: Signal<boolean>): void {
  choice.value = !choice.value;
}

export function toggleSplit(): void {
  split.value = split.value === null ? 0.5 : null;
}

export function toggleHeat(): void {
  flip(heat);
  if (heat.value) compare();
}

export function toggleSlice(): void {
  flip(slicing);
  if (slicing.value) askForSlice();
}

/** Asks for the slice that is wanted now: a coarse one while it is moved, then a fine one. */
export function askForSlice(): void {
  clearTimeout(timer);
  timer = window.setTimeout(() => void fetchSlice(COARSE), PAUSE_MS);
}

/** Another direction is up. */
export function setUp(next: Up): void {
  up.value = next;
  const here = routeOf(location.hash);
  if (here.page === "job") history.replaceState(null, "", hashOf({ ...here, up: next }));
}

/** Back to how a new job is shown. */
export function resetLook(): void {
  const here = routeOf(location.hash);
  up.value = (here.page === "job" && here.up) || "z";
  shown.value = "both";
  heat.value = false;
  split.value = null;
  slicing.value = false;
  slice.value = null;
  sliceProblem.value = null;
  hover.value = null;
  wireframe.value = false;
}

async function fetchSlice(resolution: number): Promise<void> {
  const id = job.value?.id;
  if (!id) return;
  asking.abort();
  asking = new AbortController();
  const { signal } = asking;
  try {
    const answer = await getSlice(id, sliceAxis.value, sliceAt.value, resolution, signal);
    slice.value = readSlice(await answer.arrayBuffer(), (name) => answer.headers.get(name));
    sliceProblem.value = null;
    if (resolution < FINE) {
      timer = window.setTimeout(() => void fetchSlice(FINE), 2 * PAUSE_MS);
    }
  } catch (error) {
    if (signal.aborted) return;
    sliceProblem.value = error instanceof Problem ? error.message : "The slice did not arrive.";
  }
}
