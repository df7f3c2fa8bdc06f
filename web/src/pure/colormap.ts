/** Colour maps, even to the eye, as eight stops between which colours are mixed. */

export type MapName = "viridis" | "magma" | "cividis" | "plasma";
export type Rgb = [number, number, number];

const STOPS: Record<MapName, string> = {
  viridis: "440154 46327e 365c8d 277f8e 1fa187 4ac16d a0da39 fde725",
  magma: "000004 221150 5f187f 982d80 d3436e f8765c febb81 fcfdbf",
  plasma: "0d0887 5302a3 8b0aa5 b83289 db5c68 f48849 febd2a f0f921",
  cividis: "00224e 213b6e 4c556c 6c6e72 8e8a79 b2a76f d9c55c fee838",
};

const TABLES = Object.fromEntries(
  Object.entries(STOPS).map(([name, text]) => [name, text.split(" ").map(parsed)]),
) as Record<MapName, Rgb[]>;

/** The colour at a place from 0 to 1, each part 0 to 255. */
export function colorAt(name: MapName, place: number): Rgb {
  const stops = TABLES[name];
  const scaled = Math.min(Math.max(place, 0), 1) * (stops.length - 1);
  const low = Math.min(Math.floor(scaled), stops.length - 2);
  const share = scaled - low;
  return stops[low].map((part, i) => part + share * (stops[low + 1][i] - part)) as Rgb;
}

/** A table of `size` colours as RGBA bytes, for a texture. */
export function table(name: MapName, size = 256): Uint8Array {
  const bytes = new Uint8Array(4 * size);
  for (let i = 0; i < size; i++) bytes.set([...colorAt(name, i / (size - 1)), 255], 4 * i);
  return bytes;
}

/** The colour of a point by its round, 0 for the first to 1 for the last: away from the ink of
 * measured points, and dark enough for paper. */
export function ageColor(place: number): Rgb {
  return colorAt("plasma", 0.3 + 0.52 * place);
}

/** `ageColor` as a table, for a texture. */
export function ageTable(size = 256): Uint8Array {
  const bytes = new Uint8Array(4 * size);
  for (let i = 0; i < size; i++) bytes.set([...ageColor(i / (size - 1)), 255], 4 * i);
  return bytes;
}

/** CSS for a legend, from left to right. */
export function gradient(name: MapName): string {
  return `linear-gradient(to right, ${TABLES[name].map((rgb) => css(rgb)).join(", ")})`;
}

/** CSS of a colour. */
export function css(color: Rgb): string {
  return `rgb(${color.map((part) => Math.round(part)).join(" ")})`;
}

function parsed(hex: string): Rgb {
  return [0, 2, 4].map((at) => Number.parseInt(hex.slice(at, at + 2), 16)) as Rgb;
}
