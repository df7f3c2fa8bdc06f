import { useEffect, useState } from "preact/hooks";
import { address, ask, HERE, hasKey, type Job } from "../net/api";
import { ago, count } from "../pure/format";
import { hashOf } from "../pure/route";

const WORDS: Record<Job["state"], string> = {
  queued: "waiting",
  running: "running",
  canceling: "stopping",
  succeeded: "done",
  failed: "failed",
  canceled: "stopped",
  expired: "never started",
};

/** A job in a list, with its picture. */
export function JobCard({ job, onPick }: { job: Job; onPick?: () => void }) {
  const title = job.metadata.name ?? "A scan";
  const when = ago((Date.now() - Date.parse(job.created_at)) / 1000);
  return (
    <li>
      <a class="card" href={hashOf({ page: "job", id: job.id })} onClick={onPick}>
        <Thumbnail job={job} />
        <span class="card-text">
          <strong>{title}</strong>
          <span>
            <i class={`state ${job.state}`} /> {WORDS[job.state]}
            {job.state === "running" && ` ${Math.round(100 * job.progress)} %`}
          </span>
          <small>
            {when}
            {job.points ? ` · ${count(job.points)} points` : ""}
          </small>
        </span>
      </a>
    </li>
  );
}

/** The picture of the mesh. With a key an image cannot be asked for by its address alone. */
function Thumbnail({ job }: { job: Job }) {
  const path = `v1/jobs/${job.id}/preview.png?${HERE}`;
  const [source, setSource] = useState<string | null>(hasKey() ? null : address(path));
  const has = job.outputs["preview.png"] !== undefined;
  useEffect(() => {
    if (!has || !hasKey()) return undefined;
    let made = "";
    ask(path)
      .then((answer) => answer.blob())
      .then((blob) => {
        made = URL.createObjectURL(blob);
        setSource(made);
      })
      .catch(() => {}); // a list without one picture is still a list
    return () => URL.revokeObjectURL(made);
  }, [path, has]);
  return (
    <span class="thumbnail">
      {has && source && <img src={source} alt="" loading="lazy" width="56" height="56" />}
    </span>
  );
}
