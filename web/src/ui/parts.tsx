/** Small parts that several panels are made of. */

import type { ComponentChildren } from "preact";
import { dialog } from "../state/app";

/** Names and values in two columns. */
export function Facts({ rows }: { rows: [string, ComponentChildren][] }) {
  return (
    <dl class="facts">
      {rows.map(([name, value]) => (
        <div key={name}>
          <dt>{name}</dt>
          <dd>{value}</dd>
        </div>
      ))}
    </dl>
  );
}

export interface BarProps {
  label: string;
  /** 0 to 1; null where it cannot be told. */
  share: number | null;
}

export function Bar({ label, share }: BarProps) {
  const known = share === null ? {} : { "aria-valuenow": Math.round(100 * share) };
  return (
    <div
      class={`bar ${share === null ? "unknown" : ""}`}
      role="progressbar"
      aria-label={label}
      aria-valuemin={0}
      aria-valuemax={100}
      {...known}
    >
      <i style={share === null ? {} : { width: `${100 * share}%` }} />
    </div>
  );
}

export function ShareButton() {
  const ask = () => {
    dialog.value = "share";
  };
  return (
    <button type="button" onClick={ask}>
      Share…
    </button>
  );
}

/** Words that something is wrong, with what can be done. */
export function Trouble({ title, children }: { title: string; children: ComponentChildren }) {
  return (
    <div class="trouble" role="alert">
      <h3>{title}</h3>
      {children}
    </div>
  );
}

/** Sentences to heed. */
export function Warnings({ words }: { words: readonly string[] }) {
  if (words.length === 0) return null;
  return (
    <ul class="warnings">
      {words.map((each) => (
        <li key={each}>{sentence(each)}</li>
      ))}
    </ul>
  );
}

/** With a capital letter and a full stop. */
export function sentence(words: string): string {
  const text = words.trim();
  const begun = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?…]$/.test(begun) ? begun : `${begun}.`;
}
