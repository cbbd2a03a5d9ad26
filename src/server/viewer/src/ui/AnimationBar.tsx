/** The animation that is shown, at the foot of the canvas: frames, how far they have come, what they are shown with. */

import type { JSX } from "preact";
import * as a from "../app/animating.ts";
import { hasComparison } from "../app/comparing.ts";
import * as s from "../app/signals.ts";
import { Button, seconds, things } from "./parts.tsx";
import { count } from "../model/words.ts";
import { Speed } from "./Transport.tsx";

export function AnimationBar(): JSX.Element | null {
  const shown = a.animating.value;
  const long = a.tooLong.value;
  if (long !== undefined) return <TooLong {...long} />;
  if (shown === undefined) return null;
  const { running, kept, wanted, at, source } = shown;
  const { colouring } = s.settings.value;
  return (
    <div class="transport open animation" role="group" aria-label="Animation">
      <div class="row">
        <Button
          bare
          icon={running ? "pause" : "play"}
          label={running ? "Pause the animation" : "Play the animation"}
          keys="Space"
          onClick={running ? a.pauseAnimation : a.playAnimation}
        />
        <input
          type="range"
          aria-label="Frame"
          aria-valuetext={`frame ${at + 1} of ${wanted}, ${seconds(a.secondsAt(at))}`}
          min="0"
          max={Math.max(1, kept - 1)}
          step="1"
          value={at}
          disabled={kept < 2}
          onInput={(event) => a.seekFrame(Number(event.currentTarget.value))}
        />
        <output title={source.title}>
          {count(at + 1)}
          <span class="whole"> of {count(wanted)}</span> · {seconds(a.secondsAt(at))}
        </output>
        <Button bare icon="close" label="Back to editing" keys="Escape" onClick={a.closeAnimation} />
      </div>
      <div class="row">
        <Button bare icon="loop" label="Loop" pressed={a.loops.value} onClick={() => (a.loops.value = !a.loops.peek())} />
        <Button
          bare
          icon="walk"
          label="Root motion"
          pressed={a.followsRoot.value}
          onClick={() => (a.followsRoot.value = !a.followsRoot.peek())}
        />
        <Button
          bare
          icon="stretch"
          label="Stretch colours"
          keys="K"
          pressed={colouring === "stretch"}
          onClick={() => s.choose({ colouring: colouring === "stretch" ? "handles" : "stretch" })}
        />
        {hasComparison.value && (
          <Button
            bare
            icon="beside"
            label="Linear blend skinning beside it"
            pressed={a.comparing.value}
            onClick={() => (a.comparing.value = !a.comparing.peek())}
          />
        )}
        <Speed />
        <Progress kept={kept} wanted={wanted} />
      </div>
    </div>
  );
}

function Progress({ kept, wanted }: { kept: number; wanted: number }): JSX.Element | null {
  const coming = a.coming.value;
  if (kept >= wanted) return null;
  if (coming === undefined) {
    return (
      <>
        <span class="coming" role="status">
          {count(kept)} of {things(wanted, "frame")}
        </span>
        <Button label="Resume" onClick={() => void a.goOn()} />
      </>
    );
  }
  const { perSecond, cancel } = coming;
  const left = perSecond > 0 ? `, ${perSecond.toPrecision(2)} frames/s, ${duration((wanted - kept) / perSecond)} left` : "";
  return (
    <>
      <span class="coming" role="status">
        <progress value={kept / wanted} aria-label="Received frames" />
        <span>
          frame {count(kept)} of {count(wanted)}
          <span class="whole">{left}</span>
        </span>
      </span>
      <Button label="Cancel" onClick={cancel} />
    </>
  );
}

function duration(n: number): string {
  return n < 90 ? `${Math.ceil(n)} s` : `${Math.ceil(n / 60)} min`;
}

/** An animation that does not fit, and what would. */
function TooLong({ source, frames, bytes, ways }: a.TooLong): JSX.Element {
  return (
    <div class="transport animation" role="alertdialog" aria-label="Too many frames">
      <p>
        {things(frames, "frame")} of {source.title} take {(bytes / 2 ** 30).toPrecision(2)} GiB, more than a page can keep.
      </p>
      <div class="row">
        {ways.map(({ says, options }) => (
          <Button label={says} onClick={() => void a.animate(source, options)} />
        ))}
        <Button bare icon="close" label="Cancel" onClick={() => (a.tooLong.value = undefined)} />
      </div>
    </div>
  );
}

/** What is seen in which half. */
export function Panes(): JSX.Element | null {
  if (!a.isCompared.value) return null;
  return (
    <div class="panes" aria-hidden="true">
      <span>linear blend skinning</span>
      <span>pliant</span>
    </div>
  );
}
