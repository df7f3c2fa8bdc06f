/** A scan that was dropped but not sent: its preview, its parameters, its way to the service. */

import { computed, effect, signal } from "@preact/signals";
import {
  type Config,
  createJob,
  estimate,
  getSample,
  type Job,
  makeSample,
  Problem,
  type ScanInfo,
} from "../net/api";
import { Upload, type UploadState } from "../net/upload";
import type { TimeLeft } from "../pure/eta";
import type { Scan } from "../pure/formats/collector";
import type { ScanAnswer } from "../workers/scan.worker";
import { go, info, isPhone, jobs, spoken } from "./app";

export interface Draft {
  name: string;
  bytes: number;
  file: Blob;
  /** Set where the service can make the scan itself. */
  sample: string | null;
}

export interface Choice {
  preset: string;
  target: number;
  perRound: number;
  resolution: number;
  seed: number;
}

const MOST_POINTS = 500_000;
const MOST_ON_PHONES = 200_000;

export const draft = signal<Draft | null>(null);
export const preview = signal<Scan | null>(null);
/** What went wrong. refused: the service will never take these bytes. */
export const problem = signal<{ title: string; words: string; refused: boolean } | null>(null);
export const reading = signal(false);
export const upload = signal<UploadState | null>(null);
export const choice = signal<Choice | null>(null);
export const starting = signal(false);

let sending: Upload | null = null;
let reader: Worker | null = null;

/** What the service expects of the chosen job; null where the scan is not there yet. */
const expected = signal<TimeLeft | null>(null);
let scanId: string | null = null;

// the first preset, as soon as there is a scan and the presets are known: either may come first
effect(() => {
  const preset = Object.keys(info.value?.presets ?? {})[0];
  if (draft.value && !choice.value && preset) choose(preset);
});

/** What the job will be given besides its preset. */
export const changes = computed(() => {
  const wanted = choice.value;
  const base = wanted && info.value?.presets[wanted.preset];
  if (!wanted || !base) return {};
  return changesOf(wanted, base);
});

/** About how long it will take here: by the service's own estimate, else by what the most similar
 * job took; null if there is none. */
export const guess = computed((): TimeLeft | null => {
  const wanted = choice.value;
  if (!wanted || expected.value) return expected.value;
  const seconds = guessedSeconds(wanted, preview.value?.total ?? 0, jobs.value);
  return seconds === null ? null : { low: seconds, high: seconds };
});

effect(() => {
  const wanted = choice.value;
  const config = changes.value;
  expected.value = null;
  if (!wanted || !scanId) return;
  const timer = setTimeout(() => void expect(wanted.preset, config), 150);
  return () => clearTimeout(timer);
});

/** Takes a file: shows what is in it, and sends nothing. */
export function take(file: Blob, name: string, sample: string | null = null): void {
  forget();
  draft.value = { name, bytes: file.size, file, sample };
  reading.value = true;
  reader = new Worker(new URL("../workers/scan.worker.ts", import.meta.url), { type: "module" });
  reader.onmessage = ({ data }: MessageEvent<ScanAnswer>) => {
    reading.value = false;
    if ("scan" in data) preview.value = data.scan;
    else problem.value = { title: "No preview", words: data.problem, refused: false };
    reader?.terminate();
  };
  reader.postMessage({ file, most: isPhone.matches ? MOST_ON_PHONES : MOST_POINTS });
}

/** Takes a scan that the service makes. */
export async function takeSample(name: string): Promise<void> {
  const [file, scan] = await Promise.all([getSample(name), makeSample(name)]);
  take(file, `${name}.ply`, name);
  scanId = scan.id;
  choice.value = choice.value && { ...choice.value };
}

/** Begins with the parameters of a preset. */
export function choose(preset: string): void {
  const base = info.value?.presets[preset];
  if (!base) return;
  choice.value = {
    preset,
    target: base.densify.target_points,
    perRound: base.densify.points_per_round,
    resolution: base.extract.resolution,
    seed: base.seed,
  };
}

/** Sends the scan, queues a job and goes there. */
export async function start(): Promise<void> {
  const current = draft.value;
  const wanted = choice.value;
  if (!current || !wanted || starting.value) return;
  starting.value = true;
  problem.value = null;
  try {
    const scan = current.sample ? await makeSample(current.sample) : await send(current);
    const job = await createJob(scan.id, wanted.preset, changes.value, current.name, once());
    spoken.value = `${current.name} is uploaded; the job is queued.`;
    go({ page: "job", id: job.id });
  } catch (error) {
    if (error instanceof DOMException) return; // stopped by hand
    const refused = error instanceof Problem && [413, 415, 422].includes(error.status);
    problem.value = { title: "This scan was not taken", words: (error as Error).message, refused };
  } finally {
    starting.value = false;
    upload.value = null;
    sending = null;
  }
}

/** A key that makes a repeated request harmless. `crypto.randomUUID` is for https alone. */
function once(): string {
  return crypto.getRandomValues(new Uint32Array(4)).join("-");
}

/** Lets go of the scan. */
export function forget(): void {
  sending?.stop();
  reader?.terminate();
  scanId = null;
  for (const cleared of [draft, preview, problem, upload, choice]) cleared.value = null;
  reading.value = false;
}

export const pause = () => sending?.pause();
export const goOn = () => sending?.goOn();
export const stopUpload = () => sending?.stop();

async function expect(preset: string, config: Record<string, unknown>): Promise<void> {
  try {
    const { seconds } = await estimate(scanId as string, preset, config);
    if (choice.value?.preset === preset) expected.value = { low: seconds.low, high: seconds.high };
  } catch {
    expected.value = null; // the job itself will say what is wrong with it
  }
}

async function send(current: Draft): Promise<ScanInfo> {
  sending = new Upload(current.file, current.name, (state) => {
    upload.value = state;
  });
  return sending.run();
}

function changesOf(wanted: Choice, base: Config): Record<string, unknown> {
  const found: Record<string, unknown> = {};
  const densify: Record<string, number> = {};
  if (wanted.target !== base.densify.target_points) densify.target_points = wanted.target;
  if (wanted.perRound !== base.densify.points_per_round) densify.points_per_round = wanted.perRound;
  if (Object.keys(densify).length) found.densify = densify;
  if (wanted.resolution !== base.extract.resolution) {
    found.extract = { resolution: wanted.resolution };
  }
  if (wanted.seed !== base.seed) found.seed = wanted.seed;
  return found;
}

/** The seconds of the finished job that was most like this one. */
export function guessedSeconds(wanted: Choice, points: number, known: Job[]): number | null {
  let best: { seconds: number; unlike: number } | null = null;
  for (const job of known) {
    if (job.state !== "succeeded" || !job.started_at || !job.finished_at || !job.points) continue;
    if (job.config.preset !== wanted.preset || !job.config.densify) continue;
    const unlike =
      off(job.points, Math.max(points, wanted.target)) +
      off(job.config.densify.points_per_round, wanted.perRound) +
      off(job.config.extract.resolution, wanted.resolution);
    const seconds = (Date.parse(job.finished_at) - Date.parse(job.started_at)) / 1000;
    if (unlike < 1 && (best === null || unlike < best.unlike)) best = { seconds, unlike };
  }
  return best?.seconds ?? null;
}

/** How far two numbers are apart, in powers of e. */
function off(first: number, second: number): number {
  return Math.abs(Math.log(Math.max(first, 1) / Math.max(second, 1)));
}
