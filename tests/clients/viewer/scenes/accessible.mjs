/** What people look at, in both colour schemes and two sizes, held against the rules of axe; pictures of all of it. */

import assert from "node:assert/strict";
import { execFileSync, spawnSync } from "node:child_process";
import { cpSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { pathToFileURL } from "node:url";
import { Sheet } from "../browser.mjs";
import { nodding } from "../recordings.mjs";
import { BINARY } from "../server.mjs";
import { openSample } from "./sample.mjs";

export const title = "viewer, reference and reports have no serious fault of accessibility";

const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const SIZES = { wide: { width: 1280, height: 800 }, narrow: { width: 390, height: 844 } };
const SUITE = new URL("../../../../deploy/ci/sample-suite", import.meta.url).pathname;

/** What the rules find serious or worse on a page, in lines that name rule, place and reason. */
async function faults(page) {
  await page.evaluate(AXE);
  const { violations } = await page.evaluate(() =>
    window.axe.run(document, { resultTypes: ["violations"], runOnly: ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa", "best-practice"] }),
  );
  return violations
    .filter(({ impact }) => impact === "serious" || impact === "critical")
    .flatMap(({ id, nodes }) => nodes.map(({ target, failureSummary }) => `${id}: ${target.join(" ")}: ${failureSummary.replace(/\s+/g, " ")}`));
}

/** Reports of a suite that passes, of one whose results changed, and of one whose job was changed and not blessed. */
function reports(folder) {
  const run = (...words) => spawnSync(BINARY, ["check", ...words, "--force"], { encoding: "utf8" });
  const made = {};
  for (const kind of ["pass", "fail", "stale"]) {
    const suite = join(folder, kind);
    cpSync(SUITE, suite, { recursive: true });
    const [golden, changed] = ["bend.golden.json", "bend.case.json"].map((name) => join(suite, name));
    if (kind !== "pass") {
      const stored = JSON.parse(readFileSync(golden, "utf8"));
      writeFileSync(changed, readFileSync(changed, "utf8").replace(/"rotationVector": \[[^\]]*\]/, '"rotationVector": [0, 1.2, 0]'));
      if (kind === "fail") {
        // The golden of another result under the changed job's name: as if the solver had changed.
        execFileSync(BINARY, ["check", suite, "--bless"], { stdio: "ignore" });
        stored.inputs = JSON.parse(readFileSync(golden, "utf8")).inputs;
        writeFileSync(golden, JSON.stringify(stored));
      }
    }
    made[kind] = join(folder, `${kind}.html`);
    const { status, stderr } = run(suite, "--html", made[kind]);
    assert.equal(status, kind === "pass" ? 0 : 1, stderr);
  }
  assert.ok(!readFileSync(made.fail, "utf8").includes("stale"), "the failing suite is not a stale one");
  return made;
}

export async function play({ browser, url, server, log }) {
  const folder = mkdtempSync(join(tmpdir(), "pliant-"));
  let looked = 0;
  try {
    const paper = reports(folder);
    for (const [size, viewport] of Object.entries(SIZES)) {
      for (const colorScheme of ["light", "dark"]) {
        const options = { viewport, colorScheme };
        const found = [];
        const look = async (page, name) => {
          await page.screenshot({ path: new URL(`../../../../target/viewer/${name}-${size}-${colorScheme}.png`, import.meta.url).pathname });
          for (const fault of await faults(page)) found.push(`${name}, ${size}, ${colorScheme}: ${fault}`);
          looked += 1;
        };
        const sheet = await Sheet.open(browser, url(), options);
        await look(sheet.page, "start");
        await openSample(sheet);
        await look(sheet.page, "session");
        await sheet.pick(...nodding(4));
        await sheet.until("an animation is shown", ({ animation }) => animation?.kept === 4);
        await look(sheet.page, "animation");
        await sheet.key("Escape");
        await sheet.page.getByRole("button", { name: "Help" }).click();
        await sheet.page.getByRole("heading", { name: "How it works" }).waitFor();
        await look(sheet.page, "help");
        await sheet.close();

        const context = await browser.newContext(options);
        const page = await context.newPage();
        await page.goto(`${server.url}/docs`);
        await page.locator("summary", { hasText: "Try it" }).first().click();
        await look(page, "docs");
        for (const [kind, file] of Object.entries(paper)) {
          await page.goto(pathToFileURL(file).href);
          await look(page, `report-${kind}`);
        }
        await context.close();
        assert.deepEqual(found, []);
      }
    }
  } finally {
    rmSync(folder, { recursive: true });
  }
  log(`${looked} looks at pages`);
}
