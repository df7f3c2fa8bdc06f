/** The page: header, picture, and a panel that says what there is to say and do. */

import { effect } from "@preact/signals";
import { useEffect, useState } from "preact/hooks";
import { dialog, loadStart, route, spoken } from "../state/app";
import { forget, take } from "../state/draft";
import { leave, watch } from "../state/job";
import { resetLook } from "../state/look";
import { Dialogs } from "./Dialogs";
import { Header } from "./Header";
import { onKey } from "./keys";
import { Panel } from "./Panel";
import { Stage } from "./Stage";

export function App() {
  const [dragging, setDragging] = useState(false);
  useEffect(
    () =>
      effect(() => {
        const found = route.value;
        resetLook();
        if (found.page === "job") {
          forget();
          watch(found.id);
        } else leave();
        void loadStart();
      }),
    [],
  );
  useEffect(() => listen(setDragging), []);
  return (
    <div class={`page ${dragging ? "dragging" : ""}`}>
      <button type="button" class="skip" onClick={skip}>
        To the panel
      </button>
      <Header />
      <main>
        <Stage />
        <Panel />
      </main>
      <Dialogs />
      <div class="drop-hint" aria-hidden="true">
        Drop the scan
      </div>
      <p class="unseen" role="status" aria-live="polite">
        {spoken.value}
      </p>
    </div>
  );
}

function skip(): void {
  document.getElementById("panel")?.focus();
}

/** The whole window takes files, by drop and by paste. */
function listen(setDragging: (dragging: boolean) => void): () => void {
  const stop = new AbortController();
  const { signal } = stop;
  const over = (event: DragEvent) => {
    event.preventDefault();
    setDragging(true);
  };
  const left = (event: DragEvent) => {
    if (event.relatedTarget === null) setDragging(false);
  };
  const dropped = (event: DragEvent) => {
    event.preventDefault();
    setDragging(false);
    takeFile(event.dataTransfer?.files[0]);
  };
  addEventListener("dragover", over, { signal });
  addEventListener("dragleave", left, { signal });
  addEventListener("drop", dropped, { signal });
  addEventListener("paste", (event) => takeFile(event.clipboardData?.files[0]), { signal });
  addEventListener("keydown", onKey, { signal });
  return () => stop.abort();
}

/** Takes a file from wherever it came. */
export function takeFile(file: File | undefined): void {
  if (!file) return;
  dialog.value = null;
  if (route.value.page !== "start") location.hash = "#/";
  // the route is followed first: it forgets what was there
  setTimeout(() => take(file, file.name));
}
