import { describe, expect, test } from "vitest";
import { ageTable, colorAt, css, gradient, table } from "../src/pure/colormap";
import { duration, Eta, inWords, remaining } from "../src/pure/eta";
import { ago, bytes, count, counted, length, placeWithin, roundStep } from "../src/pure/format";
import { bin, quantile, summarise } from "../src/pure/histogram";
import { hashOf, routeOf } from "../src/pure/route";

describe("colours", () => {
  test("ends and middle of viridis are those of the map", () => {
    expect(css(colorAt("viridis", 0))).toBe("rgb(68 1 84)");
    expect(css(colorAt("viridis", 1))).toBe("rgb(253 231 37)");
    const [red, green, blue] = colorAt("viridis", 0.5);
    expect(Math.hypot(red - 33, green - 145, blue - 140)).toBeLessThan(6);
  });
  test("every map gets lighter from one end to the other", () => {
    for (const name of ["viridis", "magma", "plasma", "cividis"] as const) {
      const light = Array.from({ length: 33 }, (_, i) => {
        const [r, g, b] = colorAt(name, i / 32);
        return 0.2126 * r + 0.7152 * g + 0.0722 * b;
      });
      for (let i = 1; i < light.length; i++) expect(light[i]).toBeGreaterThan(light[i - 1]);
    }
  });
  test("places outside are taken to the ends", () => {
    expect(colorAt("magma", -3)).toEqual(colorAt("magma", 0));
    expect(colorAt("magma", 7)).toEqual(colorAt("magma", 1));
  });
  test("tables are opaque", () => {
    for (const bytes of [table("magma", 16), ageTable(16)]) {
      expect(bytes).toHaveLength(64);
      for (let i = 3; i < 64; i += 4) expect(bytes[i]).toBe(255);
    }
    expect(gradient("viridis")).toMatch(/^linear-gradient\(to right, rgb\(68 1 84\)/);
  });
});

describe("time left", () => {
  test("nothing is said before there are two guesses", () => {
    const eta = new Eta();
    eta.push(0, null);
    eta.push(1, 9);
    expect(eta.at(1)).toBeNull();
  });
  test("guesses that disagree give a range, which shrinks as they agree", () => {
    const eta = new Eta();
    eta.push(0, 30);
    eta.push(2, 10);
    expect(eta.at(2)).toEqual({ low: 10, high: 28 });
    for (let now = 3; now < 14; now++) eta.push(now, 20 - now);
    expect(eta.at(14)).toEqual({ low: 6, high: 6 });
  });
  test("of an estimate the rest is left, until it has turned out too short", () => {
    expect(remaining({ low: 5, high: 20 }, 3)).toEqual({ low: 2, high: 17 });
    expect(remaining({ low: 5, high: 20 }, 8)).toEqual({ low: 0, high: 12 });
    expect(remaining({ low: 5, high: 20 }, 20)).toBeNull();
  });
  test("the end does not lie in the past", () => {
    const eta = new Eta();
    eta.push(0, 1);
    eta.push(1, 1);
    expect(eta.at(60)).toEqual({ low: 0, high: 0 });
  });
  test.each([
    [{ low: 0, high: 1 }, "a moment"],
    [{ low: 11, high: 12 }, "about 12 s"],
    [{ low: 10, high: 20 }, "10 to 20 s"],
    [{ low: 40, high: 150 }, "40 s to 2.5 min"],
    [{ low: 0, high: 6 }, "1 to 6 s"],
  ])("%o in words", (left, words) => {
    expect(inWords(left)).toBe(words);
  });
  test.each([
    [0.04, "0 s"],
    [2.14, "2.1 s"],
    [9.4, "9 s"],
    [59.7, "60 s"],
    [99.7, "1.7 min"],
    [700, "12 min"],
    [7000, "1.9 h"],
  ])("%d s as %s", (seconds, words) => {
    expect(duration(seconds)).toBe(words);
  });
});

describe("numbers for people", () => {
  test.each([
    [7, "7"],
    [12345, "12\u2009345"],
    [1234567, "1\u2009234\u2009567"],
  ])("%d as %s", (value, words) => {
    expect(count(value)).toBe(words);
  });
  test("one and many", () => {
    expect([counted(1, "round"), counted(2, "round")]).toEqual(["1 round", "2 rounds"]);
  });
  test.each([
    [0, "0 B"],
    [999, "999 B"],
    [1000, "1 kB"],
    [999_499, "1000 kB"],
    [8_430_000, "8.4 MB"],
    [2.5e9, "2.5 GB"],
  ])("%d bytes as %s", (value, words) => {
    expect(bytes(value)).toBe(words);
  });
  test.each([
    [0, "0"],
    [0.0004691, "0.000469"],
    [0.341, "0.341"],
    [12.3456, "12.3"],
    [4321, "4\u2009321"],
    [0.0000691, "6.91·10⁻⁵"],
    [3.2e9, "3.20·10⁹"],
  ])("length %d as %s", (value, words) => {
    expect(length(value)).toBe(words);
  });
  test("places are as exact as the scan is large", () => {
    expect(placeWithin(0.00006912, 0.34)).toBe("0.0001");
    expect(placeWithin(5403210.256, 40)).toBe("5403210.26");
    expect(placeWithin(1234.6, 3000)).toBe("1\u2009235");
  });
  test("times past", () => {
    expect([ago(5), ago(60), ago(7300), ago(200000)]).toEqual([
      "just now",
      "1 minute ago",
      "2 hours ago",
      "2 days ago",
    ]);
  });
  test("steps are 1, 2 or 5 times a power of ten", () => {
    for (const [value, step] of [
      [0.0123, 0.01],
      [0.049, 0.02],
      [7, 5],
      [1, 1],
    ]) {
      expect(roundStep(value)).toBeCloseTo(step, 12);
    }
  });
});

describe("histograms", () => {
  const values = Float32Array.from({ length: 101 }, (_, i) => (i * 37) % 101);
  test("summary", () => {
    expect(summarise(values)).toMatchObject({ median: 50, mean: 50, p95: 95, max: 100 });
    expect(summarise(new Float32Array())).toMatchObject({ median: 0, max: 0 });
  });
  test("quantiles lie between values", () => {
    expect(quantile(Float32Array.from([0, 10]), 0.25)).toBe(2.5);
  });
  test("bins hold all values, those beyond the top in the last", () => {
    const counts = bin(values, 50, 5);
    expect(counts.reduce((sum, each) => sum + each)).toBe(101);
    expect(counts).toEqual([10, 10, 10, 10, 61]);
  });
});

describe("routes", () => {
  test("a job's address leads to it and back", () => {
    const route = { page: "job", id: "job_01m82513b274za570zyv472g7gsekqja8apg" } as const;
    expect(routeOf(hashOf(route))).toEqual(route);
    expect(routeOf(hashOf({ ...route, up: "-y" }))).toEqual({ ...route, up: "-y" });
    expect(hashOf({ ...route, up: "z" })).toBe(hashOf(route));
    expect(routeOf(`${hashOf(route)}?up=yz`)).toEqual(route);
  });
  test.each(["", "#/", "#/jobs/", "#/jobs/../scans", "#/jobs/job_1?x=1", "#/jobs/JOB_1"])(
    "%s leads to the start",
    (hash) => {
      expect(routeOf(hash)).toEqual({ page: "start" });
    },
  );
});
