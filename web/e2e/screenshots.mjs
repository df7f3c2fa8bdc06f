/** Pictures of the page for docs/screenshots: `node screenshots.mjs all '{"url": ..., "chromium":
 * ..., "out": ...}'`, against a running service. */

import { join } from "node:path";
import { choose, drop, open, settings } from "./browser.mjs";

const PATIENCE = { timeout: 200_000 };
const LOOKS = {
  light: { colorScheme: "light", viewport: { width: 1240, height: 780 } },
  dark: { colorScheme: "dark", viewport: { width: 1240, height: 780 } },
  phone: {
    colorScheme: "light",
    viewport: { width: 390, height: 844 },
    deviceScaleFactor: 1.5,
    hasTouch: true,
    isMobile: true,
  },
};
const RUN = { resolution: 192, target: 30_000, perRound: 3000 };

const shown = {};
for (const [look, options] of Object.entries(LOOKS)) shown[look] = await open(options);
const pages = Object.entries(shown).map(([look, { page }]) => [look, page]);

/** The same picture in every look. */
async function take(name, prepare) {
  for (const [look, page] of pages) {
    await prepare(page, look);
    await shoot(page, `${look}-${name}`);
  }
}

function shoot(page, name) {
  return page.screenshot({ path: join(settings.out, `${name}.png`), ...PATIENCE });
}

await take("empty", (page) => page.waitForTimeout(6000));
await take("error", async (page) => {
  await drop(page, "meeting-notes.txt", "Discussed the scan of hall 3.\nNobody has it.\n");
  await page.getByRole("button", { name: "Reconstruct" }).click();
  await page.getByText("This scan was not taken").waitFor(PATIENCE);
});
const [, first] = pages[0];
await first.getByRole("button", { name: "udflow" }).click();
await first.getByRole("button", { name: /Vase/ }).click();
await first.getByText("nothing is sent yet").waitFor();
await first.waitForTimeout(3000);
await shoot(first, "light-preview");
await first.getByText("Crop").click();
await first.getByLabel("Largest x").fill("0.6");
await first.waitForTimeout(1500);
await shoot(first, "light-crop");
await first.getByRole("button", { name: "Send all of it" }).click();
await choose(first, RUN);
await first.getByRole("button", { name: "Reconstruct" }).click();
await first.getByText(/densified in round 1 of/).waitFor(PATIENCE);
const job = new URL(first.url()).hash;
for (const [, page] of pages.slice(1)) await page.goto(`${settings.url}/${job}`);
await first.getByText(/densified in round [456] of/).waitFor(PATIENCE);
await take("growing", async (page) => {
  await page.getByRole("button", { name: "Both" }).waitFor(PATIENCE);
  await page.waitForTimeout(2500);
});
await take("result", async (page) => {
  await page.getByText("A mesh of").waitFor(PATIENCE);
  await page.getByRole("button", { name: "Slice" }).waitFor(PATIENCE);
  await page.waitForTimeout(3000);
});
await take("distances", async (page) => {
  await page.getByRole("button", { name: "Distances" }).click();
  await page.getByText("Half below").waitFor(PATIENCE);
  await page.waitForTimeout(2500);
});
await take("slice", async (page) => {
  await page.getByRole("button", { name: "Distances" }).click();
  await page.getByRole("button", { name: "Slice" }).click();
  await page.getByText(/lines every/).waitFor(PATIENCE);
  await page.waitForTimeout(5000);
});
await take("split", async (page) => {
  await page.getByRole("button", { name: "Slice" }).click();
  await page.getByRole("button", { name: "Split" }).click();
  await page.waitForTimeout(2500);
});
for (const { browser, mistakes } of Object.values(shown)) {
  if (mistakes.length) process.stderr.write(`${mistakes.join("\n")}\n`);
  await browser.close();
}
