/** What distances look like as a whole. */

export interface Summary {
  median: number;
  mean: number;
  /** 95 of 100 are smaller. */
  p95: number;
  max: number;
  /** All values, sorted: quantiles are read off. */
  sorted: Float32Array;
}

/** Summary of values that are not negative. */
export function summarise(values: Float32Array): Summary {
  const sorted = Float32Array.from(values).sort();
  let sum = 0;
  for (const value of sorted) sum += value;
  return {
    median: quantile(sorted, 0.5),
    mean: sorted.length ? sum / sorted.length : 0,
    p95: quantile(sorted, 0.95),
    max: sorted.length ? sorted[sorted.length - 1] : 0,
    sorted,
  };
}

/** The value below which a share of the sorted values lies. */
export function quantile(sorted: Float32Array, share: number): number {
  if (sorted.length === 0) return 0;
  const place = share * (sorted.length - 1);
  const low = Math.floor(place);
  const high = Math.min(low + 1, sorted.length - 1);
  return sorted[low] + (place - low) * (sorted[high] - sorted[low]);
}

/** How many values fall into each of `bins` equal parts of 0..top; what is above goes last. */
export function bin(values: Float32Array, top: number, bins: number): number[] {
  const counts = new Array<number>(bins).fill(0);
  for (const value of values) {
    counts[Math.min(bins - 1, Math.floor((value / (top || 1)) * bins))]++;
  }
  return counts;
}
