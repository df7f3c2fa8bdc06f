/** The way to a job for others, and for programs. */

import { useRef, useState } from "preact/hooks";
import { address, hasKey, type Job } from "../net/api";

const LOCAL = ["localhost", "127.0.0.1", "[::1]"];

export function Share({ job }: { job: Job }) {
  const mesh = address(`v1/jobs/${job.id}/mesh?format=glb`);
  const key = hasKey() ? ` -H "Authorization: Bearer $UDFLOW_KEY"` : "";
  return (
    <>
      <Copied label="Link to this page" text={location.href} />
      {job.outputs["mesh.glb"] && (
        <Copied label="The mesh on the command line" text={`curl -LOJ${key} '${mesh}'`} />
      )}
      <p class="quiet">{reachOf()}</p>
    </>
  );
}

/** Who can follow the link. */
function reachOf(): string {
  if (hasKey()) return "It opens for whoever has a key of this service.";
  return LOCAL.includes(location.hostname)
    ? "It opens on this machine: the service listens to nobody else."
    : "It opens for whoever can reach this service.";
}

function Copied({ label, text }: { label: string; text: string }) {
  const field = useRef<HTMLInputElement>(null);
  const [done, setDone] = useState(false);
  const copy = async () => {
    field.current?.select();
    try {
      await navigator.clipboard.writeText(text);
      setDone(true);
    } catch {
      // without https there is no clipboard: the text is selected, and keys copy it
    }
  };
  return (
    <div class="copied">
      <label>
        <span>{label}</span>
        <input
          ref={field}
          class="command"
          type="text"
          readonly
          value={text}
          onFocus={() => field.current?.select()}
        />
      </label>
      <button type="button" onClick={() => void copy()}>
        {done ? "Copied" : "Copy"}
      </button>
    </div>
  );
}
