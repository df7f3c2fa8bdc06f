/** A browser on the page of a running service, and the steps that several walks share. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { chromium } from "playwright-core";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const SOFTWARE_GL = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader"];

export const settings = JSON.parse(process.argv[3] ?? "{}");

/** Opens the page. Every error and every broken rule of the policy is remembered. */
export async function open({ path = "", ...options } = {}) {
  const browser = await chromium.launch({
    executablePath: settings.chromium,
    args: ["--no-sandbox", "--ignore-gpu-blocklist", ...SOFTWARE_GL],
  });
  const size = { width: 1120, height: 700 }; // software GL draws every pixel on the processor
  const context = await browser.newContext({ viewport: size, acceptDownloads: true, ...options });
  context.setDefaultTimeout(90_000); // machines that run tests are busy
  const page = await context.newPage();
  const mistakes = [];
  page.on("pageerror", (error) => mistakes.push(error.message));
  page.on("console", (message) => {
    // the browser itself reports every answer that is no success; those are the service's words
    const isAnswer = message.text().startsWith("Failed to load resource");
    const isSocket = message.text().startsWith("WebSocket connection");
    if (message.type() === "error" && !isAnswer && !isSocket) mistakes.push(message.text());
  });
  page.on("dialog", (dialog) => mistakes.push(`a dialog: ${dialog.message()}`));
  const transfer = await countTransfer(context, page);
  await page.goto(settings.url + path);
  return { browser, page, mistakes, transfer };
}

/** Bytes over the wire, apart for the page itself and for data. */
async function countTransfer(context, page) {
  const session = await context.newCDPSession(page);
  await session.send("Network.enable");
  const urls = new Map();
  const sizes = { page: 0, data: 0 };
  session.on("Network.responseReceived", ({ requestId, response }) => {
    urls.set(requestId, new URL(response.url).pathname);
  });
  session.on("Network.loadingFinished", ({ requestId, encodedDataLength }) => {
    sizes[(urls.get(requestId) ?? "").startsWith("/v1/") ? "data" : "page"] += encodedDataLength;
  });
  return sizes;
}

/** Drops a file onto the window, as a person would. */
export function drop(page, name, bytes) {
  return page.evaluate(
    ([name, text]) => {
      const bytes = Uint8Array.from(atob(text), (sign) => sign.charCodeAt(0));
      const dataTransfer = new DataTransfer();
      dataTransfer.items.add(new File([bytes], name));
      const options = { dataTransfer, bubbles: true, cancelable: true };
      document.body.dispatchEvent(new DragEvent("dragover", options));
      document.body.dispatchEvent(new DragEvent("drop", options));
    },
    [name, Buffer.from(bytes).toString("base64")],
  );
}

/** Asks axe; nothing serious or critical may be found. */
export async function checkAccess(page, where) {
  await page.evaluate(AXE);
  const found = await page.evaluate(() => window.axe.run(document));
  const bad = found.violations.filter(({ impact }) => ["serious", "critical"].includes(impact));
  const words = bad.map(({ id, nodes }) => `${id}: ${nodes.map((node) => node.html).join(" | ")}`);
  assert.deepEqual(words, [], `accessibility of ${where}`);
}

/** A sphere of random points with colours, as PLY text. */
export function sphere(count) {
  let state = 1;
  const random = () => {
    state = (Math.imul(state, 1664525) + 1013904223) >>> 0;
    return state / 2 ** 32;
  };
  const rows = Array.from({ length: count }, () => {
    const z = 2 * random() - 1;
    const angle = 2 * Math.PI * random();
    const reach = Math.sqrt(1 - z * z);
    const at = [reach * Math.cos(angle), reach * Math.sin(angle), z];
    return `${at.map((value) => value.toFixed(6)).join(" ")} ${z > 0 ? "220 60 40" : "40 90 200"}`;
  });
  const properties = ["float x", "float y", "float z", "uchar red", "uchar green", "uchar blue"];
  return [
    "ply",
    "format ascii 1.0",
    `element vertex ${count}`,
    ...properties.map((property) => `property ${property}`),
    "end_header",
    ...rows,
    "",
  ].join("\n");
}

/** Fills parameters of the draft: a small job, or one of many rounds. */
export async function choose(page, { resolution, target, perRound }) {
  await page.getByText("Parameters").click();
  await page.getByLabel("Resolution").fill(String(resolution));
  await page.getByLabel("Densify to").fill(String(target));
  await page.getByLabel("Points a round").fill(String(perRound));
}

export const SMALL = { resolution: 32, target: 1600, perRound: 200 };
export const LONG = { resolution: 32, target: 60_000, perRound: 200 };
