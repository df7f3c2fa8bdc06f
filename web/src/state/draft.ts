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
import { type Box, isInside } from "../pure/formats/crop";
import type { ScanAnswer, ScanQuestion } from "../workers/scan.worker";
import { go, info, isPhone, jobs, spoken } from "./app";
import { up } from "./look";

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
/** The sample that the service is making. */
export const fetching = signal<string | null>(null);
export const upload = signal<UploadState | null>(null);
export const choice = signal<Choice | null>(null);
export const starting = signal(false);
/** The part of the scan that is to be sent; null for all of it. */
export const crop = signal<Box | null>(null);

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

/** The job that the scan on the picture has become; null when the picture is another one. */
export const handedOver = signal<string | null>(null);

/** About how much of the scan the box holds, 0 to 1. */
export const keptShare = computed(() => {
  const [box, found] = [crop.value, preview.value];
  if (!box || !found || found.positions.length === 0) return 1;
  const { positions: p, origin } = found;
  let inside = 0;
  for (let i = 0; i < p.length; i += 3) {
    if (isInside(box, p[i] + origin[0], p[i + 1] + origin[1], p[i + 2] + origin[2])) inside++;
  }
  return (3 * inside) / p.length;
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
  const seconds = guessedSeconds(wanted, (preview.value?.total ?? 0) * keptShare.value, jobs.value);
  return seconds === null ? null : { low: seconds, high: seconds };
});

effect(() => {
  const wanted = choice.value;
  const config = changes.value;
  expected.value = null;
  if (!wanted || !scanId || crop.value) return; // the service knows the whole scan alone
  const timer = setTimeout(() => void expect(wanted.preset, config), 150);
  return () => clearTimeout(timer);
});

/** Takes a file: shows what is in it, and sends nothing. */
export function take(file: Blob, name: string, sample: string | null = null): void {
  forget();
  up.value = "z";
  draft.value = { name, bytes: file.size, file, sample };
  reading.value = true;
  const most = isPhone.matches ? MOST_ON_PHONES : MOST_POINTS;
  void asked({ ask: "preview", file, most }).then((answer) => {
    reading.value = false;
    if ("scan" in answer) {
      preview.value = answer.scan;
      if (answer.scan.format === "glb") up.value = "y"; // as the format demands
    } else if ("problem" in answer) {
      problem.value = { title: "No preview", words: answer.problem, refused: false };
    }
  });
}

/** Asks a reader beside the page; the one before is stopped. */
function asked(question: ScanQuestion): Promise<ScanAnswer> {
  reader?.terminate();
  const made = new Worker(new URL("../workers/scan.worker.ts", import.meta.url), {
    type: "module",
  });
  reader = made;
  return new Promise((resolve) => {
    made.onmessage = ({ data }: MessageEvent<ScanAnswer>) => {
      made.terminate();
      resolve(data);
    };
    made.postMessage(question);
  });
}

/** Takes a scan that the service makes. */
export async function takeSample(name: string): Promise<void> {
  fetching.value = name;
  try {
    take(await getSample(name), `${name}.ply`, name);
  } finally {
    fetching.value = null;
  }
  const scan = await makeSample(name);
  if (draft.value?.sample !== name) return;
  scanId = scan.id;
  choice.value = choice.value && { ...choice.value }; // so that it is estimated
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
    const sent = await cropped(current);
    const scan = sent.sample ? await makeSample(sent.sample) : await send(sent);
    const job = await createJob(scan.id, wanted.preset, changes.value, sent.name, once());
    handedOver.value = crop.value ? null : job.id;
    spoken.value = `${sent.name} is uploaded; the job is queued.`;
    go({ page: "job", id: job.id, up: up.value });
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

/** What is to be sent: the file as it is, or the part of it in the box.
 * @throws Error when there is nothing in the box.
 */
async function cropped(current: Draft): Promise<Draft> {
  const box = crop.value;
  if (!box) return current;
  const answer = await asked({ ask: "crop", file: current.file, box });
  if (!("cropped" in answer)) throw new Error("problem" in answer ? answer.problem : "");
  const name = `${current.name.replace(/\.[^.]*$/, "")}-part.ply`;
  return { name, bytes: answer.cropped.size, file: answer.cropped, sample: null };
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
  for (const cleared of [draft, preview, problem, upload, choice, crop]) cleared.value = null;
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
