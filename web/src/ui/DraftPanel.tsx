import { duration, inWords } from "../pure/eta";
import { box, bytes, count } from "../pure/format";
import type { Scan } from "../pure/formats/collector";
import { info } from "../state/app";
import * as draft from "../state/draft";
import { Crop } from "./Crop";
import { Bar, Facts, sentence, Trouble, Warnings } from "./parts";

const FAR = 1e5;
const FEW = 100;

export function DraftPanel() {
  const current = draft.draft.value;
  const found = draft.preview.value;
  const trouble = draft.problem.value;
  if (!current) return null;
  return (
    <>
      <p class="eyebrow">{trouble?.refused ? "Refused" : "Preview · nothing is sent yet"}</p>
      <h1 class="name">{current.name}</h1>
      {draft.reading.value && <p class="quiet">Reading the points…</p>}
      {found && <Facts rows={factsOf(found, current.bytes)} />}
      {found && <Warnings words={warningsOf(found)} />}
      {found && noteOf(found) && <p class="quiet">{noteOf(found)}</p>}
      {trouble && (
        <Trouble title={trouble.title}>
          <p>{sentence(trouble.words)}</p>
        </Trouble>
      )}
      {below(trouble?.refused === true)}
    </>
  );
}

function below(refused: boolean) {
  if (draft.upload.value) return <Uploading />;
  if (!refused) return <Settings />;
  return (
    <div class="actions">
      <button type="button" class="main" onClick={draft.forget}>
        Another scan
      </button>
    </div>
  );
}

function factsOf(scan: Scan, size: number): [string, string][] {
  const extent = scan.high.map((value, i) => value - scan.low[i]);
  const holds = [scan.hasColors && "colours", scan.hasNormals && "normals (not needed)"];
  return [
    ["Points", count(scan.total)],
    ["Box", extent.every(Number.isFinite) ? box(extent) : "not stated"],
    ["Holds", holds.filter(Boolean).join(", ") || "positions"],
    ["File", `${scan.format.toUpperCase()}, ${bytes(size)}`],
  ];
}

/** What the service is going to say about it, said before it is sent. */
export function warningsOf(scan: Scan): string[] {
  const words: string[] = [];
  if (scan.dropped > 0) {
    words.push(
      `${count(scan.dropped)} points have coordinates that are no numbers; they are left out.`,
    );
  }
  if (Math.max(...scan.low.map(Math.abs), ...scan.high.map(Math.abs)) > FAR) {
    words.push(
      "The coordinates are large. They are shifted for the fit and shifted back after it.",
    );
  }
  if (scan.total < FEW) words.push(`There are few points; at least ${FEW} are needed.`);
  return words;
}

/** What is to be known of the picture. */
function noteOf(scan: Scan): string | null {
  const shown = scan.positions.length / 3;
  if (scan.note || shown === scan.total) return scan.note;
  return `The picture shows ${count(shown)} of the points.`;
}

function Settings() {
  const names = Object.keys(info.value?.presets ?? {});
  const wanted = draft.choice.value;
  const left = draft.guess.value;
  const found = draft.preview.value;
  return (
    <form
      onSubmit={(event) => {
        event.preventDefault();
        void draft.start();
      }}
    >
      <fieldset class="presets">
        <legend>Preset</legend>
        {names.map((name) => (
          <label key={name} class={wanted?.preset === name ? "chosen" : ""}>
            <input
              type="radio"
              name="preset"
              checked={wanted?.preset === name}
              onChange={() => draft.choose(name)}
            />
            <strong>{name}</strong>
            <span>{ABOUT[name] ?? ""}</span>
            {wanted?.preset === name && (
              <small>
                {left === null
                  ? "no such job was timed here yet"
                  : `${inWords(left)} on this machine`}
              </small>
            )}
          </label>
        ))}
      </fieldset>
      {found && found.positions.length > 0 && <Crop scan={found} />}
      {wanted && <Parameters wanted={wanted} />}
      <div class="actions">
        <button type="submit" class="main" disabled={draft.starting.value || !wanted}>
          {draft.starting.value ? "Starting…" : "Reconstruct"}
        </button>
        <button type="button" onClick={draft.forget}>
          Another scan
        </button>
      </div>
    </form>
  );
}

const ABOUT: Record<string, string> = {
  fast: "One linear solve a time step. Seconds.",
  neural: "The network of the paper, trained shortly. Minutes.",
  paper: "The paper's own protocol. Hours without a GPU.",
};

function Parameters({ wanted }: { wanted: draft.Choice }) {
  const set = (change: Partial<draft.Choice>) => {
    draft.choice.value = { ...wanted, ...change };
  };
  const number = (
    label: string,
    name: keyof draft.Choice,
    low: number,
    high: number,
    about: string,
  ) => (
    <label class="parameter">
      <span>{label}</span>
      <input
        type="number"
        min={low}
        max={high}
        step="1"
        required
        value={wanted[name]}
        onInput={(event) => set({ [name]: event.currentTarget.valueAsNumber })}
      />
      <small>{about}</small>
    </label>
  );
  return (
    <details>
      <summary>Parameters</summary>
      {number("Resolution", "resolution", 16, 1024, "cells of the mesh along the largest extent")}
      {number("Densify to", "target", 0, 5_000_000, "points; 0 leaves the scan as it is")}
      {number(
        "Points a round",
        "perRound",
        100,
        1_000_000,
        "the paper takes 2 000, in many rounds",
      )}
      {number("Seed", "seed", 0, 2 ** 53, "the same seed gives the same mesh")}
    </details>
  );
}

function Uploading() {
  const state = draft.upload.value;
  if (!state) return null;
  const left = state.speed ? (state.total - state.sent) / state.speed : null;
  return (
    <section>
      <h2>{state.reading ? "The service reads it" : state.paused ? "Paused" : "Uploading"}</h2>
      <Bar label="Upload" share={state.reading ? null : state.sent / state.total} />
      <p class="figures">
        {bytes(state.sent)} of {bytes(state.total)}
        {state.speed !== null && ` · ${bytes(state.speed)}/s`}
        {left !== null && left > 0.5 && ` · ${duration(left)} left`}
      </p>
      <div class="actions">
        {state.paused ? (
          <button type="button" class="main" onClick={draft.goOn}>
            Go on
          </button>
        ) : (
          <button type="button" onClick={draft.pause} disabled={state.reading}>
            Pause
          </button>
        )}
        <button type="button" onClick={draft.stopUpload}>
          Cancel
        </button>
      </div>
    </section>
  );
}
