/** Points as rows of text: XYZ, CSV, PTS, ASCII PLY and PCD, and the vertices of OBJ. */

import type { Rgb } from "../colormap";
import type { Sink } from "./collector";

export interface Rows {
  /** Columns of x, y, z in a row of numbers. */
  at: [number, number, number];
  /** First of three columns of colours; null where there are none. */
  color: number | null;
  /** 255, or 1. */
  colorMost: number;
  /** Rows to read; the rest is something else. */
  most: number;
}

/** Numbers of one row; null for headings and comments. */
export function numbersOf(line: string): number[] | null {
  const words = line.trim().split(/[\s,;]+/);
  if (words.length < 3 || words[0] === "") return null;
  const numbers = words.map(Number);
  return numbers.slice(0, 3).some((value, i) => Number.isNaN(value) && !isNoNumber(words[i]))
    ? null
    : numbers;
}

/** What the columns of rows without a heading mean: colours are three whole numbers to 255. */
export function guessRows(lines: string[]): Rows {
  const rows = lines.map(numbersOf).filter((row) => row !== null);
  const looksLikeColor = (from: number) =>
    rows.length > 0 &&
    rows.every((row) =>
      row
        .slice(from, from + 3)
        .every((value) => Number.isInteger(value) && value >= 0 && value < 256),
    );
  const columns = Math.min(...rows.map((row) => row.length));
  const color = [4, 3].find((from) => columns >= from + 3 && looksLikeColor(from)) ?? null;
  return { at: [0, 1, 2], color, colorMost: 255, most: Number.POSITIVE_INFINITY };
}

/** Feeds rows to a sink, piece of text by piece of text. */
export class RowReader {
  private rest = "";
  private read = 0;

  constructor(
    private readonly rows: Rows,
    private readonly sink: Sink,
    private readonly prefix = "",
  ) {
    sink.hasColors = rows.color !== null;
  }

  push(text: string): void {
    const lines = (this.rest + text).split("\n");
    this.rest = lines.pop() ?? "";
    for (const line of lines) this.take(line);
  }

  end(): void {
    this.take(this.rest);
  }

  private take(text: string): void {
    if (this.read >= this.rows.most) return;
    const line = this.prefix ? text.trimStart() : text;
    if (!line.startsWith(this.prefix)) return;
    const row = numbersOf(line.slice(this.prefix.length));
    if (!row) return;
    this.read++;
    const { at, color, colorMost } = this.rows;
    const bright = 255 / colorMost;
    const shade =
      color === null
        ? undefined
        : (row.slice(color, color + 3).map((value) => value * bright) as Rgb);
    this.sink.add(row[at[0]], row[at[1]], row[at[2]], shade);
  }
}

function isNoNumber(word: string): boolean {
  return /^[+-]?(nan|inf(inity)?)$/i.test(word);
}
