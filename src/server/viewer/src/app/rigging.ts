/**
 * Rigs: the joints that the server has found in the model, or that a rig file has, shown over the model in the rest pose. Where one is wrong
 * it is dragged; what was found is found again around it. Clips are animated by the rig that is shown.
 */

import { toJson } from "@bufbuild/protobuf";
import { effect, signal } from "@preact/signals";
import { type Vector, schema } from "pliant-client";
import type { DrawnJoint } from "../scene/joints.ts";
import { firstFrames } from "../model/recording.ts";
import type { ClipSource } from "./animating.ts";
import { bringBack, onScreen, putAside } from "./intermission.ts";
import * as s from "./signals.ts";
import { toModel, toPage } from "./space.ts";
import { view } from "./view.ts";

/** A joint on the page. */
export interface RigJoint {
  readonly name: string;
  readonly at: Vector;
  /** How sure its place is, 0 to 1; unknown in a rig file. */
  readonly score: number | undefined;
  readonly doubtful: boolean;
  /** What speaks against it. */
  readonly reason: string;
  /** Whether the user has put it where it is. */
  readonly given: boolean;
}

/** The rig that is shown. */
export interface Rigging {
  /** The recording that it is for. */
  readonly source: ClipSource;
  readonly joints: readonly RigJoint[];
  /** By the names of the joints that they join. */
  readonly bones: readonly (readonly [string, string])[];
  /** What a rig file would hold. */
  readonly rig: RigFile;
  /** Whether the rig comes from a file, whose other joints stay where they are. */
  readonly own: boolean;
  /** Whether joints can be put elsewhere; those of a skin cannot. */
  readonly movable: boolean;
}

interface RigFile {
  joints?: Record<string, { at: number[] } | number[]>;
  bones?: { from: string; to: string }[];
  [other: string]: unknown;
}

const SURE = 0x57b86f;
const GIVEN = 0x34bace;
const DOUBTFUL = 0xe5342b;

export const rigging = signal<Rigging | undefined>(undefined);
/** Whether the server is at work on it. */
export const finding = signal(false);

/** Joints that the user has put somewhere, by name: they hold for this model's next rigs, too. */
let given: Record<string, Vector> = {};
let givenFor: unknown;
/** Whether a joint was put somewhere while the server was at work. */
let again = false;

/** The places that joints were given in this model. */
function corrections(): Record<string, Vector> {
  const model = s.doc.peek()?.session;
  if (givenFor !== model) [given, givenFor] = [{}, model];
  return given;
}

/** The rig of a recording with joints where the user has put them before; nothing where none was put anywhere. */
export async function correctedRig(bvh: Blob): Promise<unknown> {
  if (Object.keys(corrections()).length === 0) return undefined;
  return plain(await make(bvh));
}

/** Shows the joints of the rig that a recording drives the model by, found or of its file. */
export async function showRig(source: ClipSource): Promise<void> {
  const shown = source.rig === undefined ? await found(source) : ofFile(source, source.rig as RigFile);
  if (shown !== undefined) show(shown);
}

/** Shows the joints that a recording was refused for, if there are any; what the user has begun before they come goes on. */
export async function showDoubts(source: ClipSource): Promise<void> {
  const state = (): unknown[] => [s.doc, onScreen, s.tool, s.currentRevision, s.dragging, s.busy].map((part) => part.peek());
  const before = state();
  const shown = await found(source, true);
  if (shown?.joints.some(({ doubtful }) => doubtful) !== true || state().some((value, k) => value !== before[k])) return;
  show(shown);
  // What is shown says why, and the message would lie over the model's feet.
  s.dismissErrors();
}

function show(shown: Rigging): void {
  const [open, { surface }] = [s.doc.peek(), view().stage];
  if (surface === undefined || open === undefined) return;
  bringBack();
  putAside("rig", surface, () => (rigging.value = undefined));
  surface.positions.set(open.rest);
  surface.moved(false);
  rigging.value = shown;
}

export function closeRig(): void {
  bringBack();
}

async function make(bvh: Blob | undefined): Promise<schema.MakeRigResponse> {
  const open = s.doc.peek();
  if (open === undefined) throw new Error("no model is open");
  return open.session.makeRig({
    joints: Object.fromEntries(Object.entries(corrections()).map(([name, at]) => [name, toModel(at)])),
    ...(bvh !== undefined && { bvh: await firstFrames(bvh) }) });
}

async function found(source: ClipSource, quietly = false): Promise<Rigging | undefined> {
  finding.value = true;
  try {
    const answer = await make(source.bvh);
    const rig = plain(answer);
    const joints = answer.joints.map(({ name, at: [x = 0, y = 0, z = 0], score, doubtful, reason }): RigJoint => {
      // It may have been put there after the server was asked.
      const { [name]: own } = corrections();
      return own === undefined ? { name, score, doubtful, reason, at: toPage([x, y, z]), given: false } : { name, score: 1, doubtful: false, reason: "", at: own, given: true };
    });
    return { source, joints, bones: bonesOf(rig), rig, own: false, movable: answer.source !== "skin" };
  } catch (error) {
    if (!quietly) s.fail("No joints were found", error);
    return undefined;
  } finally {
    finding.value = false;
  }
}

function ofFile(source: ClipSource, rig: RigFile): Rigging | undefined {
  const joints = Object.entries(rig.joints ?? {}).map(([name, place]) => {
    const [x = 0, y = 0, z = 0] = Array.isArray(place) ? place : place.at;
    return { name, at: toPage([x, y, z]), score: undefined, doubtful: false, reason: "", given: false };
  });
  return joints.length === 0 ? undefined : { source, joints, bones: bonesOf(rig), rig, own: true, movable: true };
}

const bonesOf = (rig: RigFile): (readonly [string, string])[] => (rig.bones ?? []).map(({ from, to }) => [from, to] as const);

/** The rig as a file has it. */
function plain({ rig }: schema.MakeRigResponse): RigFile {
  return (rig === undefined ? {} : toJson(schema.RigSchema, rig)) as RigFile;
}

/** A joint is dragged. */
function moved(name: string, at: Vector): void {
  const shown = rigging.peek();
  if (shown?.movable !== true) return;
  const joints = shown.joints.map((joint) => (joint.name === name ? { ...joint, at, score: shown.own ? undefined : 1, doubtful: false, reason: "", given: true } : joint));
  rigging.value = { ...shown, joints };
}

/** A joint was put somewhere: what was found is found again around it. */
async function dropped(name: string): Promise<void> {
  const shown = rigging.peek();
  const joint = shown?.joints.find((own) => own.name === name);
  if (shown === undefined || joint === undefined || !joint.given) return;
  if (shown.own) {
    const rig = { ...shown.rig, joints: { ...shown.rig.joints, [name]: { at: [...toModel(joint.at)] } } };
    rigging.value = { ...shown, rig };
    return;
  }
  const { [name]: before } = corrections();
  corrections()[name] = joint.at;
  // One search at a time: the next one knows all that was put meanwhile.
  again = finding.peek();
  if (again) return;
  do {
    again = false;
    const found = await findAgain(shown);
    if (!found && !again) {
      // What the server refuses is as it was.
      if (before === undefined) delete corrections()[name];
      else corrections()[name] = before;
      await findAgain(shown);
    }
  } while (again);
}

/** Takes all corrections back. */
export async function forgetCorrections(): Promise<void> {
  const shown = rigging.peek();
  if (shown === undefined) return;
  given = {};
  if (shown.own) rigging.value = ofFile(shown.source, shown.source.rig as RigFile);
  else await findAgain(shown);
}

/** Asks again for the joints that are shown; whether they came. */
async function findAgain(shown: Rigging): Promise<boolean> {
  const next = await found(shown.source);
  if (next !== undefined && rigging.peek()?.source === shown.source) rigging.value = next;
  return next !== undefined;
}

/** Draws what is shown. */
export function installRigging(): void {
  const colour = ({ doubtful, given }: RigJoint): number => (doubtful ? DOUBTFUL : given ? GIVEN : SURE);
  effect(() => {
    const shown = rigging.value;
    const drawn: DrawnJoint[] = (shown?.joints ?? []).map((joint) => ({ name: joint.name, at: joint.at, colour: colour(joint) }));
    view().joints.show(drawn, shown?.bones ?? []);
  });
  effect(() => {
    if (onScreen.value !== "rig") rigging.value = undefined;
  });
}

export const jointEvents = { moved, dropped: (name: string): void => void dropped(name) };
