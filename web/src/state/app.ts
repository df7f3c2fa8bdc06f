/** What the page as a whole knows: where it is, how it looks, what the service can do. */

import { signal } from "@preact/signals";
import {
  getInfo,
  getSamples,
  type Info,
  type Job,
  listJobs,
  Problem,
  type SampleInfo,
} from "../net/api";
import { hashOf, type Route, routeOf } from "../pure/route";

export type Theme = "system" | "light" | "dark";
export type DialogName = "help" | "jobs" | "key" | "cancel" | "share" | null;

const THEME = "udflow.theme";

export const route = signal<Route>(routeOf(location.hash));
export const theme = signal<Theme>((localStorage.getItem(THEME) as Theme | null) ?? "system");
export const info = signal<Info | null>(null);
export const samples = signal<SampleInfo[]>([]);
export const jobs = signal<Job[]>([]);
export const dialog = signal<DialogName>(null);
/** What went wrong with the page as a whole, in words. */
export const trouble = signal<string | null>(null);
/** What a screen reader says next. */
export const spoken = signal("");

export const prefersStill = matchMedia("(prefers-reduced-motion: reduce)");
export const isPhone = matchMedia("(pointer: coarse) and (max-width: 900px)");

const darkSystem = matchMedia("(prefers-color-scheme: dark)");
/** Whether the system asks for dark pages. */
export const prefersDark = signal(darkSystem.matches);

/** Goes to a route, so that the back button leads back. */
export function go(next: Route): void {
  location.hash = hashOf(next);
}

export function setTheme(next: Theme): void {
  document.documentElement.dataset.theme = next; // first: the picture asks the style for colours
  theme.value = next;
  localStorage.setItem(THEME, next);
}

/** Whether the page is dark now. */
export function isDark(): boolean {
  return theme.value === "dark" || (theme.value === "system" && prefersDark.value);
}

/** What the start page needs. */
export async function loadStart(): Promise<void> {
  try {
    [info.value, samples.value, jobs.value] = await Promise.all([
      getInfo(),
      getSamples(),
      listJobs().then((page) => page.jobs),
    ]);
    trouble.value = null;
  } catch (error) {
    if (error instanceof Problem && error.status === 401) dialog.value = "key";
    else trouble.value = (error as Error).message;
  }
}

/** A colour of the style sheet as it is now, for what is drawn outside of it. */
export function colorNow(name: string): string {
  const { style } = document.documentElement;
  style.setProperty("outline-color", `var(${name})`);
  const found = getComputedStyle(document.documentElement).outlineColor;
  style.removeProperty("outline-color");
  return found;
}

/** Follows the address bar from now on. */
export function begin(): void {
  document.documentElement.dataset.theme = theme.value;
  darkSystem.addEventListener("change", () => {
    prefersDark.value = darkSystem.matches;
  });
  addEventListener("hashchange", () => {
    route.value = routeOf(location.hash);
  });
}
