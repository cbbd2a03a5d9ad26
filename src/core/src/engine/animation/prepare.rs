//! An animation before its first frame: what is asked for of it, and the rig's handles on the body, with fields of their own.

use crate::asset::Model;
use crate::deform::{HandleConstraint, HandleSetup, HandleSystem, Quality};
use crate::engine::animation::held_nodes::{RigHandleFacts, hold_nodes};
use crate::engine::deformer::Deformer;
use crate::engine::derived_structures::{DerivedStructures, admit_bytes};
use crate::engine::error::Error;
use crate::engine::facts::{DeformerWarning, QualityReport};
use crate::engine::quality::{measure_quality, warn_of_large_faces};
use crate::engine::settings::Contact;
use crate::exec::Exec;
use crate::graph::MeshGraph;
use crate::mesh::BoundingBox;
use crate::motion::bvh::ClipLimits;
use crate::motion::rig::{MotionRig, RigDriver, RigHandle, rig_handles};
use crate::motion::{MotionClip, SceneMotion};
use crate::pool::Pool;
use bytes::Bytes;
use glam::DVec3;
use std::ops::Range;
use std::sync::Arc;

/// Frames of one block.
pub const BLOCK_FRAMES: usize = 64;

/// Where the clip of an animation comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum ClipSource {
    /// From the model, by name or by number.
    OfModel(String),
    /// From a BVH file; `name` is used where the file names no clip.
    Bvh {
        /// What the clip is called; may be empty.
        name: String,
        /// The file.
        bytes: Bytes,
    },
}

/// How a clip drives a model. [`super::Animation::prepare`] prepares it.
#[derive(Debug, Clone)]
pub struct ClipRequest {
    /// The clip.
    pub clip: ClipSource,
    /// The rig that it drives; `None`: for a recording the one that [`super::make_rig`] makes, for a clip of the model that of its
    /// skin.
    pub rig: Option<MotionRig>,
    /// Which frames are wanted.
    pub frames: FrameChoice,
    /// Model units for one unit of the clip, in place of the rig's.
    pub scale: Option<f64>,
    /// Whether feet stay where they stand; `None`: of a recording whose legs drive the rig.
    pub plant_feet: Option<bool>,
    /// How exactly frames are solved; see [`ANIMATION_QUALITY`].
    pub quality: Quality,
    /// Whether pairs of triangles that cross are counted in each frame.
    pub counts_crossings: bool,
    /// What frames do about surfaces that a pose pushes through each other. Frames keep no distance.
    pub contact: Contact,
}

/// How large an animation may be.
#[derive(Debug, Clone, PartialEq)]
pub struct AnimationLimits {
    /// What a recorded clip may have.
    pub clip: ClipLimits,
    /// Its frames.
    pub frames: usize,
    /// Those of them that are wanted, times the vertices of the model.
    pub vertices: u64,
}

/// How exactly frames are solved unless asked otherwise. Without [`Quality::refine`] the first frame is fitted 32 times, every other
/// one goes on from what the frame before came to, and blocks but the first go on from a frame some way before their own, which is
/// fitted 4 times. Else each frame is fitted so often, from the blend of the handles' rotations. Smoothing has no part in it.
pub const ANIMATION_QUALITY: Quality = Quality {
    tolerance: Some(1e-3),
    max_error: Some(1e-3),
    refine: None,
    smoothing: 0.0,
    keeps_volume: false,
};

/// When the frames of an animation are, in seconds of its clip.
///
/// ```
/// use pliant_core::engine::FrameTimes;
/// let times = FrameTimes { start: 0.5, rate: 30.0, count: 31 };
/// assert_eq!((times.at(0), times.at(30)), (0.5, 1.5));
/// ```
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FrameTimes {
    /// When the first is.
    pub start: f64,
    /// Frames a second.
    pub rate: f64,
    /// How many there are.
    pub count: usize,
}

impl FrameTimes {
    /// Frames at `rate` from `start` to `end`, both included when they fall on a frame, or within a thousandth of one: files
    /// round the time between frames.
    pub fn between(start: f64, end: f64, rate: f64) -> Self {
        let intervals = ((end - start).max(0.0) * rate + 1e-3).floor();
        Self {
            start,
            rate,
            count: (intervals as usize).saturating_add(1),
        }
    }

    /// When a frame is.
    pub fn at(&self, frame: usize) -> f64 {
        self.start + frame as f64 / self.rate
    }
}

/// Frames a second of clips that were not recorded in frames.
const UNRECORDED_RATE: f64 = 30.0;

/// Which frames of a clip are wanted.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameChoice {
    /// Frames a second, above 0; `None`: the clip's own, or 30 where it was not recorded in frames.
    pub fps: Option<f64>,
    /// Whether the first recorded frame, often a T-pose, is left out; `None`: where it is far from the second.
    pub skip_first: Option<bool>,
    /// The first one.
    pub first: usize,
    /// How many; `None`: all that follow.
    pub count: Option<usize>,
}

impl FrameChoice {
    /// Most frames a second.
    pub const FASTEST: f64 = 10_000.0;

    /// When all frames of a clip are.
    pub fn times(&self, clip: &MotionClip) -> FrameTimes {
        let recorded = clip.recorded.map_or(UNRECORDED_RATE, |r| 1.0 / r.interval);
        let skips = self.skip_first.unwrap_or_else(|| clip.begins_apart());
        let start = clip.recorded.filter(|_| skips).map_or(0.0, |r| r.interval);
        FrameTimes::between(start, clip.duration, self.fps.unwrap_or(recorded))
    }

    /// Which of `all` frames are wanted; `None` when there are none of them.
    pub fn range(&self, all: usize) -> Option<Range<usize>> {
        let end = self.first.saturating_add(self.count.unwrap_or(all)).min(all);
        (self.first < end).then_some(self.first..end)
    }
}

/// When a foot stands, and how far it slides meanwhile.
#[derive(Debug, Clone, PartialEq)]
pub struct FootFacts {
    /// Its bone in the rig.
    pub bone: String,
    /// From when to when it stands, in seconds of the clip.
    pub contacts: Vec<[f64; 2]>,
    /// Frames in which it stands.
    pub planted: usize,
    /// How far the point that stands moves from frame to frame, in the mean, as a fraction of the model's height: as the clip drives the
    /// bones, and with feet that are planted.
    pub drift: [f64; 2],
}

/// A clip on a model, ready to be solved frame by frame.
pub struct Animation {
    pub(super) derived: Arc<DerivedStructures>,
    pub(super) system: HandleSystem,
    pub(super) rig: MotionRig,
    pub(super) driver: RigDriver,
    pub(super) handles: Vec<RigHandle>,
    pub(super) times: FrameTimes,
    pub(super) quality: Quality,
    pub(super) counts_crossings: bool,
    pub(super) contact: Contact,
    /// Bytes that frames may hold.
    pub(super) memory_bytes: u64,
    pub(super) beside: Option<SceneMotion>,
    pub(super) range: Range<usize>,
    pub(super) clip_name: String,
    pub(super) own_clip: Option<usize>,
    /// Primitives that are not solved, where the clip is the model's own and moves them.
    pub(super) left_out: Vec<usize>,
    pub(super) feet: Vec<FootFacts>,
    facts: Vec<RigHandleFacts>,
    large_faces: Option<DeformerWarning>,
}

/// Faces that are too large for the rig's bends are warned of beyond this part of all: bones are near each other, and a few faces
/// between two of them show nowhere.
const SOME_FACES: f64 = 0.01;

impl Deformer {
    /// Prepares an animation of the rest shape. The deformer's handles, poses and history have no part in it, and may change
    /// while it is solved.
    ///
    /// # Errors
    /// [`Error::Precondition`] when bones lie in no part of the model, [`Error::TooLarge`] for more than the limits allow,
    /// [`Error::Cancelled`].
    pub fn animation(
        &self,
        rig: MotionRig,
        driver: RigDriver,
        times: FrameTimes,
        quality: &Quality,
        exec: &Exec<'_>,
    ) -> Result<Animation, Error> {
        let body = self.body();
        let handles = rig_handles(&rig);
        if handles.len() > self.limits.handles {
            return Err(Error::TooLarge {
                what: "handles of the rig",
                seen: handles.len() as u64,
                limit: self.limits.handles as u64,
            });
        }
        let field_bytes = (handles.len() as u64 + 1) * body.nodes() as u64 * 12;
        admit_bytes(self.byte_size() + field_bytes, &self.limits, exec)?;
        let (constraints, facts) = held_by_rig(&handles, &body.graph, exec)?;
        let setup = HandleSetup {
            handles: constraints,
            policy: self.options.policy,
            ..Default::default()
        };
        let system = HandleSystem::build(body, setup, exec)?;
        // Blocks that run at the same time find ready what the first one to ask would make.
        system.prepare_shares(exec.pool);
        self.derived.bind_riders(&self.limits, exec)?;
        let large_faces = warn_of_large_faces(self.mesh(), &system, body.diagonal, SOME_FACES, exec)?;
        Ok(Animation {
            derived: Arc::clone(&self.derived),
            system,
            rig,
            driver,
            handles,
            times,
            quality: *quality,
            counts_crossings: false,
            contact: Contact::Ignored,
            memory_bytes: self.limits.memory_bytes,
            beside: None,
            range: 0..times.count,
            clip_name: String::new(),
            own_clip: None,
            left_out: Vec::new(),
            feet: Vec::new(),
            facts,
            large_faces,
        })
    }

    /// Which nodes the handles of a rig hold in an animation.
    ///
    /// # Errors
    /// [`Error::Precondition`] when bones lie in no part of the model, [`Error::Cancelled`].
    pub fn nodes_of_rig(&self, rig: &MotionRig, exec: &Exec<'_>) -> Result<RigNodes, Error> {
        let graph = &self.body().graph;
        let (constraints, _) = held_by_rig(&rig_handles(rig), graph, exec)?;
        let mut found = RigNodes::default();
        for constraint in constraints {
            let kind = if constraint.position {
                &mut found.positions
            } else {
                &mut found.rotations
            };
            kind.extend(constraint.nodes.iter().map(|node| graph.positions[*node as usize]));
        }
        Ok(found)
    }
}

/// Finds what the handles of a rig hold. On a model of few vertices some find nothing that no other holds; a rig that lies elsewhere
/// finds nothing at all.
fn held_by_rig(
    handles: &[RigHandle],
    graph: &MeshGraph,
    exec: &Exec<'_>,
) -> Result<(Vec<HandleConstraint>, Vec<RigHandleFacts>), Error> {
    let (constraints, facts) = hold_nodes(handles, graph, exec)?;
    let empty = facts.iter().filter(|f| f.nodes == 0);
    if 2 * empty.clone().count() > facts.len() {
        let name = empty.map(|f| f.name.as_str()).next().unwrap_or_default();
        let problem = format!(
            "\"{name}\" of the rig holds nothing; its joints have to lie inside the model, in its rest pose and units"
        );
        return Err(Error::Precondition(problem));
    }
    Ok((constraints, facts))
}

/// The rest positions of the graph nodes that the handles of a rig hold.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct RigNodes {
    /// Those whose rotations are set, in cylinders along bones.
    pub rotations: Vec<DVec3>,
    /// Those whose positions are set, in spheres at joints.
    pub positions: Vec<DVec3>,
}

impl Animation {
    /// What an error calls the number of frames.
    pub const FRAMES: &'static str = "the number of frames of the animation";

    /// The frames that are wanted.
    pub fn range(&self) -> &Range<usize> {
        &self.range
    }

    /// What the clip is called; may be empty.
    pub fn clip_name(&self) -> &str {
        &self.clip_name
    }

    /// The clip's number in the model, where it is of the model's own skin.
    pub fn own_clip(&self) -> Option<usize> {
        self.own_clip
    }

    /// The warnings before the first frame, one line each.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = self.driver.warnings().to_vec();
        let empty = self.facts.iter().filter(|h| h.nodes == 0);
        let empty: Vec<String> = empty.map(|h| format!("\"{}\"", h.name)).collect();
        if !empty.is_empty() {
            warnings.push(format!(
                "{} of the rig hold nothing, because others hold all there is near them",
                empty.join(", ")
            ));
        }
        warnings.extend(self.large_faces().map(|w| format!("{}: {}", w.code, w.message)));
        let bounds = BoundingBox::of(self.model().1);
        if bounds.is_far() {
            let far = bounds.min.abs().max(bounds.max.abs()).max_element();
            let off = far * f64::from(f32::EPSILON) / 2.0;
            warnings.push(format!(
                "places-rounded: files of frames have numbers of seven digits: at coordinates of {far:.3e} places are up to {off:.1e} off; move \
                 the model to the origin before, and the files back"
            ));
        }
        warnings
    }

    /// The render vertices that are played; the model's own clip moves the others.
    pub fn played_vertices(&self) -> Vec<usize> {
        let (model, rest) = self.model();
        let mut is_played = vec![true; rest.len()];
        for primitive in self.left_out.iter().filter_map(|p| model.primitives.get(*p)) {
            is_played[primitive.vertices()].fill(false);
        }
        (0..is_played.len()).filter(|vertex| is_played[*vertex]).collect()
    }

    /// The rig that moves.
    pub fn moving_rig(&self) -> &MotionRig {
        &self.rig
    }

    /// Keeps surfaces from crossing in frames, or lets them.
    pub fn set_contact(&mut self, contact: Contact) {
        self.contact = contact;
    }

    /// What each handle of the rig came to hold.
    pub fn handle_facts(&self) -> &[RigHandleFacts] {
        &self.facts
    }

    /// What the feet do that are kept where they stand, in the frames that are wanted.
    pub fn feet(&self) -> &[FootFacts] {
        &self.feet
    }

    /// The warning that faces are too large to show the bends between the handles of the rig, if any are.
    pub fn large_faces(&self) -> Option<&DeformerWarning> {
        self.large_faces.as_ref()
    }

    /// How far a frame's positions, one per render vertex, are from the rest shape.
    pub fn quality(&self, positions: &[DVec3], pool: &Pool) -> QualityReport {
        let derived = &self.derived;
        let deformed = derived.mesh.welded(positions);
        measure_quality(&derived.mesh, derived.report().closed, &deformed, pool)
    }

    /// Length of the diagonal of the model's bounding box.
    pub fn diagonal(&self) -> f64 {
        self.derived.body.diagonal
    }

    /// The model, and its rest positions, one per render vertex.
    pub fn model(&self) -> (&Arc<Model>, &Arc<Vec<DVec3>>) {
        let topology = self.derived.topology();
        (&topology.model, &topology.rest)
    }

    /// Whether edits have made another topology of the model as it was read.
    pub fn is_edited(&self) -> bool {
        self.derived.topology().edited.is_some()
    }

    /// Bytes held, without what it shares with the deformer.
    pub fn byte_size(&self) -> u64 {
        self.system.byte_size() as u64
    }

    /// When its frames are.
    pub fn times(&self) -> &FrameTimes {
        &self.times
    }

    /// What drives it.
    pub fn driver(&self) -> &RigDriver {
        &self.driver
    }
}
