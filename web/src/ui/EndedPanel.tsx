import type { Job } from "../net/api";
import { go } from "../state/app";
import { failure, job, scan } from "../state/job";
import { again } from "./actions";
import { sentence, Trouble } from "./parts";

const TITLES: Partial<Record<Job["state"], string>> = {
  failed: "The job failed",
  canceled: "The job was stopped",
  expired: "The job never started",
};

/** A job without a result: why, and what to do. */
export function EndedPanel() {
  const found = job.value;
  const words = found?.error?.message ?? failure.value;
  return (
    <>
      <p class="eyebrow">No result</p>
      <h1 class="name">{scan.value?.filename ?? "Job"}</h1>
      <Trouble title={(found && TITLES[found.state]) ?? "This job cannot be shown"}>
        <p>{words ? sentence(words) : "It was stopped before there was anything to keep."}</p>
      </Trouble>
      <div class="actions">
        {found && (
          <button type="button" class="main" onClick={() => void again(found.id)}>
            Try again
          </button>
        )}
        <button type="button" onClick={() => go({ page: "start" })}>
          Another scan
        </button>
      </div>
    </>
  );
}
