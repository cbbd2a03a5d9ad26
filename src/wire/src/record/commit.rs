//! Commits as a store keeps them.

use super::messages::{
    AvoidedContactMessage, CommitKindMessage, CommitMessage, CreationMessage, EditMessage, FileReferences,
    FrameMessage, HandlesMessage, PoseMessage, SettingsMessage, ShapeProbe, StartMessage, StepMessage,
};
use crate::frames::{FrameEncoding, FrameOutput};
use crate::{Error, SessionEdit, handle_pose, handle_pose_message, handle_set, handle_set_message, pb, session_edit};
use glam::DVec3;
use pliant_core::engine::{
    Contact, DefaultPivot, HandlePose, HandlePoses, HandleSet, Method, PoseChain, PoseRecipe, Quality, Recipe,
    SolveSettings,
};
use pliant_deform::FitOrder;
use prost::Message as _;

/// Places of a shape that are kept to compare it with.
const PROBES: usize = 32;

impl FileReferences {
    /// Every object that is named.
    pub fn objects(&self) -> impl Iterator<Item = &String> {
        std::iter::once(&self.main).chain(self.companions.values())
    }
}

impl ShapeProbe {
    /// The probe of a shape.
    pub fn of(positions: &[DVec3]) -> Self {
        let last = positions.len().saturating_sub(1);
        let chosen = PROBES.min(positions.len());
        let index = |k: usize| if chosen > 1 { k * last / (chosen - 1) } else { 0 };
        Self {
            vertices: positions.len() as u64,
            places: (0..chosen).flat_map(|k| positions[index(k)].to_array()).collect(),
        }
    }

    /// Whether a shape is this one but for `distance` at most.
    pub fn is_close_to(&self, positions: &[DVec3], distance: f64) -> bool {
        let other = Self::of(positions);
        let places = |probe: &Self| -> Vec<DVec3> { probe.places.chunks_exact(3).map(DVec3::from_slice).collect() };
        let (own, others) = (places(self), places(&other));
        let mut pairs = own.iter().zip(&others);
        self.vertices == other.vertices && own.len() == others.len() && pairs.all(|(a, b)| a.distance(*b) <= distance)
    }
}

/// The frame that answered a pose, but for its vertices.
#[derive(Debug, Clone, PartialEq)]
pub struct AnsweredFrame {
    /// Its header; the revision is that of the commit.
    pub header: pb::Frame,
    /// What it carried.
    pub output: FrameOutput,
}

/// A commit as it is kept.
#[derive(Debug, Clone)]
pub enum LoggedCommit {
    /// The session was opened.
    Create {
        /// The deformer's facts.
        facts: Box<pb::Session>,
    },
    /// Handles were set.
    Handles {
        /// The handles.
        set: HandleSet,
        /// The poses that they came with.
        poses: HandlePoses,
        /// The deformer's facts then.
        facts: Box<pb::Session>,
    },
    /// A pose was solved.
    Pose {
        /// The poses of all handles, how they were solved, and what from.
        chain: PoseChain,
        /// What was noticed.
        warnings: Vec<pb::Warning>,
        /// The rotations that were found.
        found_turns: Vec<pb::FoundTurn>,
        /// The shape.
        probe: ShapeProbe,
        /// The frame that was answered, for a call with an idempotency key.
        frame: Option<Box<AnsweredFrame>>,
    },
    /// The model was edited.
    Edit {
        /// What was done. The files of a merge are empty once it was read from a record.
        edit: Box<SessionEdit>,
        /// Where the files of a merge are.
        files: Option<FileReferences>,
        /// What it did.
        report: Box<pb::EditResult>,
        /// The poses after it.
        poses: HandlePoses,
        /// The deformer's facts after it.
        facts: Box<pb::Session>,
        /// The shape after it.
        probe: ShapeProbe,
    },
    /// Undo or redo.
    Step {
        /// The revision of the commit that it went to.
        target: u64,
        /// Whether it was redo.
        forward: bool,
    },
}

/// A step to no commit.
impl Default for LoggedCommit {
    fn default() -> Self {
        Self::Step {
            target: 0,
            forward: false,
        }
    }
}

impl LoggedCommit {
    /// Its kind as databases and people name it.
    pub fn kind(&self) -> &'static str {
        match self {
            Self::Create { .. } => "create",
            Self::Handles { .. } => "handles",
            Self::Pose { .. } => "pose",
            Self::Edit { .. } => "edit",
            Self::Step { forward: false, .. } => "undo",
            Self::Step { forward: true, .. } => "redo",
        }
    }

    /// Writes the record.
    pub fn write(&self) -> Vec<u8> {
        let kind = match self {
            Self::Create { facts } => CommitKindMessage::Create(CreationMessage {
                facts: Some((**facts).clone()),
            }),
            Self::Handles { set, poses, facts } => CommitKindMessage::Handles(HandlesMessage {
                set: Some(handle_set_message(set)),
                poses: pose_messages(poses),
                facts: Some((**facts).clone()),
                about_joints: set.default_pivot == DefaultPivot::Joint,
            }),
            Self::Pose {
                chain: PoseChain { starts, pose },
                warnings,
                found_turns,
                probe,
                frame,
            } => CommitKindMessage::Pose(PoseMessage {
                poses: pose_messages(&pose.poses),
                settings: Some(settings_message(&pose.settings)),
                starts: starts.iter().map(start_message).collect(),
                warnings: warnings.clone(),
                probe: Some(probe.clone()),
                frame: frame.as_deref().map(frame_message),
                found_turns: found_turns.clone(),
            }),
            Self::Edit {
                edit,
                files,
                report,
                poses,
                facts,
                probe,
            } => CommitKindMessage::Edit(EditMessage {
                request: Some(edit.request.clone()),
                files: files.clone(),
                from_session: edit.edit.other_model().is_some_and(|other| other.from_session),
                report: Some((**report).clone()),
                poses: pose_messages(poses),
                facts: Some((**facts).clone()),
                probe: Some(probe.clone()),
            }),
            &Self::Step { target, forward } => CommitKindMessage::Step(StepMessage { target, forward }),
        };
        CommitMessage { kind: Some(kind) }.encode_to_vec()
    }

    /// Reads a record.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(bytes: &[u8]) -> Result<Self, Error> {
        let message = CommitMessage::decode(bytes).map_err(|e| Error::invalid("commit", e.to_string()))?;
        Ok(match message.kind.ok_or_else(|| missing("commit"))? {
            CommitKindMessage::Create(created) => Self::Create {
                facts: recorded(created.facts, "facts")?,
            },
            CommitKindMessage::Handles(handles) => Self::Handles {
                set: HandleSet {
                    default_pivot: match handles.about_joints {
                        true => DefaultPivot::Joint,
                        false => DefaultPivot::Middle,
                    },
                    ..handle_set(&handles.set.ok_or_else(|| missing("handles"))?)?
                },
                poses: recorded_poses(&handles.poses)?,
                facts: recorded(handles.facts, "facts")?,
            },
            CommitKindMessage::Pose(pose) => Self::Pose {
                chain: PoseChain {
                    starts: (pose.starts.iter())
                        .map(|start| recorded_pose(&start.poses, start.settings.as_ref()))
                        .collect::<Result<_, _>>()?,
                    pose: recorded_pose(&pose.poses, pose.settings.as_ref())?,
                },
                warnings: pose.warnings,
                probe: pose.probe.unwrap_or_default(),
                frame: (pose.frame)
                    .map(|f| recorded_frame(&f, &pose.found_turns).map(Box::new))
                    .transpose()?,
                found_turns: pose.found_turns,
            },
            CommitKindMessage::Edit(message) => {
                let request = message.request.ok_or_else(|| missing("edit"))?;
                let mut edit = session_edit(&request)?;
                edit.other_session = None;
                if let Some(other) = edit.edit.other_model_mut() {
                    other.from_session = message.from_session;
                }
                Self::Edit {
                    edit: Box::new(edit),
                    files: message.files,
                    report: recorded(message.report, "report")?,
                    poses: recorded_poses(&message.poses)?,
                    facts: recorded(message.facts, "facts")?,
                    probe: message.probe.unwrap_or_default(),
                }
            }
            CommitKindMessage::Step(StepMessage { target, forward }) => Self::Step { target, forward },
        })
    }
}

/// A part of a record that every record of its kind has.
fn recorded<M>(part: Option<M>, field: &str) -> Result<Box<M>, Error> {
    part.map(Box::new).ok_or_else(|| missing(field))
}

fn missing(field: &str) -> Error {
    Error::invalid(field, "is missing")
}

fn pose_messages(poses: &HandlePoses) -> Vec<pb::HandlePose> {
    poses.0.iter().map(handle_pose_message).collect()
}

fn recorded_poses(messages: &[pb::HandlePose]) -> Result<HandlePoses, Error> {
    let read = |(k, pose)| handle_pose(pose, &format!("poses[{k}]"));
    let poses: Result<Vec<HandlePose>, _> = messages.iter().enumerate().map(read).collect();
    Ok(HandlePoses(poses?.into()))
}

fn start_message(start: &PoseRecipe) -> StartMessage {
    StartMessage {
        poses: pose_messages(&start.poses),
        settings: Some(settings_message(&start.settings)),
    }
}

fn recorded_pose(poses: &[pb::HandlePose], settings: Option<&SettingsMessage>) -> Result<PoseRecipe, Error> {
    Ok(PoseRecipe {
        poses: recorded_poses(poses)?,
        settings: recorded_settings(settings.ok_or_else(|| missing("settings"))?)?,
    })
}

fn settings_message(settings: &SolveSettings) -> SettingsMessage {
    let SolveSettings {
        quality,
        method,
        fits,
        recipe,
        // A shape is the same with and without them.
        gradients: _,
        contact,
    } = settings;
    SettingsMessage {
        tolerance: quality.tolerance,
        max_error: quality.max_error,
        refine: quality.refine,
        rotation_smoothing: quality.smoothing,
        first_pass: match method {
            Method::Harmonic | Method::SpatialRbf => pb::options::FirstPass::Harmonic,
            Method::Diffusion => pb::options::FirstPass::Diffusion,
            Method::LinearFrames => pb::options::FirstPass::LinearFrames,
        }
        .into(),
        spatial_rbf: *method == Method::SpatialRbf,
        coarse_first: *fits == FitOrder::CoarseFirst,
        recipe: *recipe as u32,
        keeps_volume: quality.keeps_volume,
        contact: match *contact {
            Contact::Ignored => None,
            Contact::Avoided { clearance } => Some(AvoidedContactMessage { clearance }),
        },
    }
}

fn recorded_settings(message: &SettingsMessage) -> Result<SolveSettings, Error> {
    let method = pb::options::Method::SpatialRbf;
    // The checks of a request hold for what is kept of it.
    let asked = pb::Options {
        tolerance: message.tolerance.unwrap_or(0.0),
        max_error: message.max_error.unwrap_or(0.0),
        refine: message.refine,
        rotation_smoothing: message.rotation_smoothing,
        first_pass: message.first_pass,
        method: if message.spatial_rbf { method.into() } else { 0 },
        contact: message.contact.map_or(0, |_| pb::options::Contact::Avoid.into()),
        clearance: message.contact.and_then(|contact| contact.clearance).unwrap_or(0.0),
        ..Default::default()
    };
    let checked = crate::DeformOptions::check(&asked, "settings", 64)?;
    let recipe = Recipe::ALL.get(message.recipe as usize).copied();
    Ok(SolveSettings {
        quality: Quality {
            tolerance: message.tolerance,
            max_error: message.max_error,
            keeps_volume: message.keeps_volume,
            ..checked.solve.quality
        },
        method: checked.solve.method,
        contact: checked.solve.contact,
        fits: match message.coarse_first {
            true => FitOrder::CoarseFirst,
            false => FitOrder::GraphAlone,
        },
        recipe: recipe.ok_or_else(|| {
            let known = Recipe::ALL.len();
            Error::invalid(
                "settings.recipe",
                format!("is {}, known are 0 to {}", message.recipe, known - 1),
            )
        })?,
        gradients: false,
    })
}

fn frame_message(frame: &AnsweredFrame) -> FrameMessage {
    let (header, output) = (&frame.header, &frame.output);
    FrameMessage {
        seq: header.seq,
        residual: header.residual,
        max_error: header.max_error,
        solve_ms: header.solve_ms,
        queue_ms: header.queue_ms,
        quality: header.quality,
        output: Some(pb::Output {
            normals: output.normals,
            tangents: output.tangents,
            changed_only: output.changed_only,
            encoding: output.encoding.to_message().into(),
            self_intersections: output.self_intersections,
            gradients: output.gradients,
        }),
    }
}

fn recorded_frame(message: &FrameMessage, found_turns: &[pb::FoundTurn]) -> Result<AnsweredFrame, Error> {
    let output = message.output.unwrap_or_default();
    let encoding = pb::frame::Encoding::try_from(output.encoding)
        .map_err(|_| Error::invalid("frame.output.encoding", "is not an encoding"))?;
    Ok(AnsweredFrame {
        header: pb::Frame {
            seq: message.seq,
            r#final: true,
            residual: message.residual,
            max_error: message.max_error,
            solve_ms: message.solve_ms,
            queue_ms: message.queue_ms,
            found_turns: found_turns.to_vec(),
            quality: message.quality,
            ..Default::default()
        },
        output: FrameOutput {
            normals: output.normals,
            tangents: output.tangents,
            changed_only: output.changed_only,
            encoding: FrameEncoding::from_message(encoding),
            self_intersections: output.self_intersections,
            gradients: output.gradients,
            asked: 0,
        },
    })
}

#[cfg(test)]
#[path = "commit_tests.rs"]
mod tests;
