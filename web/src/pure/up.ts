/** Which way is up: scanners and programs do not agree. */

export type Up = "z" | "y" | "x" | "-z" | "-y" | "-x";

export const UPS: readonly Up[] = ["z", "y", "x", "-z", "-y", "-x"];

/** The direction as a vector. */
export function upVector(up: Up): [number, number, number] {
  const sign = up.startsWith("-") ? -1 : 1;
  const axis = up.at(-1);
  return [axis === "x" ? sign : 0, axis === "y" ? sign : 0, axis === "z" ? sign : 0];
}

/** In words: "Z up", "Y down". */
export function upInWords(up: Up): string {
  const letter = (up.at(-1) as string).toUpperCase();
  return `${letter} ${up.startsWith("-") ? "down" : "up"}`;
}

/** The one after it. */
export function nextUp(up: Up): Up {
  return UPS[(UPS.indexOf(up) + 1) % UPS.length];
}
