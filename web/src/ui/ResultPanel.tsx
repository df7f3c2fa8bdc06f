import { address, ask, HERE, hasKey, type Job } from "../net/api";
import { duration } from "../pure/eta";
import { bytes, count, counted, length } from "../pure/format";
import * as state from "../state/job";
import { again } from "./actions";
import { Histogram } from "./Histogram";
import { Bar, Facts, ShareButton, Trouble, Warnings } from "./parts";

/** In the order in which they are offered. */
const FILES: [string, string, string][] = [
  ["mesh.ply", "PLY", "mesh, double precision"],
  ["mesh.glb", "GLB", "mesh for viewers, Y up"],
  ["mesh.obj", "OBJ", "mesh as text"],
  ["mesh.stl", "STL", "mesh for slicers; open if the surface is"],
  ["points.ply", "Points", "the densified cloud, PLY"],
  ["field.safetensors", "Field", "answers distance queries"],
  ["report.json", "Report", "parameters, timings, counts"],
];

export function ResultPanel({ job }: { job: Job }) {
  const report = state.report.value;
  const partial = job.state === "canceled" || report?.partial === true;
  return (
    <>
      <p class="eyebrow">{partial ? "Stopped early, what was fitted is kept" : "Done"}</p>
      <h1 class="name">{state.scan.value?.filename ?? "Scan"}</h1>
      {report && <p class="lead">{summaryOf(job)}</p>}
      <Loading job={job} />
      {report && <Facts rows={factsOf()} />}
      {report && <small>Lengths are in the units of the scan.</small>}
      <Warnings words={job.warnings} />
      <Distances />
      <section>
        <h2>Take it home</h2>
        <ul class="downloads">
          {FILES.filter(([name]) => job.outputs[name]).map(([name, label, about]) => (
            <li key={name}>
              <Download job={job} name={name} label={label} about={about} />
            </li>
          ))}
        </ul>
      </section>
      <div class="actions">
        <button type="button" onClick={() => void again(job.id)}>
          Run it again
        </button>
        <ShareButton />
      </div>
    </>
  );
}

/** One sentence that says what is seen. */
function summaryOf(job: Job): string {
  const report = state.report.value;
  if (!report?.mesh) return "";
  const triangles = counted(report.mesh.faces, "triangle");
  const from = report.points ? ` from ${counted(report.points.input, "point")}` : "";
  const seconds = (Date.parse(job.finished_at ?? "") - Date.parse(job.started_at ?? "")) / 1000;
  return `A mesh of ${triangles}${from}, in ${duration(seconds)}.`;
}

function Loading({ job }: { job: Job }) {
  if (state.failure.value) {
    return (
      <Trouble title="The mesh cannot be shown">
        <p>{state.failure.value}</p>
        <p>The downloads below are not affected.</p>
      </Trouble>
    );
  }
  if (state.tooLarge.value) {
    const size = (job.outputs["mesh.ply"]?.bytes ?? 0) + (job.outputs["points.ply"]?.bytes ?? 0);
    return (
      <button type="button" class="main" onClick={() => void state.loadResult(job.id)}>
        Show the mesh ({bytes(size)})
      </button>
    );
  }
  if (state.loading.value === null) return null;
  return <Bar label="Loading the mesh" share={state.loading.value} />;
}

function factsOf(): [string, string][] {
  const report = state.report.value;
  if (!report?.mesh) return [];
  const rows: [string, string][] = [["Vertices", count(report.mesh.vertices)]];
  if (report.points) {
    const { densified, rounds } = report.points;
    const grown = `${count(densified)} in ${counted(rounds, "round")}`;
    rows.push(["Densified to", rounds > 0 ? grown : "as dense as the scan is"]);
    rows.push(["Samples apart", length(report.spacing)]);
    rows.push(["Sample noise", length(report.sample_error)]);
  }
  return rows;
}

function Distances() {
  const found = state.compared.value;
  if (!found) return null;
  const { median, p95, max } = found.summary;
  return (
    <section>
      <h2>Distance of the scan from the mesh</h2>
      <Histogram />
      <Facts
        rows={[
          ["Half below", length(median)],
          ["95 % below", length(p95)],
          ["Largest", length(max)],
        ]}
      />
    </section>
  );
}

interface DownloadProps {
  job: Job;
  name: string;
  label: string;
  about: string;
}

function Download({ job, name, label, about }: DownloadProps) {
  const path = pathOf(job, name);
  const size = bytes(job.outputs[name].bytes);
  return (
    <a href={address(path)} download onClick={(event) => withKey(event, path, name)}>
      <strong>{label}</strong>
      <span>{about}</span>
      <small>{size}</small>
    </a>
  );
}

/** The address of an output without its leading slash: the service may live under a path. */
function pathOf(job: Job, name: string): string {
  return job.outputs[name].url.replace(/^\//, "");
}

/** A link cannot send a key: the file is fetched first then. */
async function withKey(event: Event, path: string, name: string): Promise<void> {
  if (!hasKey()) return;
  event.preventDefault();
  const answer = await ask(`${path}${path.includes("?") ? "&" : "?"}${HERE}`);
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await answer.blob());
  link.download = name;
  link.click();
  URL.revokeObjectURL(link.href);
}
