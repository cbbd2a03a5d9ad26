/** What the server says to programs and command lines, said to somebody who has a page in front of them. */

const SAID: readonly (readonly [pattern: RegExp, words: string])[] = [
  [
    /; send it along as another part of a multipart upload.*$/s,
    "; drop the model together with $FILE, or drop the folder that they are in",
  ],
  [
    /; in `pliant rig` give joints with --at NAME=x,y,z .*$/s,
    "; drop a rig (a JSON file that places its joints) together with the clip: “A rig for a model” in deploy/docs/animation.md has one",
  ],
  [/rig: is missing, and pliant rig finds none: model: /, "a rig is needed, and none can be made from this model: "],
];

/** The server's message without flags of the command line and parts of forms. */
export function forPeople(message: string): string {
  const file = /the file "([^"]+)" is missing/.exec(message)?.[1] ?? "it";
  return SAID.reduce((text, [pattern, words]) => text.replace(pattern, () => words.replace("$FILE", () => file)), message);
}

/** Whole numbers with commas, as the server writes them. */
export function count(n: number | bigint | undefined): string {
  return (n ?? 0).toLocaleString("en");
}
