/** The HTTP interface, as docs/api.md tells it. */

/** The service lives where the page does, under whatever path. */
const BASE = new URL(".", document.baseURI);

export type JobState =
  | "queued"
  | "running"
  | "canceling"
  | "succeeded"
  | "failed"
  | "canceled"
  | "expired";

export interface Job {
  id: string;
  scan_id: string;
  state: JobState;
  stage: string | null;
  progress: number;
  eta_s: number | null;
  queue_position: number | null;
  attempt: number;
  device: string | null;
  points: number | null;
  round: number;
  rounds: number;
  loss: number | null;
  error: { code: string; message: string } | null;
  warnings: string[];
  outputs: Record<string, { bytes: number; sha256: string; url: string }>;
  config: Config;
  metadata: Record<string, string>;
  created_at: string;
  started_at: string | null;
  finished_at: string | null;
  expires_at: string | null;
}

export interface ScanInfo {
  id: string;
  filename: string;
  bytes: number;
  format: string;
  points: number;
  dropped: number;
  low: [number, number, number];
  high: [number, number, number];
  extent: [number, number, number];
  spacing: number;
  noise: number;
  has_colors: boolean;
  has_normals: boolean;
  shift: [number, number, number] | null;
  warnings: string[];
}

export interface Config {
  preset: string;
  densify: { target_points: number; points_per_round: number };
  extract: { resolution: number };
  seed: number;
  [part: string]: unknown;
}

export interface Info {
  version: string;
  presets: Record<string, Config>;
  input_formats: string[];
  output_formats: string[];
  limits: Record<string, number>;
  workers: number;
  devices: string[];
}

export interface SampleInfo {
  name: string;
  title: string;
  about: string;
  points: number;
}

export interface Report {
  points: { input: number; unique: number; measured?: number; densified: number; rounds: number };
  mesh: { vertices: number; faces: number };
  spacing: number;
  sample_error: number;
  seconds: Record<string, number>;
  partial?: boolean;
  device: string;
}

export const ENDED: readonly JobState[] = ["succeeded", "failed", "canceled", "expired"];

/** An answer that is no success: cause and remedy in the words of the service. */
export class Problem extends Error {
  constructor(
    readonly status: number,
    readonly code: string,
    detail: string,
  ) {
    super(detail);
  }
}

const KEY = "udflow.key";
let key = sessionStorage.getItem(KEY);

/** Keeps the key of the service for as long as this tab lives. */
export function setKey(value: string): void {
  key = value;
  sessionStorage.setItem(KEY, value);
}

export function hasKey(): boolean {
  return key !== null;
}

/** The address of something of the service. */
export function address(path: string): string {
  return new URL(path, BASE).href;
}

/** The headers that every request needs. */
export function keyHeaders(): Record<string, string> {
  return key === null ? {} : { Authorization: `Bearer ${key}` };
}

/** Asks the service.
 * @throws Problem for any answer that is no success, and when there is none.
 */
export async function ask(path: string, options: RequestInit = {}): Promise<Response> {
  const headers = { ...keyHeaders(), ...(options.headers as Record<string, string>) };
  let answer: Response;
  try {
    answer = await fetch(address(path), { ...options, headers });
  } catch (error) {
    if (options.signal?.aborted) throw error;
    throw new Problem(0, "offline", "The service does not answer. It may be restarting.");
  }
  if (!answer.ok) throw await problemOf(answer.status, await answer.text());
  return answer;
}

/** The problem that a body tells of. */
export function problemOf(status: number, body: string): Problem {
  try {
    const values = JSON.parse(body);
    return new Problem(status, values.code ?? "unknown", values.detail ?? values.title ?? body);
  } catch {
    return new Problem(status, "unknown", `The service answered ${status} without a reason.`);
  }
}

/** Files of a job through the service, even where they lie in a bucket: the page may load from
 * nowhere else. */
export const HERE = "redirect=false";

async function json<T>(path: string, options?: RequestInit): Promise<T> {
  return (await ask(path, options)).json();
}

function post(values?: unknown, more: Record<string, string> = {}): RequestInit {
  if (values === undefined) return { method: "POST", headers: more };
  const headers = { "Content-Type": "application/json", ...more };
  return { method: "POST", headers, body: JSON.stringify(values) };
}

export const getInfo = () => json<Info>("v1/info");
export const getSamples = () =>
  json<{ samples: SampleInfo[] }>("v1/samples").then((answer) => answer.samples);
export const getSample = (name: string) =>
  ask(`v1/samples/${name}`).then((answer) => answer.blob());
export const makeSample = (name: string) => json<ScanInfo>(`v1/samples/${name}`, post());
/** Stands for the key once, in the address of a websocket, which can send no header. */
export const getTicket = () =>
  json<{ ticket: string }>("v1/tickets", post()).then((answer) => answer.ticket);
export const getScan = (id: string) => json<ScanInfo>(`v1/scans/${id}`);
export const getJob = (id: string) => json<Job>(`v1/jobs/${id}`);
/** The newest jobs; cursor: those after a page of them. */
export function listJobs(cursor?: string): Promise<{ jobs: Job[]; next_cursor: string | null }> {
  return json(`v1/jobs?limit=24${cursor ? `&cursor=${encodeURIComponent(cursor)}` : ""}`);
}
export const getReport = (id: string) => json<Report>(`v1/jobs/${id}/report?${HERE}`);
export const cancelJob = (id: string, keepPartial: boolean) =>
  json<Job>(`v1/jobs/${id}/cancel`, post({ keep_partial: keepPartial }));
export const retryJob = (id: string) => json<Job>(`v1/jobs/${id}/retry`, post());

/** Queues a job. once: makes a repeated request harmless. */
export function createJob(
  scanId: string,
  preset: string,
  config: Record<string, unknown>,
  name: string,
  once: string,
): Promise<Job> {
  const body = { scan_id: scanId, preset, config, metadata: { name: name.slice(0, 200) } };
  return json<Job>("v1/jobs", post(body, { "Idempotency-Key": once }));
}

export interface Estimate {
  seconds: { expected: number; low: number; high: number };
}

/** What a job for a scan would take on this machine. Nothing is queued. */
export function estimate(
  scanId: string,
  preset: string,
  config: Record<string, unknown>,
): Promise<Estimate> {
  const body = { scan_id: scanId, preset, config };
  return json<{ estimate: Estimate }>("v1/jobs?validate_only=true", post(body)).then(
    (answer) => answer.estimate,
  );
}

/** A slice across an axis. */
export function getSlice(
  id: string,
  axis: string,
  at: number,
  resolution: number,
  signal: AbortSignal,
): Promise<Response> {
  const wish = { axis, at, resolution, format: "npy" };
  return ask(`v1/jobs/${id}/udf/slice`, { ...post(wish), signal });
}
