/** Clips of the model, at the foot of the canvas: which, play and pause, where, how fast. */

import type { JSX } from "preact";
import { animating, pauseAnimation, playAnimation } from "../app/animating.ts";
import { wardrobe } from "../app/dressing.ts";
import { bringBack } from "../app/intermission.ts";
import { fetchingClip, pauseClip, playClip, playSpeed, playing, seekClip } from "../app/playing.ts";
import { useState } from "preact/hooks";
import { Button, Select, seconds } from "./parts.tsx";

const SPEEDS = ["0.25", "0.5", "1", "2"] as const;

/** Plays what is on the screen, or pauses it; without that, the first clip. For the keyboard. */
export function togglePlay(): void {
  const animation = animating.peek();
  if (animation !== undefined) return animation.running ? pauseAnimation() : playAnimation();
  const shown = playing.peek();
  if (shown?.running) pauseClip();
  else if (shown !== undefined) void playClip(shown.clip);
  else {
    const first = wardrobe.peek().clips.findIndex(({ channels }) => channels > 0);
    if (first >= 0) void playClip(first);
  }
}

export function Transport(): JSX.Element | null {
  const [chosen, setChosen] = useState(0);
  const { clips } = wardrobe.value;
  if (clips.length === 0 || animating.value !== undefined) return null;
  const shown = playing.value;
  const clip = shown?.clip ?? (clips[chosen] === undefined ? 0 : chosen);
  const facts = clips[clip];
  const choose = (next: number): void => {
    setChosen(next);
    if (shown !== undefined) void playClip(next);
  };
  const running = shown?.running === true;
  const duration = facts?.duration ?? 0;
  return (
    <div class={`transport${shown === undefined ? "" : " open"}`} role="group" aria-label="Clips">
      <Button
        bare
        icon={running ? "pause" : "play"}
        label={running ? "Pause the clip" : "Play the clip"}
        keys="Space"
        disabled={facts === undefined || facts.channels === 0 || fetchingClip.value}
        onClick={() => (running ? pauseClip() : void playClip(clip))}
      />
      <Select
        label="Clip"
        value={String(clip)}
        options={clips.map(({ name, channels }, k) => [String(k), channels === 0 ? `${name} (moves nothing)` : name] as const)}
        onValue={(value) => choose(Number(value))}
      />
      {shown !== undefined && (
        <>
          <input
            type="range"
            aria-label="Time in the clip"
            min="0"
            max={duration}
            step={duration / 1000 || 1}
            value={shown.seconds}
            disabled={duration === 0}
            onInput={(event) => seekClip(Number(event.currentTarget.value))}
          />
          <output>
            {seconds(shown.seconds)}
            <span class="whole"> / {seconds(duration)}</span>
          </output>
          <Speed />
          <Button bare icon="close" label="Back to editing" keys="Escape" onClick={bringBack} />
        </>
      )}
      {facts?.fault !== undefined && <small title={facts.fault}>{facts.fault}</small>}
    </div>
  );
}

/** How fast clips and animations are played. */
export function Speed(): JSX.Element {
  return (
    <span class="speed">
      <Select
        label="Speed"
        value={String(playSpeed.value) as (typeof SPEEDS)[number]}
        options={SPEEDS.map((speed) => [speed, `${speed}×`] as const)}
        onValue={(value) => (playSpeed.value = Number(value))}
      />
    </span>
  );
}
