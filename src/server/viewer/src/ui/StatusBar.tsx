/** The bar at the bottom: the connection, and what the last frame cost and is worth. */

import type { JSX } from "preact";
import * as s from "../app/signals.ts";
import { bytes } from "./parts.tsx";
import { count } from "../model/words.ts";

const LINKS = {
  none: "no session",
  connecting: "connecting",
  open: "connected",
  lost: "reconnecting",
  gone: "session gone",
  closed: "closed",
} as const;

export function StatusBar(): JSX.Element {
  const { state } = s.link.value;
  const meters = s.meters.value;
  return (
    <footer class="status" aria-label="Status">
      <span class="link">
        <span class={`dot ${state}`} />
        {LINKS[state]}
      </span>
      {s.recording.value > 0 && (
        <span class="link" role="status">
          <span class="dot lost" />
          recording the pose
        </span>
      )}
      {meters !== undefined && (
        <>
          <Meter name="solve" value={time(meters.solveMs)} hint="Milliseconds that the last frame took to solve" />
          <Meter name="wait" value={time(meters.queueMs)} hint="Milliseconds before the solve began" />
          <Meter name="error" value={errorText(meters.maxError)} hint="Estimated error, as a share of the box's diagonal" />
          <Meter name="skipped" value={count(s.superseded.value)} hint="Poses that a newer one replaced before they were solved" />
          <Meter name="shapes/s" value={meters.fps.toFixed(0)} hint="Shapes painted in the last second of dragging" />
          <Meter name="frame" value={bytes(meters.bytes)} hint="Bytes of the last frame" />
        </>
      )}
      <span class="gap" />
      {s.doc.value !== undefined && <Meter name="revision" value={String(s.currentRevision.value)} hint="The commit that the session is at" />}
    </footer>
  );
}

function Meter({ name, value, hint }: { name: string; value: string; hint: string }): JSX.Element {
  return (
    <span class="meter" title={hint}>
      <span>{name}</span> <b>{value}</b>
    </span>
  );
}

function errorText(fraction: number): string {
  const percent = fraction * 100;
  if (percent === 0) return "0 %";
  return percent < 1e-4 ? "< 0.0001 %" : `${Number(percent.toPrecision(2))} %`;
}

function time(ms: number): string {
  return ms < 1000 ? `${ms.toFixed(1)} ms` : `${(ms / 1000).toFixed(1)} s`;
}
