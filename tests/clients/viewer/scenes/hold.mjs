/** Two handles by mouse on whatever model is open: its lower end pinned, its upper end gripped. */

/** Box-selects the lowest and the highest part of the model as the user would; answers the grip. */
export async function holdBothEnds(sheet, share = 0.2) {
  const { left, right, top, bottom } = await sheet.outline();
  const height = bottom - top;
  await sheet.key("x");
  await sheet.key("t");
  await sheet.drag([
    { x: left - 10, y: bottom + 10 },
    { x: right + 10, y: bottom - height * share },
  ]);
  await sheet.until("the box selects", ({ selected }) => selected > 0);
  await sheet.key("p");
  await sheet.page.waitForFunction(() => window.pliantViewer.handles().length === 1);
  await sheet.drag([
    { x: left - 10, y: top - 10 },
    { x: right + 10, y: top + height * share },
  ]);
  await sheet.until("the box selects", ({ selected }) => selected > 0);
  await sheet.key("Enter");
  await sheet.page.waitForFunction(() => window.pliantViewer.handles().length === 2);
  await sheet.key("t");
  const handles = await sheet.ask("handles");
  return handles[1];
}

/**
 * Presses the mouse on the gizmo of the model's second handle; answers that handle. A page that paints slowly has the gizmo there only
 * after its next picture, so the mouse goes there until the gizmo has it.
 */
export async function takeGrip(sheet) {
  const { mouse } = sheet.page;
  for (let attempt = 0; attempt < 1000; attempt++) {
    const [, grip] = await sheet.ask("handles");
    await mouse.move(grip.at.x - 40, grip.at.y - 40);
    await mouse.move(grip.at.x, grip.at.y);
    await new Promise((resolve) => setTimeout(resolve, 50));
    if ((await sheet.ask("state")).gizmoPart !== null) {
      await mouse.down();
      return grip;
    }
  }
  throw new Error("the gizmo is not where its handle is");
}

/** Takes the gizmo's centre and leads it along; answers the state after the release was recorded. */
export async function dragGrip(sheet, grip, by, { steps = 30, pause = 16 } = {}) {
  const { revision } = await sheet.ask("state");
  await sheet.page.mouse.move(grip.at.x - 40, grip.at.y - 40);
  const places = [grip.at, ...by.map(({ x, y }) => ({ x: grip.at.x + x, y: grip.at.y + y }))];
  await sheet.drag(places, { steps, pause });
  return sheet.until("the release is recorded", (state) => state.revision !== revision);
}

/** What the page's handles are in the words of the HTTP calls. */
export function asHandles(handles, poses = false) {
  return handles.map((handle) => ({
    id: handle.id,
    region: { vertices: { indices: handle.vertices } },
    ...(poses ? { pose: asPose(handle) } : {}),
  }));
}

/** A pose as the page sends it: about the page's pivot, or with a turn that the server finds. */
export function asPose({ pose, pivot }) {
  const { translation, rotation, scale, freely } = pose;
  return { translation, rotationVector: rotation, scale, ...(freely ? { freeRotation: true } : { pivot }) };
}

/** The largest distance between two buffers, and the diagonal of the second one's box. */
export function compare(a, b) {
  if (a.length !== b.length) throw new Error(`buffers of ${a.length / 3} and ${b.length / 3} vertices`);
  let worst = 0;
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  for (let k = 0; k < a.length; k += 3) {
    worst = Math.max(worst, Math.hypot(a[k] - b[k], a[k + 1] - b[k + 1], a[k + 2] - b[k + 2]));
    for (let c = 0; c < 3; c++) {
      low[c] = Math.min(low[c], b[k + c]);
      high[c] = Math.max(high[c], b[k + c]);
    }
  }
  return { worst, diagonal: Math.hypot(...high.map((x, c) => x - low[c])) };
}

/**
 * Waits until the page shows these positions, to within `slack` model units: what was recorded is painted with the next
 * picture, and this browser paints slowly. Answers how far it is from them in the end.
 */
export async function shows(sheet, wanted, slack = 0, timeout = 120_000) {
  const deadline = Date.now() + timeout;
  for (;;) {
    const positions = await sheet.positions();
    const seen = positions.length === wanted.length ? compare(positions, wanted) : { worst: Infinity, diagonal: 1 };
    if (seen.worst <= slack || Date.now() > deadline) return seen;
    await new Promise((resolve) => setTimeout(resolve, 50));
  }
}
