/** What the picture shows. Every tool is a button, and has a key. */

import type { ComponentChildren } from "preact";
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
  const isNormals = look.meshColors.value === "normals";
  return (
    <Group label="Mesh">
      <Tool
        label="Wire"
        keys="W"
        on={look.wireframe.value}
        press={() => {
          look.wireframe.value = !look.wireframe.value;
        }}
      />
      <Tool
        label="Normals"
        keys="N"
        on={isNormals}
        press={() => {
          look.meshColors.value = isNormals ? "plain" : "normals";
        }}
      />
      <Tool
        label="Flat"
        keys="L"
        on={look.flat.value}
        press={() => {
          look.flat.value = !look.flat.value;
        }}
      />
      {hasColors && (
        <Tool
          label="Colour"
          keys="C"
          on={look.scanColors.value}
          press={() => {
            look.scanColors.value = !look.scanColors.value;
          }}
        />
      )}
    </Group>
  );
}

function CompareTools() {
  return (
    <Group label="Inspect">
      <Tool label="Distances" keys="D" on={look.heat.value} press={look.toggleHeat} />
      <Tool label="Slice" keys="S" on={look.slicing.value} press={look.toggleSlice} />
      <Tool
        label="Split"
        keys="V"
        on={look.split.value !== null}
        press={() => {
          look.split.value = look.split.value === null ? 0.5 : null;
        }}
      />
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
