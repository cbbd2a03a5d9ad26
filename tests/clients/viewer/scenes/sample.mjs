/** Opens the built-in creature by its button. */

export async function openSample(sheet) {
  await sheet.page.getByRole("button", { name: "Open the sample creature" }).click();
  await sheet.until("the creature opens", ({ link, busy, revision }) => link === "open" && !busy && revision === "2");
}
