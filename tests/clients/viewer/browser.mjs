/** A headless Chromium without a graphics card, and what the scenes ask of its page. */

import { existsSync, mkdirSync } from "node:fs";

const CANDIDATES = [process.env.CHROMIUM, "/usr/bin/chromium", "/usr/bin/chromium-browser", "/usr/bin/google-chrome"];

/** The browser that is installed, if one is. */
export const BROWSER = CANDIDATES.find((path) => path !== undefined && existsSync(path));

/** The hands, which are a package of their own. */
const { chromium } = await import("playwright-core").catch((error) => {
  if (error.code !== "ERR_MODULE_NOT_FOUND") throw error;
  console.error("playwright-core is not installed: npm ci --prefix tests/clients/viewer");
  process.exit(1);
});

/** No step takes this long on a machine that is not stuck: a busy one must not fail. */
const PATIENCE_MS = 180_000;

const PICTURES = new URL("../../../target/viewer/", import.meta.url).pathname;

/** Starts the browser. Software rendering makes pictures the same everywhere, and slow. */
export function launch() {
  return chromium.launch({
    executablePath: BROWSER,
    // A container's root cannot have the browser's own sandbox; pages here are ours.
    args: ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"],
  });
}

/** Opens a page whose server is away, and waits until its paragraph says so. `own` is where the page itself comes from. */
export async function saysWhenAway(browser, own) {
  const page = await browser.newPage();
  await page.route((url) => !url.href.startsWith(own), (route) => route.abort("connectionrefused"));
  await page.goto(own);
  await page.waitForFunction(() => document.querySelector("p").textContent.includes("does not answer"), undefined, { timeout: PATIENCE_MS });
  await page.close();
}

/** A page, what it said on its console, and hands for it. */
export class Sheet {
  constructor(page) {
    this.page = page;
    /** Errors and warnings of the console, uncaught failures, refused policies. */
    this.complaints = [];
    /** Who waits for the dialog that chooses files. Listened for from the start: asked for only when a key is pressed, it may come late. */
    this.choosing = [];
    page.setDefaultTimeout(PATIENCE_MS);
    page.on("filechooser", (chooser) => this.choosing.shift()?.(chooser));
    page.on("console", (message) => {
      if (["error", "warning"].includes(message.type())) this.complaints.push(message.text());
    });
    page.on("pageerror", (error) => this.complaints.push(error.stack ?? String(error)));
  }

  /** `script` runs in the page before its own. */
  static async open(browser, url, { script, ...options } = {}) {
    const context = await browser.newContext({ viewport: { width: 1280, height: 800 }, colorScheme: "dark", ...options });
    if (script !== undefined) await context.addInitScript(script);
    const sheet = new Sheet(await context.newPage());
    await sheet.page.goto(url);
    await sheet.ready();
    return sheet;
  }

  /** Waits until the page has built its canvas. */
  async ready() {
    await this.page.waitForFunction(() => window.pliantViewer !== undefined);
  }

  /** Asks the page's probe. */
  ask(name, ...given) {
    return this.page.evaluate(([method, args]) => window.pliantViewer[method](...args), [name, given]);
  }

  positions() {
    const read = () => {
      const bytes = new Uint8Array(window.pliantViewer.positions().slice().buffer);
      let text = "";
      for (let k = 0; k < bytes.length; k += 32768) text += String.fromCharCode(...bytes.subarray(k, k + 32768));
      return btoa(text);
    };
    return this.page.evaluate(read).then((text) => new Float32Array(Uint8Array.from(Buffer.from(text, "base64")).buffer));
  }

  /** Waits until the page's state says so. */
  async until(what, test, timeout = PATIENCE_MS) {
    const deadline = Date.now() + timeout;
    for (;;) {
      const state = await this.ask("state");
      if (test(state)) return state;
      if (Date.now() > deadline) throw new Error(`${what}: still ${JSON.stringify(state)} after ${timeout / 1000} s`);
      await new Promise((resolve) => setTimeout(resolve, 30));
    }
  }

  /** Gives the page a file as if it had been picked. */
  async pick(...files) {
    const chooser = new Promise((resolve) => this.choosing.push(resolve));
    await this.page.keyboard.press("Control+o");
    await (await chooser).setFiles(files.flat());
  }

  /** Drops a file onto the page. */
  async drop({ name, mimeType, buffer }) {
    await this.page.evaluate(
      ([text, called, type]) => {
        const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
        const dataTransfer = new DataTransfer();
        dataTransfer.items.add(new File([bytes], called, { type }));
        for (const kind of ["dragenter", "dragover", "drop"]) {
          document.body.dispatchEvent(new DragEvent(kind, { dataTransfer, bubbles: true, cancelable: true }));
        }
      },
      [buffer.toString("base64"), name, mimeType],
    );
  }

  async key(name) {
    await this.page.keyboard.press(name);
  }

  /** Undoes, and waits until the page says what that was: until then it takes no other step. */
  async undo() {
    await this.page.evaluate(() => document.querySelectorAll(".notice").forEach((note) => (note.dataset.seen = "")));
    await this.key("Control+z");
    await this.page.locator(".notice:not([data-seen])", { hasText: "Undone" }).waitFor();
  }

  /** Takes a tool by its button: keys such as G begin at once. */
  async tool(name) {
    await this.page.locator(".rail").getByRole("button", { name, exact: false }).click();
  }

  /** Drags the mouse along places, in some steps between each. */
  async drag(places, { steps = 12, pause = 0, holding = [] } = {}) {
    const { mouse, keyboard } = this.page;
    for (const key of holding) await keyboard.down(key);
    await mouse.move(places[0].x, places[0].y);
    await mouse.down();
    for (const { x, y } of places.slice(1)) {
      const from = this.last ?? places[0];
      for (let k = 1; k <= steps; k++) {
        await mouse.move(from.x + ((x - from.x) * k) / steps, from.y + ((y - from.y) * k) / steps);
        if (pause > 0) await new Promise((resolve) => setTimeout(resolve, pause));
      }
      this.last = { x, y };
    }
    await mouse.up();
    this.last = undefined;
    for (const key of holding) await keyboard.up(key);
  }

  /** Where the model is on the page. */
  async outline() {
    return this.page.evaluate(() => {
      const probe = window.pliantViewer;
      const box = { left: Infinity, right: -Infinity, top: Infinity, bottom: -Infinity };
      const count = probe.positions().length / 3;
      // Some thousand vertices tell where a large model ends, too.
      for (let v = 0; v < count; v += Math.ceil(count / 5000)) {
        const { x, y } = probe.place(v);
        box.left = Math.min(box.left, x);
        box.right = Math.max(box.right, x);
        box.top = Math.min(box.top, y);
        box.bottom = Math.max(box.bottom, y);
      }
      return box;
    });
  }

  /** Keeps a picture among the test's artefacts. */
  async picture(name) {
    mkdirSync(PICTURES, { recursive: true });
    return this.page.screenshot({ path: `${PICTURES}${name}.png` });
  }

  /** Red, green, blue of places in a fresh picture of the page. */
  async colours(places) {
    const shot = (await this.page.screenshot()).toString("base64");
    return this.page.evaluate(
      async ([text, wanted]) => {
        const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
        const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/png" }));
        const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
        const paint = canvas.getContext("2d", { willReadFrequently: true });
        paint.drawImage(bitmap, 0, 0);
        return wanted.map(({ x, y }) => [...paint.getImageData(Math.round(x), Math.round(y), 1, 1).data.slice(0, 3)]);
      },
      [shot, places],
    );
  }

  async close() {
    await this.page.context().close();
  }
}
