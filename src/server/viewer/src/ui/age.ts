/** How long ago something was, for people. */

const UNITS: readonly (readonly [unit: Intl.RelativeTimeFormatUnit, seconds: number])[] = [
  ["year", 31_557_600],
  ["month", 2_629_800],
  ["day", 86_400],
  ["hour", 3600],
  ["minute", 60],
];

const WORDS = new Intl.RelativeTimeFormat("en", { numeric: "always" });

/** Such as "in 5 minutes"; nothing of a time that cannot be read. */
export function timeTo(at: number, now = Date.now()): string | undefined {
  if (!Number.isFinite(at)) return undefined;
  const seconds = Math.max(0, at - now) / 1000;
  const [unit, length] = UNITS.find(([, size]) => seconds >= size) ?? [];
  return unit === undefined || length === undefined ? "in a moment" : WORDS.format(Math.floor(seconds / length), unit);
}

/** Such as "5 minutes ago"; nothing of a time that cannot be read. */
export function ageOf(at: number, now = Date.now()): string | undefined {
  if (!Number.isFinite(at)) return undefined;
  const seconds = Math.max(0, now - at) / 1000;
  const [unit, length] = UNITS.find(([, size]) => seconds >= size) ?? [];
  return unit === undefined || length === undefined ? "just now" : WORDS.format(-Math.floor(seconds / length), unit);
}
