/** A slice through the field as the service sends it: an array of distances and where it lies. */

export type Vector3 = readonly [number, number, number];

export class Slice {
  /** Edge of a cell in units of the scan. */
  readonly cell: number;
  readonly largest: number;

  /** values: rows x columns, row 0 at the top. first: centre of cell (0, 0). right, down: to the
   * next cell of a row, of a column. */
  constructor(
    readonly values: Float32Array,
    readonly rows: number,
    readonly columns: number,
    readonly first: Vector3,
    readonly right: Vector3,
    readonly down: Vector3,
  ) {
    this.cell = Math.hypot(...right);
    this.largest = values.reduce((most, value) => Math.max(most, value), 0);
  }

  /** The distance between cells; null outside of the grid. */
  valueAt(column: number, row: number): number | null {
    if (column < 0 || row < 0 || column > this.columns - 1 || row > this.rows - 1) return null;
    const i = Math.min(Math.floor(column), this.columns - 2);
    const j = Math.min(Math.floor(row), this.rows - 2);
    const [s, t] = [column - i, row - j];
    const at = (c: number, r: number) => this.values[r * this.columns + c];
    const upper = at(i, j) * (1 - s) + at(i + 1, j) * s;
    const lower = at(i, j + 1) * (1 - s) + at(i + 1, j + 1) * s;
    return upper * (1 - t) + lower * t;
  }
}

/** A slice from a `.npy` body and the headers beside it.
 * @throws Error when it is something else.
 */
export function readSlice(body: ArrayBuffer, header: (name: string) => string | null): Slice {
  const view = new DataView(body);
  const start = 10 + view.getUint16(8, true);
  const text = new TextDecoder("latin1").decode(body.slice(10, start));
  const shape = /'shape': \((\d+), (\d+)\)/.exec(text);
  if (!shape || !text.includes("'<f4'")) throw new Error("the answer is no slice");
  const [rows, columns] = [Number(shape[1]), Number(shape[2])];
  const vector = (name: string) =>
    (header(`X-Slice-${name}`) ?? "").split(",").map(Number) as unknown as Vector3;
  // the data begins at a multiple of 64 bytes, as the format asks
  const values = new Float32Array(body, start, rows * columns);
  return new Slice(values, rows, columns, vector("First"), vector("Right"), vector("Down"));
}
