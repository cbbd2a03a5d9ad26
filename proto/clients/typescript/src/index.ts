/**
 * The TypeScript client of pliant, for pages and for node.
 *
 * `Client` opens a `Session`; `Session.stream()` gives a `Stream` on which handles are dragged at display rate.
 */

export { Animation, type AnimatedFrame, type AnimateOptions } from "./animation.js";
export { Client, type CreateOptions, type OpenOptions } from "./client.js";
export { companionNames, companionsOf, type PlacedFile } from "./companions.js";
export { PliantError, statusName } from "./errors.js";
export { Assembler, Frame, type FrameFacts, inModelSpace } from "./frames.js";
export { type Named } from "./names.js";
export { targets, type VertexTargetsPose } from "./poses.js";
export { regionFrom, regionOf, type PlainRegion, type Point, type RegionKinds, type RegionLike } from "./regions.js";
export { nearestRotationVector, quaternionOf, turnsOf, type Quaternion, type Vector } from "./rotation.js";
export { Session, type Carried, type CarriedModel, type Edit, type Format, type Handle, type HandleField, type PoseEntry, type RigOrder, type SetHandles, type SolveOptions, type Solved, type TransferOptions, type WorkOptions, type WrapOptions } from "./session.js";
export { Stream, type StreamEvents, type StreamState, type StreamTotals } from "./stream.js";
export type { Topology } from "./topology.js";
export { Transport, type CallOptions, type Progress, type TransportOptions } from "./transport.js";
export * as schema from "./gen/pliant/v1/pliant_pb.js";
