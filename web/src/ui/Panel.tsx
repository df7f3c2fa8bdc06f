/** The panel beside the picture: one at a time of start, draft, running job, result, failure. */

import { route } from "../state/app";
import { draft } from "../state/draft";
import { failure, job } from "../state/job";
import { DraftPanel } from "./DraftPanel";
import { EndedPanel } from "./EndedPanel";
import { ResultPanel } from "./ResultPanel";
import { RunPanel } from "./RunPanel";
import { StartPanel } from "./StartPanel";

export function Panel() {
  return (
    <aside id="panel" class="panel" tabIndex={-1} aria-label="Details">
      {content()}
    </aside>
  );
}

function content() {
  if (route.value.page === "start") return draft.value ? <DraftPanel /> : <StartPanel />;
  const found = job.value;
  if (!found) return failure.value ? <EndedPanel /> : <p class="quiet">Loading the job…</p>;
  if (found.outputs["mesh.ply"]) return <ResultPanel job={found} />;
  return ["failed", "canceled", "expired"].includes(found.state) ? (
    <EndedPanel />
  ) : (
    <RunPanel job={found} />
  );
}
