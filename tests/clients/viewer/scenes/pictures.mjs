/** How the page looks: empty, busy, failing, in both themes, with the help sheet and the stretch colours. */

import assert from "node:assert/strict";
import { Sheet } from "../browser.mjs";
import { finger } from "../models.mjs";
import { dragGrip } from "./hold.mjs";
import { openSample } from "./sample.mjs";

export const title = "pictures of every state, and no complaint of the console";

export async function play({ browser, url }) {
  for (const scheme of ["dark", "light"]) {
    const sheet = await Sheet.open(browser, url(), { colorScheme: scheme });
    await sheet.page.getByRole("heading", { name: "Bend a model" }).waitFor();
    await sheet.picture(`empty-${scheme}`);

    await sheet.pick({ name: "notes.txt", mimeType: "text/plain", buffer: Buffer.from("no model") });
    await sheet.page.getByText("Not a model").waitFor();
    await sheet.pick({ name: "broken.glb", mimeType: "model/gltf-binary", buffer: Buffer.from("glTF, but not really") });
    await sheet.page.getByText("Opening broken.glb failed").waitFor();
    await sheet.picture(`error-${scheme}`);
    assert.equal(await sheet.page.locator(".notice").count(), 1, "an attempt takes away what the one before it said");
    const dismiss = sheet.page.getByRole("button", { name: "Dismiss" });
    while ((await dismiss.count()) > 0) await dismiss.first().click();
    // The browser itself writes refused calls to its console.
    sheet.complaints = sheet.complaints.filter((text) => !/Failed to load resource.*(400|422)/.test(text));

    await sheet.pick(finger(scheme === "dark" ? 120_000 : 60_000));
    await sheet.page.locator(".card.busy").waitFor();
    await sheet.picture(`busy-${scheme}`);
    await sheet.until("the model opens", ({ link, busy }) => link === "open" && !busy);
    await sheet.page.getByRole("button", { name: "Close the model" }).click();

    await openSample(sheet);
    await sheet.picture(`open-${scheme}`);
    const [, head] = await sheet.ask("handles");
    await dragGrip(sheet, head, [{ x: 110, y: -30 }]);
    await sheet.key("k");
    await sheet.page.getByText("as in the rest pose").waitFor();
    await sheet.picture(`stretch-${scheme}`);
    await sheet.key("k");
    const plain = await sheet.picture(`handles-${scheme}`);
    await sheet.key("w");
    const wired = await sheet.picture(`wire-${scheme}`);
    assert.ok(!plain.equals(wired), "the wire is drawn");
    await sheet.key("w");

    await sheet.page.locator("summary").getByText("Edit", { exact: true }).click();
    await sheet.page.getByRole("radio", { name: "Y", exact: true }).click();
    await sheet.page.getByRole("button", { name: "Cut", exact: true }).scrollIntoViewIfNeeded();
    await sheet.picture(`edit-${scheme}`);
    await sheet.key("Escape");

    await sheet.key("?");
    await sheet.page.getByRole("heading", { name: "How it works" }).waitFor();
    await sheet.picture(`help-${scheme}`);
    await sheet.key("Escape");
    assert.deepEqual(sheet.complaints, []);
    await sheet.close();
  }
}
