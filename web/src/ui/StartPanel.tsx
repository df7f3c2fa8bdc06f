import { useRef } from "preact/hooks";
import { count } from "../pure/format";
import { dialog, info, jobs, loadStart, samples, trouble } from "../state/app";
import { fetching, takeSample } from "../state/draft";
import { takeFile } from "./App";
import { JobCard } from "./JobCard";
import { Trouble } from "./parts";

const RECENT = 4;

export function StartPanel() {
  const input = useRef<HTMLInputElement>(null);
  return (
    <>
      <h1>From points to a surface.</h1>
      <p class="lead">
        Drop a scan anywhere. It needs no normals, no inside and no outside: open sheets stay open,
        walls stay thin.
      </p>
      <input
        ref={input}
        class="unseen"
        type="file"
        tabIndex={-1}
        aria-label="A scan"
        onChange={(event) => takeFile(event.currentTarget.files?.[0])}
      />
      <button type="button" class="main" onClick={() => input.current?.click()}>
        Choose a scan…
      </button>
      <p class="quiet formats">
        {info.value?.input_formats.map((name) => name.toUpperCase()).join(" · ")}
      </p>
      {trouble.value && (
        <Trouble title="The service cannot be reached">
          <p>{trouble.value}</p>
          <button type="button" onClick={() => void loadStart()}>
            Try again
          </button>
        </Trouble>
      )}
      {samples.value.length > 0 && <Samples />}
      {jobs.value.length > 0 && (
        <section>
          <h2>
            Lately{" "}
            <button type="button" class="plain" onClick={showJobs}>
              all jobs
            </button>
          </h2>
          <ul class="cards">
            {jobs.value.slice(0, RECENT).map((job) => (
              <JobCard key={job.id} job={job} />
            ))}
          </ul>
        </section>
      )}
    </>
  );
}

function showJobs(): void {
  dialog.value = "jobs";
}

function Samples() {
  const pick = (name: string) =>
    takeSample(name).catch((error: Error) => {
      trouble.value = error.message;
    });
  return (
    <section>
      <h2>Or try a sample</h2>
      <ul class="samples">
        {samples.value.map((sample) => (
          <li key={sample.name}>
            <button
              type="button"
              aria-busy={fetching.value === sample.name}
              onClick={() => void pick(sample.name)}
            >
              <strong>{sample.title}</strong>
              <span>{sample.about}</span>
              <small>
                {fetching.value === sample.name
                  ? "being simulated…"
                  : `${count(sample.points)} points`}
              </small>
            </button>
          </li>
        ))}
      </ul>
    </section>
  );
}
