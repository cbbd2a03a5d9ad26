/** What the mouse does, in words, for the panels and the help sheet. */

import type { LooksWith } from "../app/signals.ts";

/** Whether fingers are what the page is used with. */
export function hasFingers(): boolean {
  return matchMedia("(pointer: coarse)").matches;
}

/** How a selection is drawn and the model looked at, with what the user has. */
export function selectingMeans(looksWith: LooksWith): string {
  if (hasFingers()) return "One finger selects; two pan, and zoom by pinching. With the tool “Orbit” one finger turns the model.";
  return `Shift adds, Alt takes away. ${buttonsMean(looksWith)}`;
}

/** What the buttons mean whatever the tool; `armTool` makes it so. */
export function buttonsMean(looksWith: LooksWith): string {
  const [looks, pans] = looksWith === "middle" ? ["middle", "right"] : ["right", "middle"];
  return `The ${looks} button orbits, and so does the left one unless the tool selects; with Shift they pan, as the ${pans} button does; the wheel zooms.`;
}
