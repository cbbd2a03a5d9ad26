/** How long ago something was, for people. */

const UNITS: readonly (readonly [unit: Intl.RelativeTimeFormatUnit, seconds: number, short: string])[] = [
  ["year", 31_557_600, "y"],
  ["month", 2_629_800, "months"],
  ["day", 86_400, "d"],
  ["hour", 3600, "h"],
  ["minute", 60, "min"],
];

const WORDS = new Intl.RelativeTimeFormat("en", { numeric: "always" });

/** Such as "in 5 min"; nothing of a time that cannot be read. */
export function timeTo(at: number, now = Date.now()): string | undefined {
  if (!Number.isFinite(at)) return undefined;
  const seconds = Math.max(0, at - now) / 1000;
  const [, length, short] = UNITS.find(([, size]) => seconds >= size) ?? [];
  return length === undefined ? "in a moment" : `in ${Math.floor(seconds / length)} ${short}`;
}

/** Such as "5 minutes ago"; nothing of a time that cannot be read. */
export function ageOf(at: number, now = Date.now()): string | undefined {
  if (!Number.isFinite(at)) return undefined;
  const seconds = Math.max(0, now - at) / 1000;
  const [unit, length] = UNITS.find(([, size]) => seconds >= size) ?? [];
  return unit === undefined || length === undefined ? "just now" : WORDS.format(-Math.floor(seconds / length), unit);
}
