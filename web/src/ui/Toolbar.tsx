/** What the picture shows. Every tool is a button, and has a key. */

import type { Signal } from "@preact/signals";
import type { ComponentChildren } from "preact";
import { nextUp, upInWords } from "../pure/up";
import { preview } from "../state/draft";
import { frames, result, scan } from "../state/job";
import * as look from "../state/look";
import { viewer } from "./Stage";

export function Toolbar() {
  const isResult = result.value !== null;
  const hasFrames = frames.value.points !== null;
  if (!isResult && !hasFrames && !preview.value) return null;
  return (
    <div class="toolbar" role="toolbar" aria-label="View">
      {(isResult || frames.value.mesh) && <ShownTools />}
      {isResult && <MeshTools />}
      {isResult && <CompareTools />}
      <div class="tools">
        <Tool label="Frame" keys="F" press={() => viewer.value?.frame()} />
        <Tool
          label={upInWords(look.up.value)}
          keys="U"
          press={() => look.setUp(nextUp(look.up.value))}
        />
      </div>
    </div>
  );
}

function ShownTools() {
  const choices = [
    ["points", "Points", "1"],
    ["mesh", "Mesh", "2"],
    ["both", "Both", "3"],
  ] as const;
  return (
    <fieldset class="tools joined">
      <legend class="unseen">Show</legend>
      {choices.map(([name, label, keys]) => (
        <Tool
          key={name}
          label={label}
          keys={keys}
          on={look.shown.value === name}
          press={() => {
            look.shown.value = name;
          }}
        />
      ))}
    </fieldset>
  );
}

function MeshTools() {
  const hasColors = scan.value?.has_colors ?? false;
  return (
    <Group label="Mesh">
      <Toggle label="Wire" keys="W" of={look.wireframe} />
      <Toggle label="Normals" keys="N" of={look.normals} />
      <Toggle label="Flat" keys="L" of={look.flat} />
      {hasColors && <Toggle label="Colour" keys="C" of={look.scanColors} />}
    </Group>
  );
}

function CompareTools() {
  return (
    <Group label="Inspect">
      <Tool label="Distances" keys="D" on={look.heat.value} press={look.toggleHeat} />
      <Tool label="Slice" keys="S" on={look.slicing.value} press={look.toggleSlice} />
      <Tool label="Split" keys="V" on={look.split.value !== null} press={look.toggleSplit} />
    </Group>
  );
}

function Group({ label, children }: { label: string; children: ComponentChildren }) {
  return (
    <fieldset class="tools">
      <legend class="unseen">{label}</legend>
      {children}
    </fieldset>
  );
}

interface ToolProps {
  label: string;
  keys: string;
  press: () => void;
  on?: boolean;
}

/** A tool that is on or off. */
function Toggle({ label, keys, of }: { label: string; keys: string; of: Signal<boolean> }) {
  return <Tool label={label} keys={keys} on={of.value} press={() => look.flip(of)} />;
}

function Tool({ label, keys, press, on }: ToolProps) {
  return (
    <button
      type="button"
      class="tool"
      {...(on === undefined ? {} : { "aria-pressed": on })}
      aria-keyshortcuts={keys}
      title={`${label} (${keys})`}
      onClick={press}
    >
      {label}
    </button>
  );
}
