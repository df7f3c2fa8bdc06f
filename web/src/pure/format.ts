/** Numbers for people. Thin spaces part thousands. */

const THIN = "\u2009";

/** 12345 as "12 345". */
export function count(value: number): string {
  return Math.round(value)
    .toString()
    .replace(/\B(?=(\d{3})+$)/g, THIN);
}

/** 1 thing, 2 things. */
export function counted(value: number, one: string, many = `${one}s`): string {
  return `${count(value)} ${value === 1 ? one : many}`;
}

/** Bytes as "1.4 MB". */
export function bytes(value: number): string {
  const units = ["B", "kB", "MB", "GB", "TB"];
  let at = 0;
  let scaled = value;
  while (scaled >= 999.5 && at < units.length - 1) {
    scaled /= 1000;
    at++;
  }
  return `${at === 0 ? Math.round(scaled) : significant(scaled, 2)} ${units[at]}`;
}

/** A length with three significant digits, without a unit: the file says none. */
export function length(value: number): string {
  const size = Math.abs(value);
  if (size !== 0 && (size < 1e-4 || size >= 1e7)) {
    const [digits, power] = value.toExponential(2).split("e");
    return `${digits}·10${superscript(Number(power))}`;
  }
  return size >= 1000 ? count(value) : significant(value, 3);
}

/** A place along an axis: as exact as a thousandth of the extent asks for. */
export function placeWithin(value: number, extent: number): string {
  const step = 10 ** Math.floor(Math.log10(extent / 1000 || 1));
  const rounded = Math.round(value / step) * step;
  return step >= 1 ? count(rounded) : rounded.toFixed(Math.min(Math.round(-Math.log10(step)), 9));
}

/** Bounds of a box, as "0.214 × 0.214 × 0.341". */
export function box(extent: readonly number[]): string {
  return extent.map(length).join(" × ");
}

/** "3 minutes ago". */
export function ago(seconds: number): string {
  if (seconds < 60) return "just now";
  if (seconds < 3600) return `${counted(Math.floor(seconds / 60), "minute")} ago`;
  if (seconds < 86400) return `${counted(Math.floor(seconds / 3600), "hour")} ago`;
  return `${counted(Math.floor(seconds / 86400), "day")} ago`;
}

/** 1, 2 or 5 times a power of ten, at most `value`. */
export function roundStep(value: number): number {
  const power = 10 ** Math.floor(Math.log10(value));
  const lead = value / power;
  return (lead >= 5 ? 5 : lead >= 2 ? 2 : 1) * power;
}

function significant(value: number, digits: number): string {
  return Number(value.toPrecision(digits)).toString();
}

function superscript(value: number): string {
  const signs: Record<string, string> = { "-": "⁻" };
  const digits = "⁰¹²³⁴⁵⁶⁷⁸⁹";
  return [...value.toString()].map((sign) => signs[sign] ?? digits[Number(sign)]).join("");
}
