//! An animation before its first frame: the clip read, the rig found, the handles set on the model's graph.

use crate::batch::{AnimationOrder, ClipSource, left_out_primitives, moving_clip, prepare, warnings_of};
use crate::engine::{Animation, Deformer, Shader};
use crate::exec::Exec;
use crate::motion::MotionClip;
use crate::motion::bvh::{ClipLimits, read_bvh};
use crate::wire::{AnimateOrder, Error, OrderedClip, OrderedRoot, of_rig};
use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

/// How large an animation may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct AnimationLimits {
    /// Bytes of its clip.
    pub clip_bytes: u64,
    /// Joints of its clip.
    pub clip_joints: usize,
    /// Its frames.
    pub frames: usize,
    /// Those of them that are wanted, times the vertices of the model.
    pub vertices: u64,
}

/// An animation that a session's task has prepared.
#[derive(Debug)]
pub(in crate::session) struct ReadyAnimation {
    pub prepared: PreparedAnimation,
    /// The session's revision then.
    pub revision: u64,
    /// Milliseconds by stage.
    pub build_ms: BTreeMap<String, f64>,
}

/// An animation that is ready to be solved, whatever becomes of the session's engine.
pub struct PreparedAnimation {
    /// The animation.
    pub animation: Animation,
    /// The frames that are wanted.
    pub range: Range<usize>,
    /// What the clip is called; may be empty.
    pub clip_name: String,
    /// The clip's number in the model, where it is of the model's own skin.
    pub own_clip: Option<usize>,
    /// Primitives that go on as that clip moves them.
    pub beside: Vec<usize>,
    /// What was noticed, one line each.
    pub warnings: Vec<String>,
    /// What makes normals and tangents, when they are wanted.
    pub shader: Option<Arc<Shader>>,
}

impl std::fmt::Debug for PreparedAnimation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "PreparedAnimation(frames {:?})", self.range)
    }
}

impl PreparedAnimation {
    /// Prepares the animation of a model.
    ///
    /// # Errors
    /// What is wrong with clip, rig or range, each with its field; what is larger than `limits`.
    pub fn of_model(
        deformer: &Deformer,
        order: &AnimateOrder,
        limits: &AnimationLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        exec.progress.report("clip", 0.0);
        let source = match &order.clip {
            OrderedClip::OfModel(name) => ClipSource::OfModel(name.as_deref().unwrap_or("0")),
            OrderedClip::Recorded(bytes) => ClipSource::Recorded(recorded_clip(bytes, limits)?),
            OrderedClip::Announced(_) => return Err(Error::Internal("the clip has not come".into())),
        };
        let moving = moving_clip(deformer, source, order.rig.as_ref(), exec)?;
        let times = order.frames.times(&moving.clip);
        check_count(
            "the number of frames of the animation",
            times.count as u64,
            limits.frames as u64,
        )?;
        let Some(range) = order.frames.range(times.count) else {
            let (first, count) = (order.frames.first, times.count);
            let problem = format!("is {first}, the animation has {count} frames, counted from 0");
            return Err(Error::invalid("first", problem));
        };
        let vertices = (range.len() as u64).saturating_mul(deformer.rest().len() as u64);
        check_count("the number of frames times that of vertices", vertices, limits.vertices)?;
        let (clip_name, own_clip) = (moving.clip.name.clone(), moving.own);
        let batch = AnimationOrder {
            times,
            ranges: vec![range.clone()],
            settings: order.settings.clone(),
            blocks_at_once: 1,
            bakes_root: order.root == OrderedRoot::Baked,
        };
        let animation = prepare(deformer, moving, order.scale, &batch, exec).map_err(of_rig)?;
        let beside = match own_clip {
            Some(_) => left_out_primitives(deformer.model())?,
            None => Vec::new(),
        };
        Ok(Self {
            warnings: warnings_of(&animation),
            beside,
            own_clip,
            animation,
            range,
            clip_name,
            shader: None,
        })
    }

    /// The render vertices that are played; the others go on as the model's own clip moves them.
    pub(super) fn played_vertices(&self) -> Vec<usize> {
        let (model, rest) = self.animation.model();
        let mut is_played = vec![true; rest.len()];
        for primitive in self.beside.iter().filter_map(|p| model.primitives.get(*p)) {
            is_played[primitive.vertices()].fill(false);
        }
        (0..is_played.len()).filter(|vertex| is_played[*vertex]).collect()
    }

    /// Bytes held.
    pub(super) fn byte_size(&self) -> u64 {
        self.animation.byte_size() + self.shader.as_ref().map_or(0, |s| s.byte_size())
    }
}

fn recorded_clip(bytes: &[u8], limits: &AnimationLimits) -> Result<MotionClip, Error> {
    let limits = ClipLimits {
        bytes: limits.clip_bytes,
        joints: limits.clip_joints,
        ..Default::default()
    };
    Ok(read_bvh(bytes, &limits)?)
}

fn check_count(what: &'static str, seen: u64, limit: u64) -> Result<(), Error> {
    if seen > limit {
        return Err(Error::TooLarge { what, seen, limit });
    }
    Ok(())
}
