/** The reference page: it finds calls by words, and makes them. */

import assert from "node:assert/strict";

export const title = "the reference finds calls, makes them, and goes on with what they opened";

export async function play({ browser, server }) {
  const context = await browser.newContext({ viewport: { width: 1280, height: 800 } });
  const page = await context.newPage();
  page.setDefaultTimeout(180_000);
  const complaints = [];
  page.on("pageerror", (error) => complaints.push(error.stack ?? String(error)));
  page.on("console", (message) => ["error", "warning"].includes(message.type()) && complaints.push(message.text()));
  await page.goto(`${server.url}/docs`);

  // By words, from the keyboard.
  const sections = page.locator("main section[id]");
  const all = await sections.count();
  await page.keyboard.press("/");
  await page.keyboard.type("undo session");
  const shown = await sections.filter({ visible: true }).count();
  assert.ok(shown > 0 && shown < all / 4, `${shown} of ${all} sections hold these words`);
  await page.getByRole("searchbox").fill("no such words here");
  assert.equal(await sections.filter({ visible: true }).count(), 0);
  assert.ok(await page.locator("#nothing").isVisible(), "that nothing is found is said");
  await page.getByRole("searchbox").fill("");
  assert.equal(await sections.filter({ visible: true }).count(), all);

  // Each call shows how to make it with curl and, where the package has it, with Python.
  const samples = await page.locator("section#solve pre").allInnerTexts();
  assert.equal(samples.length, 2);
  assert.match(samples[0], /^curl -sS --fail-with-body -X POST "http:.*\/v1\/sessions\/\$id\/solve"/);
  assert.match(samples[1], /session\.solve\(/);

  // A call opens a session; the next ones know which.
  const call = (words) => {
    const section = sections.filter({ has: page.locator("h3", { hasText: words }) }).first();
    const send = async () => {
      await section.getByRole("button", { name: "Send" }).click();
      await section.locator("form .good, form .bad").waitFor();
      return section.locator("form div").last().innerText();
    };
    return { section, open: () => section.locator("summary", { hasText: "Try it" }).click(), send };
  };
  const create = call(/POST\s*\/v1\/sessions$/);
  await create.open();
  assert.match(await create.send(), /^201 Created/);
  const { id } = JSON.parse(await create.section.locator("form pre").innerText());
  const handles = call(/PUT\s*\/v1\/sessions\/\{id\}\/handles$/);
  await handles.open();
  assert.equal(await handles.section.locator("input[name=id]").inputValue(), id, "the session that was opened is filled in");
  assert.match(await handles.send(), /^200 OK/);
  const solve = call(/POST\s*\/v1\/sessions\/\{id\}\/solve$/);
  await solve.open();
  assert.match(await solve.send(), /^200 OK/);

  // What the server refuses is shown with its words.
  await solve.section.locator("textarea").fill('{"pose": {"handles": [{"id": "nobody", "pose": {}}]}}');
  const refused = await solve.send();
  assert.match(refused, /^4\d\d /);
  assert.match(refused, /nobody/);

  // A model of one's own is sent in place of the sample.
  const bar = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";
  await create.section.locator("input[type=file]").setInputFiles({ name: "bar.obj", mimeType: "model/obj", buffer: Buffer.from(bar) });
  await create.section.locator("input[name=format]").fill("obj");
  assert.match(await create.send(), /^201 Created[\s\S]*"vertexCount": 4/);

  // What is no text can be saved.
  const model = call(/GET\s*\/v1\/sessions\/\{id\}\/model$/);
  await model.open();
  assert.match(await model.send(), /^200 OK[\s\S]*bytes save /);
  const coming = page.waitForEvent("download");
  await model.section.getByRole("link", { name: /^save / }).click();
  assert.match((await coming).suggestedFilename(), /\.obj$/);
  const failures = complaints.filter((line) => !line.includes("status of 4"));
  assert.deepEqual(failures, []);
  await context.close();
}
