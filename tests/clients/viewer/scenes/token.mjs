/** A server that wants to know who asks: the page asks for a token, and forgets it with the tab. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { Sheet } from "../browser.mjs";
import { serve } from "../proxy.mjs";
import { BINARY, Server } from "../server.mjs";

export const title = "a token is asked for, a wrong one again, and kept for the tab alone";

export async function play({ browser, folder }) {
  const [token, lines] = execFileSync(BINARY, ["token", "studio"], { encoding: "utf8" }).split("\n\n");
  const kept = mkdtempSync(join(tmpdir(), "pliant-"));
  writeFileSync(join(kept, "pliant.toml"), lines);
  const server = await Server.start("--config", join(kept, "pliant.toml"));
  const proxy = await serve(folder, () => server.url);
  try {
    const sheet = await Sheet.open(browser, proxy.url);
    const { page } = sheet;
    const field = page.getByLabel("Token", { exact: true });
    await field.waitFor();
    await field.fill("pliant_of-another-server");
    await field.press("Enter");
    await page.getByText("rejects that token").waitFor();
    await sheet.picture("token");
    await field.fill(token);
    await page.getByRole("button", { name: "Continue" }).click();
    await page.getByRole("button", { name: "Open the sample creature" }).click();
    await sheet.until("the creature opens, and its stream", ({ link, busy, revision }) => link === "open" && !busy && revision === "2");
    const id = await sheet.ask("session");

    await page.reload();
    await sheet.ready();
    await sheet.until("the tab still knows it", ({ link, busy }) => link === "open" && !busy);
    assert.equal(await sheet.ask("session"), id);
    const stored = await page.evaluate(() => [JSON.stringify(localStorage), document.cookie, location.href].join(" "));
    assert.ok(!stored.includes(token), "nothing outlives the tab");

    // Another tab knows nothing, and one that gives no token is told why it gets none.
    const other = await Sheet.open(browser, proxy.url);
    // The upload that waits for the token has a button of this name as well.
    const cancel = other.page.getByRole("dialog").getByRole("button", { name: "Cancel" });
    await cancel.click();
    await other.page.getByRole("button", { name: "Open the sample creature" }).click();
    await cancel.click();
    await other.page.getByText("this server needs a token").waitFor();
    await other.page.close();
    assert.deepEqual(sheet.complaints.filter((text) => !/401/.test(text)), []);
  } finally {
    proxy.stop();
    await server.kill();
    rmSync(kept, { recursive: true });
  }
}
