/** The start page of a server with two tenants: each sees what is theirs, all of it, by name and age. */

import assert from "node:assert/strict";
import { execFileSync } from "node:child_process";
import { mkdtempSync, rmSync, writeFileSync } from "node:fs";
import { tmpdir } from "node:os";
import { join } from "node:path";
import { Sheet } from "../browser.mjs";
import { finger } from "../models.mjs";
import { serve } from "../proxy.mjs";
import { BINARY, Server } from "../server.mjs";

export const title = "the start page lists a tenant's own models, all of them, by name and age";

/** More than fit without scrolling. */
const MANY = 12;

export async function play({ browser, folder }) {
  const [ours, theirs] = ["studio", "rival"].map((tenant) => execFileSync(BINARY, ["token", tenant], { encoding: "utf8" }).split("\n\n"));
  const kept = mkdtempSync(join(tmpdir(), "pliant-"));
  writeFileSync(join(kept, "pliant.toml"), [ours[1], theirs[1], "[quotas]\nsessions = 40\n"].join("\n"));
  const server = await Server.start("--config", join(kept, "pliant.toml"), "--sessions", "40");
  const proxy = await serve(folder, () => server.url);
  const open = async (token, label) => {
    const options = encodeURIComponent(JSON.stringify({ label }));
    const headers = { authorization: `Bearer ${token}` };
    const answer = await fetch(`${server.url}/v1/sessions?sample=creature&options=${options}`, { method: "POST", headers });
    assert.ok(answer.ok, await answer.text());
  };
  try {
    for (let k = 1; k <= MANY; k++) await open(ours[0], `dog-${k}.glb`);
    await open(ours[0], "");
    await open(theirs[0], "secret.glb");

    const sheet = await Sheet.open(browser, proxy.url);
    await tell(sheet, ours[0]);
    const list = sheet.page.getByRole("region", { name: "Open on this server" });
    await list.waitFor();
    const names = () => list.locator("strong").allInnerTexts();
    const [unnamed, ...rest] = await names();
    assert.match(unnamed, /^GLB [0-9a-f]{8}$/, "a model without a name goes by its format");
    assert.deepEqual(rest, Array.from({ length: MANY }, (_, k) => `dog-${MANY - k}.glb`), "all of them, the newest first");
    for (const line of await list.locator("small").allInnerTexts()) assert.match(line, /^opened (just now|\d+ minutes? ago), 8\D?628 vertices, 0 handles; revision 1, expires in \d+ (min|h|d) if unused$/);
    // What others open meanwhile is listed when the window is looked at again.
    await open(ours[0], "later.glb");
    await sheet.page.evaluate(() => dispatchEvent(new Event("focus")));
    await list.getByText("later.glb").waitFor();
    await list.locator(".session").last().scrollIntoViewIfNeeded();
    await sheet.picture("start");

    // What was open in this browser is offered to whoever opened it, and to nobody else.
    await sheet.pick(finger(2000));
    await sheet.until("the model opens", ({ link, busy }) => link === "open" && !busy);
    const session = await sheet.ask("session");
    await new Promise((resolve) => setTimeout(resolve, 200));
    const gone = await fetch(`${server.url}/v1/sessions/${session}`, { method: "DELETE", headers: { authorization: `Bearer ${ours[0]}` } });
    assert.ok(gone.ok);
    const last = async (token) => {
      const other = new Sheet(await sheet.page.context().newPage());
      await other.page.goto(proxy.url);
      await other.ready();
      await tell(other, token);
      await other.page.getByRole("region", { name: "Open on this server" }).waitFor();
      return { other, told: await other.page.locator(".start").innerText() };
    };
    const rival = await last(theirs[0]);
    assert.ok(rival.told.includes("secret.glb") && !/dog-|finger/.test(rival.told), `the other tenant is told: ${rival.told}`);
    assert.ok(!rival.told.includes("Last time"));
    const same = await last(ours[0]);
    assert.match(same.told, /Last time\s+finger\S* *\s*used (just now|\d+ minutes? ago), /);
    await same.other.picture("start-last");
  } finally {
    proxy.stop();
    await server.kill();
    rmSync(kept, { recursive: true });
  }
}

/** Gives the token that is asked for. */
async function tell(sheet, token) {
  const field = sheet.page.getByLabel("Token", { exact: true });
  await field.waitFor();
  await field.fill(token);
  await field.press("Enter");
}
