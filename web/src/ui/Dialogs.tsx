import { signal } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import { cancelJob, listJobs, setKey } from "../net/api";
import { dialog, info, jobs, loadStart, route } from "../state/app";
import { failure, job, leave, watch } from "../state/job";
import { JobCard } from "./JobCard";
import { Share } from "./Share";

const KEYS: [string, string][] = [
  ["F", "show everything"],
  ["U", "which way is up"],
  ["1 2 3", "points, mesh, both"],
  ["W", "wireframe"],
  ["N", "normals as colours"],
  ["L", "flat faces"],
  ["C", "colours of the scan"],
  ["D", "distances of the scan from the mesh"],
  ["S", "slice through the distance field"],
  ["V", "split view: scan and mesh"],
  ["T", "light or dark"],
  ["arrows", "turn (with the picture in focus)"],
  ["+ −", "nearer, farther"],
  ["Esc", "close"],
];

export function Dialogs() {
  switch (dialog.value) {
    case "help":
      return <Help />;
    case "jobs":
      return <Jobs />;
    case "share":
      return <ShareJob />;
    case "key":
      return <KeyQuestion />;
    case "cancel":
      return <CancelQuestion />;
    default:
      return null;
  }
}

function close(): void {
  dialog.value = null;
}

function Modal({ title, children }: { title: string; children: ComponentChildren }) {
  const element = useRef<HTMLDialogElement>(null);
  useEffect(() => {
    element.current?.showModal();
  }, []);
  return (
    <dialog ref={element} aria-labelledby="dialog-title" onClose={close}>
      <h2 id="dialog-title">{title}</h2>
      {children}
    </dialog>
  );
}

function Help() {
  return (
    <Modal title="Keys">
      <dl class="keys">
        {KEYS.map(([keys, about]) => (
          <div key={keys}>
            <dt>
              {keys.split(" ").map((each) => (
                <kbd key={each}>{each}</kbd>
              ))}
            </dt>
            <dd>{about}</dd>
          </div>
        ))}
      </dl>
      <p class="quiet">
        Drag turns, the wheel or two fingers zoom, the right button moves. Lengths are in the units
        of the scan. udflow {info.value?.version}
      </p>
      <div class="actions">
        <button type="button" class="main" onClick={close}>
          Close
        </button>
      </div>
    </Modal>
  );
}

function Jobs() {
  const [next, setNext] = useState<string | null>(null);
  const load = (cursor?: string) =>
    listJobs(cursor).then(
      (page) => {
        jobs.value = cursor ? [...jobs.value, ...page.jobs] : page.jobs;
        setNext(page.next_cursor);
      },
      () => {}, // the list of before is shown
    );
  useEffect(() => void load(), []);
  return (
    <Modal title="Jobs">
      {jobs.value.length === 0 && <p class="quiet">There is none yet.</p>}
      <ul class="cards many">
        {jobs.value.map((each) => (
          <JobCard key={each.id} job={each} onPick={close} />
        ))}
      </ul>
      <div class="actions">
        {next && (
          <button type="button" onClick={() => void load(next)}>
            Older jobs
          </button>
        )}
        <button type="button" class="main" onClick={close}>
          Close
        </button>
      </div>
    </Modal>
  );
}

function ShareJob() {
  return (
    <Modal title="Share this job">
      {job.value && <Share job={job.value} />}
      <div class="actions">
        <button type="button" class="main" onClick={close}>
          Close
        </button>
      </div>
    </Modal>
  );
}

const typed = signal("");

function KeyQuestion() {
  const submit = (event: Event) => {
    event.preventDefault();
    setKey(typed.value.trim());
    close();
    const found = route.value;
    if (found.page === "job") {
      leave();
      watch(found.id);
    }
    void loadStart();
  };
  return (
    <Modal title="This service needs a key">
      <form onSubmit={submit}>
        <label class="parameter wide">
          <span>Key</span>
          <input
            type="password"
            autocomplete="off"
            required
            onInput={(event) => {
              typed.value = event.currentTarget.value;
            }}
          />
          <small>It is kept in this tab, until the tab is closed.</small>
        </label>
        <div class="actions">
          <button type="submit" class="main">
            Go on
          </button>
        </div>
      </form>
    </Modal>
  );
}

function CancelQuestion() {
  const found = job.value;
  const stop = (keepPartial: boolean) => {
    close();
    if (!found) return;
    cancelJob(found.id, keepPartial).then(
      (next) => {
        if (job.value?.id === next.id) job.value = next;
      },
      (error: Error) => {
        failure.value = error.message;
      },
    );
  };
  const canKeep = found?.state === "running";
  return (
    <Modal title="Stop this job?">
      <p>{canKeep ? "A mesh can be made of what is fitted so far." : "Nothing is fitted yet."}</p>
      <div class="actions">
        {canKeep && (
          <button type="button" class="main" onClick={() => stop(true)}>
            Stop, keep what we have
          </button>
        )}
        <button type="button" class="danger" onClick={() => stop(false)}>
          Stop and discard
        </button>
        <button type="button" onClick={close}>
          Let it run
        </button>
      </div>
    </Modal>
  );
}
