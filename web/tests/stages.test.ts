import { expect, test } from "vitest";
import { StageClock, type StageEvent, shareOf } from "../src/pure/stages";

function at(stage: StageEvent["stage"], step = 0, total = 5, round = 0, rounds = 4): StageEvent {
  return { stage, step, total, round, rounds };
}

test("stages before are done with their times, those after wait", () => {
  const clock = new StageClock();
  clock.push(100, at("reading"));
  clock.push(101, at("fitting", 1));
  clock.push(104, at("fitting", 4));
  const [reading, fitting, densifying] = clock.at(106);
  expect(reading).toMatchObject({ state: "done", seconds: 1, share: 1 });
  expect(fitting).toMatchObject({ state: "running", seconds: 5, share: 0.8 });
  expect(densifying).toMatchObject({ state: "waiting", seconds: null });
});

test("a stage that was passed over is not said to be done", () => {
  const clock = new StageClock();
  clock.push(0, at("fitting"));
  clock.push(3, at("extracting", 0, 1));
  expect(clock.at(5).map((stage) => stage.state)).toEqual([
    "skipped",
    "done",
    "skipped",
    "running",
    "waiting",
  ]);
});

test("rounds make up the share of densification", () => {
  expect(shareOf(at("densifying", 0, 5, 1))).toBe(0);
  expect(shareOf(at("densifying", 5, 5, 2))).toBe(0.5);
  expect(shareOf(at("densifying", 5, 5, 4))).toBe(1);
});

test("where there is one step only, no share is made up", () => {
  expect(shareOf(at("extracting", 0, 1))).toBeNull();
});

test("times stand still after the end", () => {
  const clock = new StageClock();
  clock.push(0, at("exporting", 0, 7));
  clock.end(4);
  clock.end(9);
  expect(clock.at(50)[4]).toMatchObject({ state: "done", seconds: 4 });
});
