/** What the mouse does, in words: the panels and the help sheet tell the same. */

import type { LooksWith } from "../app/signals.ts";

/** What the buttons mean whatever the tool; `armTool` makes it so. */
export function buttonsMean(looksWith: LooksWith): string {
  const [looks, pans] = looksWith === "middle" ? ["middle", "right"] : ["right", "middle"];
  return `The ${looks} button looks around; with Shift, or with the ${pans} button, it pans; the wheel zooms.`;
}
