//! Runs a declarative job in process: opens a model, sets handles, solves and edits step by step, writes the result.

mod animate;
mod inspect;
mod riders;
mod rig;
mod run;
mod skin;

pub use animate::{
    AnimationOrder, ClipSource, MovingClip, frame_totals, moving_clip, play, prepare, unskinned_passengers,
};
pub use inspect::{MOST_NODES_TOLD, inspect};
pub use riders::CarriedFile;
pub use rig::{MadeRig, RigOrder, make_rig};
pub use run::{BatchOutcome, pose_steps, run, unmet_expectations};
pub use skin::{BoundModel, bind_model, carrying_joints};
