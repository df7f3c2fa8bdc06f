/** Walks through the page in a real browser, on a real service: `node walks.mjs NAME SETTINGS`. */

import assert from "node:assert/strict";
import { join } from "node:path";
import { checkAccess, choose, drop, LONG, open, SMALL, settings, sphere } from "./browser.mjs";

const HOSTILE = `"><img src=x onerror="window.hacked=1">&amp;<b>\u202e.ply`;
const PATIENCE = { timeout: 90_000 };

const walks = {
  /** Drop, preview, upload, rounds, result, heat map, slice, download. */
  async whole() {
    const { browser, page, mistakes, transfer } = await open();
    const sent = [];
    page.on("request", (request) => {
      if (request.method() !== "GET") sent.push(request.url());
    });
    await page.getByRole("button", { name: /Vase/ }).waitFor();
    await page.waitForTimeout(1500);
    const first = transfer.page;
    await checkAccess(page, "the start");

    await drop(page, HOSTILE, sphere(800));
    await page.getByText("nothing is sent yet").waitFor();
    await page.getByText("1.99 × ").waitFor();
    assert.equal(await page.getByRole("heading", { level: 1 }).textContent(), HOSTILE);
    assert.deepEqual(sent, [], "a preview sends nothing");
    await checkAccess(page, "the preview");

    await choose(page, SMALL);
    await page.getByRole("button", { name: "Reconstruct" }).click();
    await page.getByText(/densified in round \d+ of 4/).waitFor(PATIENCE);
    await checkAccess(page, "the running job");

    await page.getByText("A mesh of").waitFor(PATIENCE);
    await page.getByRole("button", { name: "Distances" }).waitFor(PATIENCE);
    assert.ok(
      sent.some((url) => url.includes("/v1/uploads")),
      "uploads are resumable",
    );
    await page.getByRole("button", { name: "Distances" }).click();
    await page.getByText("Half below").waitFor(PATIENCE);
    const half = Number(await page.locator("dt:has-text('Half below') + dd").textContent());
    assert.ok(half > 0 && half < 0.02, `half of the points within ${half}`);
    await checkAccess(page, "the heat map");

    await page.keyboard.press("s");
    await page.getByText(/lines every/).waitFor(PATIENCE);
    await page.waitForTimeout(1500);
    const stage = await page.locator("canvas").first().boundingBox();
    await page.mouse.move(stage.x + stage.width / 2, stage.y + stage.height / 2);
    const value = Number(await page.locator(".readout").textContent());
    assert.ok(value > 0.8 && value < 1.01, `${value} from the middle of a sphere to its surface`);
    await checkAccess(page, "the slice");

    const [download] = await Promise.all([
      page.waitForEvent("download"),
      page.getByRole("link", { name: "GLB" }).click(),
    ]);
    await download.saveAs(join(settings.out, "mesh.glb"));
    await page.getByRole("button", { name: "Share…" }).click();
    await checkAccess(page, "the way to share");
    assert.equal(await page.getByLabel("Link to this page").inputValue(), page.url());
    await page.keyboard.press("Escape");
    await page.getByRole("img", { name: /^Scale: the bar is 0\.[125] / }).waitFor();
    await page.keyboard.press("u");
    await page.getByRole("button", { name: "Y up" }).waitFor();
    assert.ok(page.url().endsWith("?up=y"), "the address keeps which way is up");

    await page.keyboard.press("?");
    await page.getByText("slice through the distance field").waitFor();
    await checkAccess(page, "the help");
    await page.keyboard.press("Escape");
    assert.equal(await page.evaluate(() => window.hacked), undefined);
    assert.deepEqual(mistakes, []);
    await browser.close();
    return { before_data: first, with_all_parts: transfer.page, half };
  },

  /** In the middle of a job the page is loaded again, and in a second tab; then the API goes away
   * and comes back. What was fitted until then is kept. */
  async again() {
    const { browser, page, mistakes } = await open();
    await begin(page, LONG);
    await page.getByText(/densified in round [2-9]/).waitFor(PATIENCE);
    await page.reload();
    await page.getByText(/densified in round/).waitFor(PATIENCE);
    const second = await page.context().newPage();
    await second.goto(page.url());
    await second.getByText(/densified in round/).waitFor(PATIENCE);
    const here = await sameRound(page, second);

    process.kill(settings.api, "SIGKILL");
    await page.getByText("Reconnecting").waitFor(PATIENCE);
    await page.getByText("Reconnecting").waitFor({ state: "detached", ...PATIENCE });
    await page.waitForFunction(
      (seen) => Number(/round (\d+) of/.exec(document.body.textContent)?.[1]) > seen,
      here,
      PATIENCE,
    );
    await stop(page, "Stop, keep what we have");
    for (const tab of [page, second]) {
      await tab.getByText("Stopped early, what was fitted is kept").waitFor(PATIENCE);
      await tab.getByRole("button", { name: "Slice" }).waitFor(PATIENCE);
    }
    assert.deepEqual(mistakes, []);
    await browser.close();
    return { round: here };
  },

  /** A job that is stopped and discarded can be tried again. */
  async stopped() {
    const { browser, page, mistakes } = await open();
    await begin(page, LONG);
    await stop(page, "Stop and discard");
    await page.getByText("The job was stopped").waitFor(PATIENCE);
    await checkAccess(page, "a stopped job");
    const stopped = page.url();
    await page.getByRole("button", { name: "Try again" }).click();
    await page.waitForURL((url) => url.href !== stopped, PATIENCE);
    await stop(page, "Stop and discard");
    await page.getByText("The job was stopped").waitFor(PATIENCE);
    assert.deepEqual(mistakes, []);
    await browser.close();
    return {};
  },

  /** What goes wrong is said in words, with a next step. */
  async trouble() {
    const { browser, page, mistakes } = await open({ colorScheme: "dark" });
    await drop(page, "words.txt", "this is no scan\nat all\n");
    await page.getByText("There is no point in this file.").waitFor(PATIENCE);
    await page.getByRole("button", { name: "Reconstruct" }).click();
    await page.getByText("This scan was not taken").waitFor(PATIENCE);
    await page
      .locator(".trouble p")
      .getByText(/format|point/)
      .waitFor(PATIENCE);
    await checkAccess(page, "a refused scan");
    await drop(page, "ball.npy", npyFile(2000));
    await page.getByText(/^NPY, 24.kB$/).waitFor(PATIENCE);
    await page.getByText("2\u2009000", { exact: true }).waitFor();
    await drop(page, "street.laz", lazHeader(12_345));
    await page.getByText("LAZ points are drawn once sent.").waitFor(PATIENCE);
    await page.getByText("12\u2009345").waitFor();
    await checkAccess(page, "a file whose points are not drawn");
    await page.goto(`${settings.url}/#/jobs/job_${"0".repeat(38)}`);
    await page.getByText("There is no such job").waitFor(PATIENCE);
    await page.getByRole("button", { name: "Another scan" }).click();
    await page.getByRole("heading", { name: "From points to a surface." }).waitFor();
    assert.deepEqual(mistakes, []);
    await browser.close();
    return {};
  },

  /** Where a key is needed: it is asked for, and then used for requests, sockets and downloads.
   * The results lie in a bucket; of the scan a half is sent. */
  async locked() {
    const { browser, page, mistakes } = await open();
    await page.getByRole("heading", { name: "This service needs a key" }).waitFor(PATIENCE);
    await checkAccess(page, "the question for the key");
    await page.getByLabel("Key", { exact: false }).last().fill(settings.key);
    await page.getByRole("button", { name: "Go on" }).click();
    await page.getByRole("button", { name: /Vase/ }).waitFor(PATIENCE);
    await begin(page, SMALL, async () => {
      await page.getByText("Crop").click();
      await page.getByLabel("Least z").fill("0.5");
      await page.getByText(/\d points are kept/).waitFor();
    });
    await page.getByText(/densified in round \d+ of/).waitFor(PATIENCE);
    await page.getByRole("button", { name: "Distances" }).waitFor(PATIENCE);
    const words = await page.getByText("A mesh of").textContent();
    const sent = Number(/from (\d+) points/.exec(words)[1]);
    assert.ok(sent > 280 && sent < 420, `${sent} of 700 points are in the upper half`);
    const [download] = await Promise.all([
      page.waitForEvent("download"),
      page.getByRole("link", { name: "Report" }).click(),
    ]);
    assert.equal(download.suggestedFilename(), "report.json");
    assert.deepEqual(mistakes, []);
    await browser.close();
    return { sent };
  },

  /** Many frames: how long one takes to be drawn, and whether memory stays. */
  async frames() {
    const { browser, page, mistakes } = await open({
      path: `/#/jobs/${settings.job}`,
      viewport: { width: 900, height: 560 }, // software GL: fewer pixels, not fewer frames
    });
    await page.evaluate(() => {
      window.times = [];
      new PerformanceObserver((list) => {
        for (const entry of list.getEntries()) {
          if (entry.name === "udflow:frame-to-draw") window.times.push(entry.duration);
        }
      }).observe({ type: "measure", buffered: true });
    });
    const session = await page.context().newCDPSession(page);
    const drawn = (count) =>
      page.waitForFunction((wanted) => window.times.length >= wanted, count, { timeout: 200_000 });
    const heap = async () => {
      await session.send("HeapProfiler.collectGarbage");
      const { usedSize, backingStorageSize = 0 } = await session.send("Runtime.getHeapUsage");
      return usedSize + backingStorageSize;
    };
    await drawn(Math.max(50, settings.frames / 5));
    const early = await heap();
    await drawn(settings.frames);
    const late = await heap();
    await loseGraphics(page);
    const times = (await page.evaluate(() => window.times)).sort((a, b) => a - b);
    assert.deepEqual(mistakes, []);
    await browser.close();
    const at = (share) => times[Math.floor(share * (times.length - 1))];
    return { early, late, drawn: times.length, median_ms: at(0.5), p95_ms: at(0.95) };
  },
};

/** The graphics card goes away, as on phones and laptops, and comes back. */
async function loseGraphics(page) {
  const extension = await page.evaluateHandle(() =>
    document.querySelector("canvas").getContext("webgl2").getExtension("WEBGL_lose_context"),
  );
  await extension.evaluate((card) => card.loseContext());
  await page.getByText("The graphics card was lost").waitFor();
  await extension.evaluate((card) => card.restoreContext());
  await page.getByText("The graphics card was lost").waitFor({ state: "detached" });
  const before = await page.evaluate(() => window.times.length);
  await page.waitForFunction((seen) => window.times.length > seen + 1, before, PATIENCE);
}

/** Points as NumPy saves them. */
function npyFile(count) {
  const text = `{'descr': '<f4', 'fortran_order': False, 'shape': (${count}, 3), }`.padEnd(117);
  const head = Buffer.from([0x93, ...Buffer.from("NUMPY"), 1, 0, 118, 0]);
  const values = Float32Array.from({ length: 3 * count }, (_, i) => Math.sin(i * i));
  return Buffer.concat([head, Buffer.from(`${text}\n`), Buffer.from(values.buffer)]);
}

/** The first bytes of a compressed file: all that the page reads of it. */
function lazHeader(count) {
  const head = Buffer.alloc(227);
  head.write("LASF");
  head.writeUInt8(2, 25);
  head.writeUInt8(0x83, 104);
  head.writeUInt32LE(count, 107);
  for (const [i, value] of [40, 0, 30, 0, 5, 0].entries()) head.writeDoubleLE(value, 179 + 8 * i);
  return head;
}

async function begin(page, size, prepare = async () => {}) {
  await drop(page, "ball.ply", sphere(700));
  await page.getByText("nothing is sent yet").waitFor();
  await choose(page, size);
  await prepare();
  await page.getByRole("button", { name: "Reconstruct" }).click();
}

async function round(page) {
  return Number(/round (\d+) of/.exec(await page.locator(".counter").textContent())[1]);
}

/** The round that both tabs tell, but for what passes between two looks. */
async function sameRound(one, two) {
  let rounds = [];
  for (let look = 0; look < 50; look += 1) {
    rounds = await Promise.all([round(one), round(two)]);
    if (Math.abs(rounds[0] - rounds[1]) <= 2) return rounds[0];
    await one.waitForTimeout(100);
  }
  assert.fail(`round ${rounds[0]} here, ${rounds[1]} in the other tab`);
}

async function stop(page, how) {
  await page.getByRole("button", { name: "Stop…" }).click();
  await page.getByRole("button", { name: how }).click();
}

const walk = walks[process.argv[2]];
const found = await walk();
process.stdout.write(`${JSON.stringify(found)}\n`);
