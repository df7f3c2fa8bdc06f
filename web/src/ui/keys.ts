/** Keys, wherever the focus is, except while something is typed. */

import { nextUp } from "../pure/up";
import { dialog, isDark, setTheme } from "../state/app";
import { result } from "../state/job";
import * as look from "../state/look";
import { viewer } from "./Stage";

const ARROWS: Record<string, [number, number]> = {
  ArrowLeft: [-6, 0],
  ArrowRight: [6, 0],
  ArrowUp: [0, 6],
  ArrowDown: [0, -6],
};

export function onKey(event: KeyboardEvent): void {
  const target = event.target as HTMLElement;
  if (event.ctrlKey || event.metaKey || event.altKey) return;
  if (target.closest("input, select, textarea, dialog, [role=slider]")) return;
  if (target instanceof HTMLCanvasElement && turn(event.key)) {
    event.preventDefault();
    return;
  }
  const action = ACTIONS[event.key.toLowerCase()];
  if (action) {
    event.preventDefault();
    action();
  }
}

/** Whether a key moves the picture. */
function turn(key: string): boolean {
  const way = ARROWS[key];
  if (way) viewer.value?.move(way[0], way[1], 1);
  else if (key === "+" || key === "=") viewer.value?.move(0, 0, 0.9);
  else if (key === "-") viewer.value?.move(0, 0, 1 / 0.9);
  else return false;
  return true;
}

const ofResult = (act: () => void) => () => {
  if (result.value) act();
};

const ACTIONS: Record<string, () => void> = {
  f: () => viewer.value?.frame(),
  "1": () => {
    look.shown.value = "points";
  },
  "2": () => {
    look.shown.value = "mesh";
  },
  "3": () => {
    look.shown.value = "both";
  },
  w: () => look.flip(look.wireframe),
  n: () => look.flip(look.normals),
  l: () => look.flip(look.flat),
  c: () => look.flip(look.scanColors),
  u: () => look.setUp(nextUp(look.up.value)),
  d: ofResult(look.toggleHeat),
  s: ofResult(look.toggleSlice),
  v: ofResult(look.toggleSplit),
  t: () => setTheme(isDark() ? "light" : "dark"),
  "?": () => {
    dialog.value = "help";
  },
};
