//! From a request for a clip to an animation of a model: the clip and its rig, which frames are wanted, and what drives them.

use crate::asset::{Model, MovingScene};
use crate::engine::animation::made_rig::{MadeRig, RigOrder, left_out_primitives, left_out_warnings};
use crate::engine::animation::prepare::{Animation, AnimationLimits, ClipRequest, ClipSource, FootFacts, FrameTimes};
use crate::engine::deformer::Deformer;
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::BoundingBox;
use crate::motion::bvh::read_bvh;
use crate::motion::rig::{
    DriveOptions, MotionRig, RestAttitude, RigBone, RigDriver, RigError, RigidMotion, rig_of_skin,
};
use crate::motion::{MotionClip, NodeOrder, SceneMotion, clip_of_scene};
use glam::DVec3;
use std::ops::Range;

/// How far from the origin a clip may take a bone: 32-bit floats end at 3.4e38.
const FARTHEST_FRAME: f64 = 1e37;

/// A clip on a rig.
struct MovingClip {
    rig: MotionRig,
    clip: MotionClip,
    /// The clip's number in the model, where its joints are those of the model's skin.
    own: Option<usize>,
    /// What it moves beside that skin.
    beside: Option<SceneMotion>,
    /// Its warnings, one line each.
    warnings: Vec<String>,
}

impl Animation {
    /// Prepares the animation of a model's rest shape by a clip.
    ///
    /// # Errors
    /// [`Error::Clip`] and [`Error::Invalid`] for a clip or a rig that cannot be used, [`Error::NoSuchFrames`], [`Error::TooLarge`] for
    /// more than `limits` allow, and those of [`Deformer::animation`].
    pub fn prepare(
        deformer: &Deformer,
        request: &ClipRequest,
        limits: &AnimationLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        exec.progress.report("clip", 0.0);
        let moving = moving_clip(deformer, request, limits, exec)?;
        let times = request.frames.times(&moving.clip);
        check_count(Self::FRAMES, times.count as u64, limits.frames as u64)?;
        let range = request.frames.range(times.count).ok_or(Error::NoSuchFrames {
            first: request.frames.first,
            frames: times.count,
        })?;
        let vertices = (range.len() as u64).saturating_mul(deformer.rest().len() as u64);
        check_count("the number of frames times that of vertices", vertices, limits.vertices)?;
        let driver = moving.driver(deformer, request, &times, &range)?;
        let prepared = deformer.animation(moving.rig, driver, times, &request.quality, exec);
        let mut animation = prepared.map_err(|e| match e {
            Error::Precondition(problem) => RigError::field("rig", problem).into(),
            e => e,
        })?;
        if let ClipSource::Bvh { name, .. } = &request.clip {
            animation.clip_name.clone_from(name);
        }
        if !animation.driver.clip().name.is_empty() {
            animation.clip_name.clone_from(&animation.driver.clip().name);
        }
        animation.feet = feet_of(&animation, &range, &deformer.body_vertices()?);
        animation.range = range;
        animation.counts_crossings = request.counts_crossings;
        animation.contact = request.contact;
        animation.beside = moving.beside;
        animation.own_clip = moving.own;
        if moving.own.is_some() {
            animation.left_out = left_out_primitives(deformer.model())?;
        }
        Ok(animation)
    }
}

fn check_count(what: &'static str, seen: u64, limit: u64) -> Result<(), Error> {
    if seen > limit {
        return Err(Error::TooLarge { what, seen, limit });
    }
    Ok(())
}

impl MovingClip {
    /// What drives the rig, with the warnings about both.
    fn driver(
        &self,
        deformer: &Deformer,
        request: &ClipRequest,
        times: &FrameTimes,
        range: &Range<usize>,
    ) -> Result<RigDriver, Error> {
        let Self { rig, clip, own, .. } = self;
        let start = times.start;
        let mut driver = match own {
            Some(_) => RigDriver::of_skin(rig, clip.clone(), start)?,
            None => {
                let options = DriveOptions {
                    scale: request.scale,
                    reference: None,
                    start,
                };
                RigDriver::new(rig, clip.clone(), &options)?
            }
        };
        let is_recording = matches!(request.clip, ClipSource::Bvh { .. });
        if request.plant_feet.unwrap_or(is_recording) {
            let has_feet = driver.plant_feet(rig, &deformer.body_vertices()?, start);
            if !has_feet && request.plant_feet == Some(true) {
                let problem = match own {
                    Some(_) => "is true, but the clip is that of the model's own skin, which plays as it is",
                    None => {
                        "is true, but no legs of the clip drive bones of the rig: a thigh, and a shin that hangs on it"
                    }
                };
                return Err(RigError::field("plantFeet", problem).into());
            }
        }
        driver.follow_turns(start);
        check_reach(rig, &driver, times, range)?;
        self.warnings.iter().for_each(|warning| driver.warn(warning.clone()));
        if own.is_none() {
            warn_of_misfits(rig, deformer.rest(), &mut driver);
        }
        driver.warn_of_twists(rig, range.clone().map(|frame| (frame, times.at(frame))));
        Ok(driver)
    }
}

/// What planted feet do in a range of frames.
fn feet_of(animation: &Animation, range: &Range<usize>, rest: &[DVec3]) -> Vec<FootFacts> {
    let times: Vec<f64> = range.clone().map(|frame| animation.times.at(frame)).collect();
    let space = BoundingBox::of(rest);
    let height = (space.max.y - space.min.y).max(f64::MIN_POSITIVE);
    let feet = animation.driver.foot_contacts(&times).into_iter();
    feet.map(|foot| FootFacts {
        bone: animation.rig.bones[foot.bone].id.clone(),
        contacts: foot.contacts,
        planted: foot.planted,
        drift: foot.drift.map(|drift| drift / height),
    })
    .collect()
}

/// Finds a clip for a model, and the rig that it drives.
fn moving_clip(
    deformer: &Deformer,
    request: &ClipRequest,
    limits: &AnimationLimits,
    exec: &Exec<'_>,
) -> Result<MovingClip, Error> {
    let rig = request.rig.as_ref();
    let is_own_clip = matches!(request.clip, ClipSource::OfModel(_)) && rig.is_none();
    let mut warnings = left_out_warnings(deformer.model(), &deformer.geometry().primitives, is_own_clip)?;
    let name = match &request.clip {
        ClipSource::Bvh { bytes, .. } => {
            let clip = read_bvh(bytes, &limits.clip)?;
            let rig = match rig {
                Some(rig) => rig.clone(),
                None => {
                    let made = rig_for_clip(deformer, &clip, exec)?;
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
        return Err(RigError::field("clip", problem).into());
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
        return Err(RigError::field("clip", problem).into());
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
        let known = skin_problem(model).or_else(|| no_skin_problem(&scene, index));
        known.unwrap_or(e)
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
fn no_skin_problem(scene: &MovingScene, index: usize) -> Option<RigError> {
    let has_skin = scene.is_joint.contains(&true) || scene.primitives.iter().any(|p| p.has_skin);
    let name = scene.clip_names.get(index).map_or("", String::as_str);
    let problem = format!(
        "the model has no skin, and clip {index} \"{name}\" moves nodes or morph targets alone, which plays as it is and leaves \
         nothing to solve; give a rig whose joints are nodes that it moves, and the whole model is solved for that, or a recording \
         with a rig"
    );
    (!has_skin).then(|| RigError::field("rig", problem))
}

/// Why a model's skin says nothing, where it has one that cannot be read.
fn skin_problem(model: &Model) -> Option<RigError> {
    let mut skins = model.warnings.iter().filter(|(code, _, _)| code == "skin-not-applied");
    let (_, message, place) = skins.next()?;
    Some(RigError::field(
        "rig",
        format!("{place}: {message}; without it, give a rig"),
    ))
}

/// The rig that `pliant rig` makes of a model for a recorded clip, where none is given.
fn rig_for_clip(deformer: &Deformer, clip: &MotionClip, exec: &Exec<'_>) -> Result<MadeRig, Error> {
    exec.progress.report("rig", 0.0);
    let order = RigOrder {
        clip: Some(clip),
        ..Default::default()
    };
    let made = deformer
        .make_rig(&order, exec)
        .and_then(|made| made.check().map(|()| made));
    made.map_err(|error| match error {
        Error::Invalid { .. } => Error::invalid("rig", format!("is missing, and pliant rig finds none: {error}")),
        other => other,
    })
}

/// Checks that no frame takes a bone farther than 32-bit floats reach, in which positions are written.
fn check_reach(rig: &MotionRig, driver: &RigDriver, times: &FrameTimes, range: &Range<usize>) -> Result<(), RigError> {
    let is_near = |motion: &RigidMotion| motion.to.abs().cmple(DVec3::splat(FARTHEST_FRAME)).all();
    for frame in range.clone() {
        let pose = driver.pose_at(times.at(frame));
        let motions = pose.bones.iter().zip(&rig.bones);
        let far = motions.chain([(&pose.root, &rig.bones[0])]).find(|(m, _)| !is_near(m));
        if let Some((_, bone)) = far {
            let problem = format!(
                "takes bone \"{}\" farther than {FARTHEST_FRAME:e} from the origin in frame {frame}",
                bone.id
            );
            return Err(RigError::field("clip", problem));
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
