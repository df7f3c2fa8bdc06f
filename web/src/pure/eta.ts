/** Time left as a range: as wide as the last guesses disagree. */

const KEPT = 10;

export interface TimeLeft {
  low: number;
  high: number;
}

export class Eta {
  /** When each of the last guesses puts the end, in seconds. */
  private ends: number[] = [];

  /** A guess made now that `left` seconds remain; null when there is none yet. */
  push(now: number, left: number | null): void {
    if (left === null) return;
    this.ends.push(now + left);
    if (this.ends.length > KEPT) this.ends.shift();
  }

  /** Null until there are two guesses. */
  at(now: number): TimeLeft | null {
    if (this.ends.length < 2) return null;
    const low = Math.max(0, Math.min(...this.ends) - now);
    const high = Math.max(0, Math.max(...this.ends) - now);
    return { low, high };
  }
}

/** What is left of an estimate of the whole; null once it has turned out too short. */
export function remaining(whole: TimeLeft, elapsed: number): TimeLeft | null {
  if (elapsed >= whole.high) return null;
  return { low: Math.max(0, whole.low - elapsed), high: whole.high - elapsed };
}

/** In words: "about 12 s", "10 to 20 s", "a moment". */
export function inWords(left: TimeLeft): string {
  const { low, high } = left;
  if (high < 2) return "a moment";
  if (high - low < Math.max(2, 0.2 * high)) return `about ${duration((low + high) / 2)}`;
  const [first, unit] = duration(Math.max(low, 1)).split(" ");
  const [last, lastUnit] = duration(high).split(" ");
  return unit === lastUnit
    ? `${first} to ${last} ${unit}`
    : `${first} ${unit} to ${last} ${lastUnit}`;
}

/** Seconds as "8 s", "2.5 min" or "1.2 h". */
export function duration(seconds: number): string {
  if (seconds < 9.95) return `${Number(seconds.toFixed(seconds < 3 ? 1 : 0))} s`;
  if (seconds < 99.5) return `${Math.round(seconds)} s`;
  if (seconds < 5970) return `${Number((seconds / 60).toFixed(seconds < 600 ? 1 : 0))} min`;
  return `${Number((seconds / 3600).toFixed(1))} h`;
}
