import { useEffect, useState } from "preact/hooks";
import type { Job } from "../net/api";
import { duration, inWords, remaining } from "../pure/eta";
import { count } from "../pure/format";
import type { StageState } from "../pure/stages";
import { dialog } from "../state/app";
import { clock, eta, expected, failure, frames, live, losses, scan, tick } from "../state/job";
import { LossChart } from "./LossChart";
import { Bar, ShareButton, Trouble } from "./parts";

export function RunPanel({ job }: { job: Job }) {
  useSeconds();
  const waits = job.state === "queued";
  return (
    <>
      <p class="eyebrow">{waits ? placeOf(job) : (HEADS[job.state] ?? "Growing")}</p>
      <h1 class="name">{scan.value?.filename ?? "Scan"}</h1>
      {!live.value && (
        <p class="reconnecting" role="status">
          The service does not answer. Reconnecting…
        </p>
      )}
      {failure.value && (
        <Trouble title="The picture cannot be kept up">
          <p>{failure.value}</p>
        </Trouble>
      )}
      <Counter job={job} />
      <Stages states={waits ? [] : clock.at(Date.now() / 1000)} />
      <p class="figures">{timeLeft(job)}</p>
      {losses.value.length > 1 && (
        <section>
          <h2>Loss after each fit</h2>
          <LossChart />
        </section>
      )}
      <div class="actions">
        <button type="button" onClick={askToCancel} disabled={job.state === "canceling"}>
          {job.state === "canceling" ? "Stopping…" : "Stop…"}
        </button>
        <ShareButton />
      </div>
    </>
  );
}

const HEADS: Partial<Record<Job["state"], string>> = {
  running: "Running",
  canceling: "Stopping",
  succeeded: "Done",
};

function placeOf(job: Job): string {
  const place = job.queue_position;
  if (job.attempt > 1) return "Waiting to start again";
  return place && place > 1 ? `Waiting, number ${place} in the queue` : "Waiting for a worker";
}

/** 9 000 → 30 000 */
function Counter({ job }: { job: Job }) {
  const points = frames.value.points;
  const target = job.config.densify?.target_points ?? 0;
  const now = job.points ?? points?.total ?? scan.value?.points ?? 0;
  const grows = target > now || job.round > 0;
  return (
    <div class="counter">
      <p>
        <strong>{count(now)}</strong>
        {grows && <span> → {count(Math.max(target, now))} points</span>}
        {!grows && <span> points</span>}
      </p>
      <p class="quiet">
        {job.rounds > 0
          ? job.round > 0
            ? `densified in round ${job.round} of ${job.rounds}`
            : `${job.rounds} rounds of densification to come`
          : " "}
      </p>
    </div>
  );
}

function Stages({ states }: { states: StageState[] }) {
  return (
    <ol class="stages">
      {states.map((stage) => (
        <li key={stage.name} class={stage.state}>
          <span>{stage.name}</span>
          {stage.state === "running" ? (
            <Bar label={stage.name} share={stage.share} />
          ) : (
            <div class={`bar ${stage.state}`}>
              <i style={{ width: stage.state === "done" ? "100%" : "0" }} />
            </div>
          )}
          <small>{stage.seconds === null ? "" : duration(stage.seconds)}</small>
        </li>
      ))}
    </ol>
  );
}

function timeLeft(job: Job): string {
  const whole = expected.value;
  if (job.state === "queued") {
    const long = whole ? ` It takes ${inWords(whole)}.` : "";
    return `It starts as soon as a worker is free.${long}`;
  }
  if (job.state === "canceling") return "It stops after the step it is at.";
  const now = Date.now() / 1000;
  const elapsed = now - Date.parse(job.started_at ?? "") / 1000;
  const left = eta.at(now) ?? (whole && remaining(whole, elapsed));
  const share = `${Math.round(100 * job.progress)} %`;
  if (left) return `${share} · ${inWords(left)} left`;
  return `${share} · ${whole ? "it takes longer than expected" : "estimating the time…"}`;
}

function askToCancel(): void {
  dialog.value = "cancel";
}

/** Draws again each second, so that times go on. */
function useSeconds(): void {
  const [, set] = useState(0);
  void tick.value;
  useEffect(() => {
    const timer = setInterval(() => set((value) => value + 1), 1000);
    return () => clearInterval(timer);
  }, []);
}
