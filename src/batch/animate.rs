//! Animations run in process: a model, a rig and a clip to frames and their report.

use super::left_out::left_out_warnings;
use super::rig::{MadeRig, RigOrder, make_rig};
use crate::asset::{Model, MovingScene};
use crate::engine::{
    self, AnimatedFrame, Animation, AnimationSettings, Deformer, FrameSums, FrameTimes, QualityReport, digest,
};
use crate::exec::Exec;
use crate::mesh::BoundingBox;
use crate::motion::rig::{DriveOptions, MotionRig, RestAttitude, RigBone, RigDriver, RigidMotion, rig_of_skin};
use crate::motion::{MotionClip, NodeOrder, SceneMotion, clip_of_scene};
use crate::wire::{Error, animation_totals, held_nodes_message, pb};
use glam::DVec3;
use std::ops::Range;

/// How far from the origin a clip may take a bone: 32-bit floats end at 3.4e38.
const FARTHEST_FRAME: f64 = 1e37;

/// Where a clip comes from.
pub enum ClipSource<'a> {
    /// From a recording, for a rig.
    Recorded(MotionClip),
    /// From the model itself, by name or by number.
    OfModel(&'a str),
}

/// A clip on a rig.
pub struct MovingClip {
    /// The rig.
    pub rig: MotionRig,
    /// The clip.
    pub clip: MotionClip,
    /// The clip's number in the model, where its joints are those of the model's skin.
    pub own: Option<usize>,
    /// What it moves beside that skin.
    beside: Option<SceneMotion>,
    /// Its warnings, one line each.
    warnings: Vec<String>,
}

/// Which frames of an animation are wanted, and how.
pub struct AnimationOrder {
    /// When the frames are.
    pub times: FrameTimes,
    /// Which of them are wanted.
    pub ranges: Vec<Range<usize>>,
    /// How they are solved.
    pub settings: AnimationSettings,
    /// Blocks that are solved at the same time.
    pub blocks_at_once: usize,
    /// Whether the root's motion goes into the positions.
    pub bakes_root: bool,
}

impl AnimationOrder {
    /// The frames that are wanted.
    fn frames(&self) -> impl Iterator<Item = usize> {
        self.ranges.iter().cloned().flatten()
    }
}

/// Finds a clip for a model, and the rig that it drives: the one given; else for a recording the one that [`make_rig`] makes, and
/// for a clip of the model the skin's.
///
/// # Errors
/// [`Error::Invalid`] for a clip that is not there (with those that are), or a model that no rig can be found for.
pub fn moving_clip(
    deformer: &Deformer,
    source: ClipSource<'_>,
    rig: Option<&MotionRig>,
    exec: &Exec<'_>,
) -> Result<MovingClip, Error> {
    let is_own_clip = matches!(source, ClipSource::OfModel(_)) && rig.is_none();
    let mut warnings = left_out_warnings(deformer.model(), &deformer.geometry().primitives, is_own_clip)?;
    let name = match source {
        ClipSource::Recorded(clip) => {
            let rig = match rig {
                Some(rig) => rig.clone(),
                None => {
                    let made = rig_for_clip(deformer.model(), &clip, exec)?;
                    warnings.extend(made.warnings);
                    made.rig
                }
            };
            return Ok(MovingClip {
                rig,
                clip,
                own: None,
                beside: None,
                warnings,
            });
        }
        ClipSource::OfModel(name) => name,
    };
    if deformer.is_edited() {
        let problem =
            "edits have changed the model since it was read; its own clips move vertices that it no longer has";
        return Err(Error::Precondition(problem.into()));
    }
    let model = deformer.model();
    let Some(scene) = model.moving_scene()? else {
        let problem = format!(
            "the {} has no clips of its own; give a recording and a rig",
            model.format
        );
        return Err(Error::invalid("clip", problem));
    };
    let names = &scene.clip_names;
    let by_number = || name.parse::<usize>().ok().filter(|k| *k < names.len());
    let Some(index) = names.iter().position(|n| n == name).or_else(by_number) else {
        let listed: Vec<String> = names
            .iter()
            .take(8)
            .enumerate()
            .map(|(k, n)| format!("{k} \"{n}\""))
            .collect();
        let there = if listed.is_empty() {
            "none".into()
        } else {
            listed.join(", ")
        };
        let problem = format!("\"{name}\" is not a clip of the model; there are {there}");
        return Err(Error::invalid("clip", problem));
    };
    let stored = model.scene_clip(index)?;
    let order = NodeOrder::of(&scene);
    let clip = clip_of_scene(&scene, &order, stored.as_ref());
    if let Some(rig) = rig {
        return Ok(MovingClip {
            rig: rig.clone(),
            clip,
            own: None,
            beside: None,
            warnings,
        });
    }
    let rig = rig_of_skin(&scene, &order, &clip, deformer.rest()).map_err(|e| {
        let told = skin_problem(model).or_else(|| no_skin_problem(&scene, index));
        told.unwrap_or(e.into())
    })?;
    let shapes = model.primitive_shapes()?.unwrap_or_default();
    let beside = SceneMotion::of(&scene, &order, &stored.unwrap_or_default(), &clip, shapes);
    Ok(MovingClip {
        rig,
        clip,
        own: Some(index),
        beside,
        warnings,
    })
}

/// Why a clip that moves nodes or morph targets alone cannot be solved, where nothing of the model has a skin.
fn no_skin_problem(scene: &MovingScene, index: usize) -> Option<Error> {
    let has_skin = scene.is_joint.contains(&true) || scene.primitives.iter().any(|p| p.has_skin);
    let name = scene.clip_names.get(index).map_or("", String::as_str);
    let problem = format!(
        "the model has no skin, and clip {index} \"{name}\" moves nodes or morph targets alone, which plays as it is and leaves \
         nothing to solve; give a rig whose joints are nodes that it moves, and the whole model is solved for that, or a recording \
         with a rig"
    );
    (!has_skin).then(|| Error::invalid("rig", problem))
}

/// Why a model's skin says nothing, where it has one that cannot be read.
fn skin_problem(model: &Model) -> Option<Error> {
    let mut skins = model.warnings.iter().filter(|(code, _, _)| code == "skin-not-applied");
    let (_, message, place) = skins.next()?;
    Some(Error::invalid(
        "rig",
        format!("{place}: {message}; without it, give a rig"),
    ))
}

/// The rig that `pliant rig` makes of a model for a recorded clip, where none is given.
fn rig_for_clip(model: &Model, clip: &MotionClip, exec: &Exec<'_>) -> Result<MadeRig, Error> {
    exec.progress.report("rig", 0.0);
    let order = RigOrder {
        clip: Some(clip),
        ..Default::default()
    };
    make_rig(model, &order, exec).map_err(|error| match error {
        Error::Invalid { field, problem } => Error::invalid(
            "rig",
            format!("is missing, and pliant rig finds none: {field}: {problem}"),
        ),
        other => other,
    })
}

/// Prepares the animation of a model by a clip. `scale`: model units for one unit of the clip, in place of the rig's.
///
/// # Errors
/// Those of [`RigDriver::new`] and [`Deformer::animation`].
pub fn prepare(
    deformer: &Deformer,
    moving: MovingClip,
    scale: Option<f64>,
    order: &AnimationOrder,
    exec: &Exec<'_>,
) -> Result<Animation, Error> {
    let MovingClip {
        rig,
        clip,
        own,
        beside,
        warnings,
    } = moving;
    let start = order.times.start;
    let mut driver = match own.is_some() {
        true => RigDriver::of_skin(&rig, clip, start)?,
        false => {
            let options = DriveOptions {
                scale,
                reference: None,
                start,
            };
            RigDriver::new(&rig, clip, &options)?
        }
    };
    check_reach(&rig, &driver, order)?;
    warnings.into_iter().for_each(|warning| driver.warn(warning));
    if own.is_none() {
        warn_of_misfits(&rig, deformer.rest(), &mut driver);
    }
    driver.warn_of_twists(&rig, order.frames().map(|frame| (frame, order.times.at(frame))));
    let prepared = deformer.animation(rig, driver, order.times, &order.settings, exec);
    let animation = prepared.map_err(|e| match e {
        engine::Error::Precondition(problem) => Error::invalid("rig", problem),
        e => e.into(),
    })?;
    Ok(animation.with_beside(beside))
}

/// Checks that no frame takes a bone farther than 32-bit floats reach, in which positions are written.
fn check_reach(rig: &MotionRig, driver: &RigDriver, order: &AnimationOrder) -> Result<(), Error> {
    let is_near = |motion: &RigidMotion| motion.to.abs().cmple(DVec3::splat(FARTHEST_FRAME)).all();
    for frame in order.frames() {
        let pose = driver.pose_at(order.times.at(frame));
        let motions = pose.bones.iter().zip(&rig.bones);
        let far = motions.chain([(&pose.root, &rig.bones[0])]).find(|(m, _)| !is_near(m));
        if let Some((_, bone)) = far {
            let problem = format!(
                "takes bone \"{}\" farther than {FARTHEST_FRAME:e} from the origin in frame {frame}",
                bone.id
            );
            return Err(Error::invalid("clip", problem));
        }
    }
    Ok(())
}

/// Warns of bones of a given rig that do not fit the model: those outside of its box, as in a rig of another model, and
/// those without length.
fn warn_of_misfits(rig: &MotionRig, rest: &[DVec3], driver: &mut RigDriver) {
    let space = BoundingBox::of(rest);
    let is_outside = |bone: &&RigBone| {
        let reach = DVec3::splat(bone.radius);
        let misses = |p: DVec3| (p + reach).cmplt(space.min).any() || (p - reach).cmpgt(space.max).any();
        misses(bone.from) && misses(bone.to)
    };
    let listed = |bones: Vec<&RigBone>| {
        let names: Vec<String> = bones.iter().take(8).map(|b| format!("\"{}\"", b.id)).collect();
        let more = bones.len() - names.len();
        let rest = if more > 0 {
            format!(" and {more} more")
        } else {
            String::new()
        };
        format!("{}{rest}", names.join(", "))
    };
    let outside: Vec<&RigBone> = rig.bones.iter().filter(is_outside).collect();
    if !outside.is_empty() {
        driver.warn(format!(
            "bones of the rig lie outside of the model and hold what is nearest to them: {}; is the rig of another model, or in \
             other units?",
            listed(outside)
        ));
    }
    let points: Vec<&RigBone> = rig
        .bones
        .iter()
        .filter(|b| b.from == b.to && b.rest != RestAttitude::Direction)
        .collect();
    if !points.is_empty() {
        driver.warn(format!(
            "bones of the rig have no length, so that nothing is held along them: {}",
            listed(points)
        ));
    }
}

/// Solves the frames of an order. Passes each frame with its report to `take` once it is solved, in any order. Returns
/// the report of all. `millis` is a clock.
///
/// # Errors
/// Those of [`Animation::solve`] and of `take`.
pub fn play<E: From<Error>>(
    animation: &Animation,
    order: &AnimationOrder,
    exec: &Exec<'_>,
    millis: &(dyn Fn() -> f64 + Sync),
    take: &mut dyn FnMut(&AnimatedFrame, &pb::animation_report::FrameReport) -> Result<(), E>,
) -> Result<pb::AnimationReport, E> {
    let mut report = pb::AnimationReport {
        warnings: warnings_of(animation),
        scale: animation.driver().scale(),
        handles: held_nodes_message(animation.handle_facts()),
        ..Default::default()
    };
    let begun = millis();
    let mut refused = None;
    let mut take_solved = |mut frame: AnimatedFrame, ms: f64| {
        let told = frame_report(&frame, ms);
        if order.bakes_root {
            frame.bake_root();
        }
        refused = take(&frame, &told).err();
        report.frames.push(told);
        refused.is_none()
    };
    let solved = animation.solve(&order.ranges, order.blocks_at_once, millis, exec, &mut take_solved);
    if let Some(refused) = refused {
        return Err(refused);
    }
    solved.map_err(Error::from)?;
    report.frames.sort_by_key(|frame| frame.index);
    report.totals = Some(frame_totals(&report.frames, millis() - begun));
    Ok(report)
}

/// The warnings of an animation before its first frame, one line each.
pub fn warnings_of(animation: &Animation) -> Vec<String> {
    let mut warnings = animation.driver().warnings().to_vec();
    let empty = animation.handle_facts().iter().filter(|h| h.nodes == 0);
    let empty: Vec<String> = empty.map(|h| format!("\"{}\"", h.name)).collect();
    if !empty.is_empty() {
        warnings.push(format!(
            "{} of the rig hold nothing, because others hold all there is near them",
            empty.join(", ")
        ));
    }
    warnings.extend(animation.large_faces().map(|w| format!("{}: {}", w.code, w.message)));
    warnings
}

fn frame_report(frame: &AnimatedFrame, ms: f64) -> pb::animation_report::FrameReport {
    let quality = &frame.quality;
    pb::animation_report::FrameReport {
        index: u32::try_from(frame.index).unwrap_or(u32::MAX),
        time: frame.seconds,
        ms,
        cycles: u32::try_from(frame.cycles).unwrap_or(u32::MAX),
        volume_change: quality.volume_change,
        flipped_triangles: quality.flipped_triangles,
        max_stretch: quality.max_stretch,
        edge_rms: quality.edge_rms,
        digest: digest(&frame.positions),
        root_translation: (frame.root.to - frame.root.from).to_array().to_vec(),
        root_rotation: frame.root.rotation.to_array().to_vec(),
    }
}

/// Sums over frames that took so many milliseconds together.
pub fn frame_totals(frames: &[pb::animation_report::FrameReport], ms: f64) -> pb::animation_report::Totals {
    let mut sums = FrameSums::default();
    for frame in frames {
        sums.add(&QualityReport {
            volume_change: frame.volume_change,
            flipped_triangles: frame.flipped_triangles,
            max_stretch: frame.max_stretch,
            edge_rms: frame.edge_rms,
            ..Default::default()
        });
    }
    animation_totals(&sums, ms)
}
