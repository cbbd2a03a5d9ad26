//! Runs a declarative job in process: opens a model, sets handles, solves and edits step by step, writes the result.

mod animate;
mod contents;
mod inspect;
mod kept_frames;
mod key_frames;
mod left_out;
mod morph_frames;
mod riders;
mod rig;
mod rig_frames;
mod run;
mod skin;
mod skin_frames;

pub use animate::{AnimationOrder, ClipSource, MovingClip, frame_totals, moving_clip, play, prepare, warnings_of};
pub use contents::{ClipContents, ModelContents, SkinContents, contents_of};
pub use inspect::{MOST_NODES_TOLD, inspect, inspect_contents};
pub use kept_frames::{KeptFrames, PlayedModel, WrittenOff, node_place};
pub use left_out::{left_out_passengers, left_out_primitives};
pub use morph_frames::write_morph_frames;
pub use riders::CarriedFile;
pub use rig::{MadeRig, RigOrder, left_out_of_rig, make_rig};
pub use rig_frames::{DrivenFrames, write_corrected_frames, write_rig_frames};
pub use run::{BatchOutcome, BatchOutput, StepTaker, pose_steps, run, run_and_write, unmet_expectations};
pub use skin::{BoundModel, bind_model, carrying_joints, influences_of_skin};
pub use skin_frames::write_skin_frames;
