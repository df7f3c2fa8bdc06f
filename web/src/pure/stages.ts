/** How far each stage of a job is, from its events. */

export const STAGES = ["reading", "fitting", "densifying", "extracting", "exporting"] as const;
export type Stage = (typeof STAGES)[number];

export interface StageEvent {
  stage: Stage;
  step: number;
  total: number;
  round: number;
  rounds: number;
}

export interface StageState {
  name: Stage;
  state: "waiting" | "running" | "done" | "skipped";
  /** 0 to 1; null while running without a measure of how far. */
  share: number | null;
  /** Seconds spent in it, null before it began. */
  seconds: number | null;
}

/** Follows one attempt. Times in seconds on any clock. */
export class StageClock {
  private began = new Map<Stage, number>();
  private last: StageEvent | null = null;
  private ended: number | null = null;

  /** Something was heard of the job. */
  push(time: number, event: StageEvent): void {
    if (!STAGES.includes(event.stage)) return;
    if (!this.began.has(event.stage)) this.began.set(event.stage, time);
    this.last = event;
  }

  /** The job has ended. */
  end(time: number): void {
    this.ended ??= time;
  }

  /** All stages as they stand. */
  at(now: number): StageState[] {
    const current = this.last ? STAGES.indexOf(this.last.stage) : -1;
    return STAGES.map((name, place) => {
      const start = this.began.get(name);
      if (start === undefined) {
        return { name, state: place < current ? "skipped" : "waiting", share: null, seconds: null };
      }
      const running = place === current && this.ended === null;
      const next = STAGES.slice(place + 1).find((later) => this.began.has(later));
      const stop = next ? (this.began.get(next) as number) : (this.ended ?? now);
      return {
        name,
        state: running ? "running" : "done",
        share: running && this.last ? shareOf(this.last) : 1,
        seconds: Math.max(0, stop - start),
      };
    });
  }
}

/** How far inside its stage an event is; null where one step is all there is. */
export function shareOf(event: StageEvent): number | null {
  const within = event.total > 1 ? event.step / event.total : null;
  if (event.stage === "densifying" && event.rounds > 0) {
    return Math.min(1, (Math.max(event.round - 1, 0) + (within ?? 0)) / event.rounds);
  }
  return within;
}
