/** The job that is shown: followed from its beginning, so that every tab shows the same. */

import { signal } from "@preact/signals";
import {
  ask,
  ENDED,
  estimate,
  getJob,
  getReport,
  getScan,
  HERE,
  type Job,
  type Report,
  type ScanInfo,
} from "../net/api";
import { follow, type JobEvent } from "../net/events";
import { Eta, type TimeLeft } from "../pure/eta";
import type { PlyMesh } from "../pure/formats/ply";
import type { Frame } from "../pure/frame";
import type { Summary } from "../pure/histogram";
import { StageClock, type StageEvent } from "../pure/stages";
import type { ResultAnswer } from "../workers/result.worker";
import { isPhone, spoken } from "./app";

export interface LossPoint {
  seconds: number;
  loss: number;
  points: number;
  round: number;
}

export interface Result {
  mesh: PlyMesh;
  cloud: PlyMesh;
  measured: number;
}

/** Triangles above which a phone is asked before it loads them. */
const MANY = 300_000;

export const job = signal<Job | null>(null);
export const scan = signal<ScanInfo | null>(null);
export const report = signal<Report | null>(null);
export const result = signal<Result | null>(null);
export const compared = signal<{ values: Float32Array; summary: Summary } | null>(null);
/** 0 to 1 of the result's bytes; null when nothing is being loaded. */
export const loading = signal<number | null>(null);
export const tooLarge = signal(false);
export const frames = signal<{ points: Frame | null; mesh: Frame | null }>({
  points: null,
  mesh: null,
});
/** Seconds that the service expects of the whole job, before its own progress tells better. */
export const expected = signal<TimeLeft | null>(null);
export const losses = signal<LossPoint[]>([]);
export const live = signal(true);
export const failure = signal<string | null>(null);
/** Advances each second, so that times advance. */
export const tick = signal(0);

export let clock = new StageClock();
export let eta = new Eta();
let stopFollowing: () => void = () => {};
let worker: Worker | null = null;
let attempt = 0;
let told = -1;

/** Shows a job from now on. */
export function watch(id: string): void {
  leave();
  stopFollowing = follow(id, {
    snapshot: (found) => update(found),
    event: take,
    frame: (frame) => {
      frames.value = { ...frames.value, [frame.kind]: frame };
    },
    live: (heard) => {
      live.value = heard;
    },
    ended: () => void conclude(id),
    failed: (problem) => {
      failure.value = problem.message;
    },
  });
}

/** Shows no job any more. */
export function leave(): void {
  stopFollowing();
  stopFollowing = () => {};
  worker?.terminate();
  worker = null;
  for (const cleared of [job, scan, report, result, compared, loading, failure, expected]) {
    cleared.value = null;
  }
  frames.value = { points: null, mesh: null };
  tooLarge.value = false;
  live.value = true;
  told = -1;
  restart(0);
}

/** Distances of the measured points from the mesh; done once. */
export function compare(): void {
  if (result.value && !compared.value) worker?.postMessage({ ask: "compare" });
}

/** How many points of the densified cloud, the first ones, were measured. */
function measured(found: Report | null): number {
  return found?.points?.measured ?? found?.points?.unique ?? 0;
}

/** Fetches the mesh and the points and reads them. */
export async function loadResult(id: string): Promise<void> {
  tooLarge.value = false;
  loading.value = 0;
  try {
    const outputs = job.value?.outputs ?? {};
    const total = (outputs["mesh.ply"]?.bytes ?? 0) + (outputs["points.ply"]?.bytes ?? 0);
    let seen = 0;
    const count = (bytes: number) => {
      seen += bytes;
      loading.value = total ? seen / total : 0;
    };
    const [mesh, cloud] = await Promise.all([
      fetchBytes(`v1/jobs/${id}/mesh?format=ply&${HERE}`, count),
      fetchBytes(`v1/jobs/${id}/points?${HERE}`, count),
    ]);
    if (job.value?.id !== id) return;
    read(mesh, cloud, measured(report.value));
  } catch (error) {
    loading.value = null;
    failure.value = (error as Error).message;
  }
}

function read(mesh: ArrayBuffer, cloud: ArrayBuffer, measured: number): void {
  worker = new Worker(new URL("../workers/result.worker.ts", import.meta.url), { type: "module" });
  worker.onmessage = ({ data }: MessageEvent<ResultAnswer>) => {
    loading.value = null;
    if (data.answer === "read") result.value = data;
    else if (data.answer === "compared") compared.value = data;
    else failure.value = data.words;
  };
  worker.postMessage({ ask: "read", mesh, cloud, measured }, [mesh, cloud]);
}

function update(found: Job): void {
  if (found.attempt !== attempt) restart(found.attempt);
  if (job.value === null && !ENDED.includes(found.state)) void expect(found);
  if (!scan.value)
    void getScan(found.scan_id).then(
      (about) => {
        scan.value = about;
      },
      () => {},
    ); // the scan may have been deleted; the job stands on its own
  job.value = found;
  heard(Date.now() / 1000, found as unknown as Partial<StageEvent>);
}

async function expect({ id, scan_id, config }: Job): Promise<void> {
  try {
    const { seconds } = await estimate(scan_id, config.preset, config);
    if (job.value?.id === id) expected.value = { low: seconds.low, high: seconds.high };
  } catch {
    // then its progress alone tells
  }
}

function take(event: JobEvent): void {
  const current = job.value;
  if (!current) return;
  const seconds = Date.parse(event.time) / 1000;
  const data = event.data as Partial<Job> & Partial<StageEvent> & { attempt?: number };
  if (data.attempt !== undefined && data.attempt !== attempt) restart(data.attempt);
  if (ENDED.includes(current.state)) return; // a replay: the record knows how it ended
  if (event.type === "state" || event.type === "end") {
    job.value = { ...current, ...(data as Partial<Job>) };
    return;
  }
  if (!["stage", "progress", "densify"].includes(event.type)) return;
  const { stage, progress, eta_s, points, round, rounds, loss } = data as Partial<Job>;
  const next = { stage, progress, eta_s, points, round, rounds, loss };
  job.value = {
    ...current,
    state: current.state === "queued" ? "running" : current.state,
    ...next,
  } as Job;
  heard(seconds, data);
  eta.push(seconds, data.eta_s ?? null);
  remember(seconds, data);
  tell(data.progress ?? 0, data);
}

function heard(seconds: number, data: Partial<StageEvent>): void {
  if (!data.stage) return;
  const { stage, step = 0, total = 0, round = 0, rounds = 0 } = data;
  clock.push(seconds, { stage, step, total, round, rounds });
  tick.value++;
}

/** One point on the loss chart for each new fit. */
function remember(seconds: number, data: Partial<Job>): void {
  const { loss, points, round } = data;
  const last = losses.value.at(-1);
  if (loss == null || last?.loss === loss) return;
  losses.value = [...losses.value, { seconds, loss, points: points ?? 0, round: round ?? 0 }];
}

/** Says aloud what is new, in steps of ten per cent. */
function tell(progress: number, data: Partial<Job>): void {
  const step = Math.floor(progress * 10);
  if (step <= told) return;
  told = step;
  spoken.value = `${data.stage}, ${step * 10} per cent, ${data.points ?? 0} points`;
}

function restart(next: number): void {
  attempt = next;
  clock = new StageClock();
  eta = new Eta();
  losses.value = [];
}

async function conclude(id: string): Promise<void> {
  try {
    const found = await getJob(id);
    if (job.value && job.value.id !== id) return;
    job.value = found;
    clock.end(found.finished_at ? Date.parse(found.finished_at) / 1000 : Date.now() / 1000);
    tick.value++;
    spoken.value = found.error
      ? `The job has ${found.state}: ${found.error.message}`
      : `The job has ${found.state}.`;
    if (!found.outputs["mesh.ply"] || !found.outputs["points.ply"]) return;
    report.value = await getReport(id);
    if (isPhone.matches && report.value.mesh.faces > MANY) tooLarge.value = true;
    else await loadResult(id);
  } catch (error) {
    failure.value = (error as Error).message;
  }
}

async function fetchBytes(path: string, count: (bytes: number) => void): Promise<ArrayBuffer> {
  const answer = await ask(path);
  const reader = answer.body?.getReader();
  if (!reader) return answer.arrayBuffer();
  const parts: Uint8Array<ArrayBuffer>[] = [];
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return new Blob(parts).arrayBuffer();
    parts.push(value);
    count(value.length);
  }
}
