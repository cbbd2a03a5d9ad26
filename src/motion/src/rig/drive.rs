//! A clip's motion as that of a model's bones.
//!
//! How a clip is turned and scaled to stand as a model does.
//!
//! Bones that a clip twists nearly half around.

use super::bone_pairs::{BonePair, Heading, heading_for_vertical, scale_of_bones, scale_of_legs};
use super::bones::{MotionRig, ReferencePose, RestAttitude, RigBone, RigError, listed_names};
use super::half_turns::{BoneTurns, HalfTurns};
use super::legs::Leg;
use super::planted_feet::{FootContacts, PlantedFeet, PlantedFoot, RecordedLeg, RecordedTimes};
use super::rigid_motion::{RigidMotion, clear_twist, rotation_about};
use crate::skeleton::MotionClip;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use pliant_mesh::rotation::fit_rotation;
use pliant_mesh::rotation::log_rotation;

/// How a clip drives a rig.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct DriveOptions {
    /// Model units for one unit of the clip, in place of the rig's.
    pub scale: Option<f64>,
    /// What the bones are fitted to, in place of the rig's.
    pub reference: Option<ReferencePose>,
    /// When the motion starts, in seconds: the root's place then is its place in the model. The reference frame gives
    /// its height, so that a crouched start stays crouched.
    pub start: f64,
}

/// Where the bones of a rig are at a time.
#[derive(Debug, Clone, PartialEq)]
pub struct RigPose {
    /// What the root bone does in the model's space.
    pub root: RigidMotion,
    /// What each bone does as the root bone sees it, so that a turn of the whole changes nothing.
    pub bones: Vec<RigidMotion>,
    /// By bone how it is turned against its neighbours.
    pub turns: Vec<BoneTurns>,
}

impl RigPose {
    /// A pose on the way from the rest pose of its rig to this one: each bone has gone `part` (0 to 1) of its way against the bone that it
    /// hangs on.
    #[must_use]
    pub fn part_way(&self, rig: &MotionRig, part: f64) -> Self {
        let mut bones: Vec<RigidMotion> = Vec::with_capacity(self.bones.len());
        for (bone, motion) in rig.bones.iter().zip(&self.bones) {
            bones.push(match bone.parent {
                None => motion.part_way(part),
                Some(parent) => (motion.seen_from(&self.bones[parent]).part_way(part)).followed_by(&bones[parent]),
            });
        }
        Self {
            root: self.root,
            bones,
            turns: self.turns.iter().map(|turns| turns.part_way(part)).collect(),
        }
    }

    /// By how many radians a bone is turned against the one that it hangs on, at most, from another pose of the same rig to this one.
    pub fn largest_turn(&self, other: &Self, rig: &MotionRig) -> f64 {
        let turn = |bone: usize| {
            let parent = rig.bones[bone].parent?;
            let [now, then] = [self, other].map(|pose| pose.bones[bone].seen_from(&pose.bones[parent]).rotation);
            Some(log_rotation(then.inverse() * now).length())
        };
        (0..rig.bones.len()).filter_map(turn).fold(0.0, f64::max)
    }
}

/// A clip that drives a rig.
#[derive(Debug, Clone)]
pub struct RigDriver {
    clip: MotionClip,
    bones: Vec<DrivenBone>,
    heading: DQuat,
    scale: f64,
    /// Where the root's joint is when the model's has its rest place.
    root_origin: DVec3,
    /// For a skin's own clip: by joint, the inverse of its rest pose. Its joints are the bones', so nothing is fitted.
    back_from_rest: Option<Vec<DAffine3>>,
    /// Where feet are kept that stand.
    feet: Option<PlantedFeet>,
    half_turns: HalfTurns,
    warnings: Vec<String>,
}

/// What a driver knows of a bone.
#[derive(Debug, Clone)]
struct DrivenBone {
    parent: Option<usize>,
    from: DVec3,
    joint: usize,
    /// From rest to the attitude that fits the clip's reference pose.
    base: DQuat,
    /// Back from how the joint is turned in the clip's reference pose.
    back_from_reference: DQuat,
    /// In radians.
    limit: Option<f64>,
}

/// Frames a second at which clips are looked at that were not recorded in frames.
const UNRECORDED_RATE: f64 = 30.0;
/// At how many times, evenly over a clip, it is looked at for what it scales.
const SCALE_LOOKS: usize = 32;

/// Where the joints of a clip are, and how they are turned, at one time.
struct ClipState {
    places: Vec<DVec3>,
    turns: Vec<DQuat>,
}

impl ClipState {
    fn of(clip: &MotionClip, pose: &[crate::JointPose]) -> Self {
        let world = clip.skeleton.world_transforms(pose);
        let mut turns: Vec<DQuat> = Vec::with_capacity(pose.len());
        for (joint, own) in clip.skeleton.joints.iter().zip(pose) {
            let above = joint.parent.map_or(DQuat::IDENTITY, |p| turns[p]);
            turns.push((above * own.rotation).normalize());
        }
        Self {
            places: world.iter().map(|w| w.translation).collect(),
            turns,
        }
    }

    fn at(clip: &MotionClip, seconds: f64) -> Self {
        Self::of(clip, &clip.pose_at(seconds))
    }
}

impl RigDriver {
    /// Fits a rig's bones to a clip.
    ///
    /// # Errors
    /// [`RigError`] for a joint that the clip lacks (with the clip's names) or a reference frame that it does not have.
    pub fn new(rig: &MotionRig, clip: MotionClip, options: &DriveOptions) -> Result<Self, RigError> {
        let fitted_to = options.reference.unwrap_or(rig.reference);
        let reference = match fitted_to {
            ReferencePose::Rest => ClipState::of(&clip, &clip.skeleton.rest_pose()),
            ReferencePose::Frame(frame) => ClipState::at(&clip, time_of_frame(&clip, frame)?),
        };
        let mut joints = Vec::with_capacity(rig.bones.len());
        let mut pairs = Vec::with_capacity(rig.bones.len());
        for bone in &rig.bones {
            let joint = joint_named(&clip, &bone.joint, bone, "joint")?;
            let aim = match &bone.aim {
                Some(name) => Some(joint_named(&clip, name, bone, "aim")?),
                None => first_below_elsewhere(&clip, joint, &reference.places),
            };
            joints.push(joint);
            pairs.push(BonePair {
                model: [bone.from, bone.to],
                clip: (reference.places[joint], aim.map(|a| reference.places[a])),
            });
        }
        let Heading { turn: heading, up } = heading_for_vertical(&pairs, rig.up);
        let scale = (options.scale.or(rig.scale))
            .or_else(|| scale_of_legs(rig, &Leg::all_of(rig, &clip.skeleton), &pairs))
            .unwrap_or_else(|| scale_of_bones(&rig.bones, &pairs));
        let mut root_origin = ClipState::at(&clip, options.start).places[joints[0]];
        if let ReferencePose::Frame(_) = fitted_to {
            let height = reference.places[joints[0]];
            root_origin = root_origin * (DVec3::ONE - up) + height * up;
        }
        let mut driver = Self {
            bones: Vec::with_capacity(rig.bones.len()),
            heading,
            scale,
            root_origin,
            back_from_rest: None,
            feet: None,
            half_turns: HalfTurns::of(rig),
            warnings: clip.warnings.clone(),
            clip,
        };
        for ((bone, pair), &joint) in rig.bones.iter().zip(&pairs).zip(&joints) {
            let above = bone.parent.map_or(DQuat::IDENTITY, |p| driver.bones[p].base);
            let base = driver.base_attitude(bone, pair, above);
            driver.bones.push(DrivenBone {
                parent: bone.parent,
                from: bone.from,
                joint,
                base,
                back_from_reference: reference.turns[joint].inverse(),
                limit: bone.limit_degrees.map(f64::to_radians),
            });
        }
        Ok(driver)
    }

    /// Lets a clip of a model's own skeleton drive the rig that was made of its skin: bones do what joints do, whatever moves
    /// them. Of what joints scale and shear the nearest rotation is taken, with a warning.
    ///
    /// # Errors
    /// As [`RigDriver::new`].
    pub fn of_skin(rig: &MotionRig, clip: MotionClip, start: f64) -> Result<Self, RigError> {
        let options = DriveOptions {
            scale: Some(1.0),
            reference: Some(ReferencePose::Rest),
            start,
        };
        let mut driver = Self::new(rig, clip, &options)?;
        let rest = driver.clip.skeleton.world_transforms(&driver.clip.skeleton.rest_pose());
        driver.heading = DQuat::IDENTITY;
        driver.back_from_rest = Some(rest.iter().map(inverse_or_identity).collect());
        let scales = |motion: &DAffine3| {
            let m = &motion.matrix3;
            let apart = (m.transpose() * *m - DMat3::IDENTITY).to_cols_array();
            apart.iter().any(|v| v.abs() > 0.02)
        };
        let mut is_scaled = vec![false; driver.clip.skeleton.joints.len()];
        for look in 0..=SCALE_LOOKS {
            let seconds = start + (driver.clip.duration - start) * (look as f64 / SCALE_LOOKS as f64);
            for (is_scaled, motion) in is_scaled.iter_mut().zip(driver.joint_motions(seconds)) {
                *is_scaled |= scales(&motion);
            }
        }
        let scaled: Vec<&str> = (rig.bones.iter().zip(&driver.bones))
            .filter(|(_, driven)| is_scaled[driven.joint])
            .map(|(bone, _)| bone.id.as_str())
            .collect();
        if !scaled.is_empty() {
            let names = listed_names(scaled.iter());
            driver.warnings.push(format!(
                "the clip scales or shears {names}; they are turned and moved, not scaled"
            ));
        }
        Ok(driver)
    }

    /// Keeps feet where they stand from `start` on, in seconds, with soles made of the vertices `rest`; answers whether the rig has legs that the clip's legs turn. A skin's own
    /// clip stays as it is.
    pub fn plant_feet(&mut self, rig: &MotionRig, rest: &[DVec3], start: f64) -> bool {
        if self.back_from_rest.is_some() {
            return false;
        }
        let times = self.recorded_from(start);
        let legs = Leg::all_of(rig, &self.clip.skeleton);
        let driven = |seconds: f64| self.fitted_motions(seconds);
        let recorded = |seconds: f64, leg: &Leg| self.recorded_leg(seconds, leg);
        let feet = legs
            .iter()
            .filter_map(|leg| PlantedFoot::at_rest(*leg, rig, rest))
            .collect();
        self.feet = PlantedFeet::of(rig, feet, times, driven, recorded);
        self.feet.is_some()
    }

    /// Follows turns of bones from `start` on, in seconds, so that none flips over where it passes half a turn.
    pub fn follow_turns(&mut self, start: f64) {
        let mut half_turns = std::mem::take(&mut self.half_turns);
        let times = self.recorded_from(start);
        half_turns.follow((0..times.count).map(|frame| {
            let seconds = start + frame as f64 * times.interval;
            (seconds, self.world_motions(seconds))
        }));
        self.half_turns = half_turns;
    }

    fn recorded_from(&self, start: f64) -> RecordedTimes {
        let interval = self.clip.recorded.map_or(1.0 / UNRECORDED_RATE, |r| r.interval);
        // Files round the time between frames.
        let count = ((self.clip.duration - start).max(0.0) / interval + 1e-3) as usize + 1;
        RecordedTimes { start, interval, count }
    }

    fn recorded_leg(&self, seconds: f64, leg: &Leg) -> RecordedLeg {
        let places = ClipState::at(&self.clip, seconds).places;
        let [hip, knee] = [leg.thigh, leg.shin].map(|bone| self.bones[bone].joint);
        let below = |joint: usize| first_below_elsewhere(&self.clip, joint, &places).unwrap_or(joint);
        let ankle = leg.foot.map_or_else(|| below(knee), |foot| self.bones[foot].joint);
        let place = |joint: usize| self.heading * places[joint];
        RecordedLeg {
            hip: place(hip),
            knee: place(knee),
            ankle: place(ankle),
            toe: place(below(ankle)),
        }
    }

    /// What feet do at some times in seconds; nothing where they are not planted.
    pub fn foot_contacts(&self, times: &[f64]) -> Vec<FootContacts> {
        let feet = self.feet.iter();
        feet.flat_map(|feet| feet.contacts(times, |seconds| self.fitted_motions(seconds)))
            .collect()
    }

    /// The motions of joints from the rest pose.
    fn joint_motions(&self, seconds: f64) -> Vec<DAffine3> {
        let world = self.clip.skeleton.world_transforms(&self.clip.pose_at(seconds));
        let back = self.back_from_rest.iter().flatten();
        world.iter().zip(back).map(|(now, back)| *now * *back).collect()
    }

    fn skin_motions(&self, seconds: f64) -> Vec<RigidMotion> {
        let joints = self.joint_motions(seconds);
        let motion = |bone: &DrivenBone| {
            let joint = &joints[bone.joint];
            RigidMotion {
                rotation: fit_rotation(joint.matrix3),
                from: bone.from,
                to: joint.transform_point3(bone.from),
            }
        };
        self.bones.iter().map(motion).collect()
    }

    /// The turn of a bone of the model from its rest pose to the clip's reference pose.
    fn base_attitude(&mut self, bone: &RigBone, pair: &BonePair, above: DQuat) -> DQuat {
        match bone.rest {
            RestAttitude::Orientation => DQuat::IDENTITY,
            RestAttitude::Parent => above,
            RestAttitude::Direction => {
                let Some(own) = bone.direction() else {
                    self.warnings.push(format!(
                        "bone \"{}\" has no length, so it is turned as its parent is",
                        bone.id
                    ));
                    return above;
                };
                let meant = pair
                    .clip
                    .1
                    .and_then(|end| (self.heading * (end - pair.clip.0)).try_normalize());
                match meant {
                    Some(meant) => (DQuat::from_rotation_arc(above * own, meant) * above).normalize(),
                    None => {
                        let problem = format!(
                            "joint \"{}\" of the clip points nowhere, so bone \"{}\" is turned as its parent is",
                            bone.joint, bone.id
                        );
                        self.warnings.push(problem);
                        above
                    }
                }
            }
        }
    }

    /// The clip.
    pub fn clip(&self) -> &MotionClip {
        &self.clip
    }

    /// What was noticed, one line each; those of the clip come first.
    pub fn warnings(&self) -> &[String] {
        &self.warnings
    }

    /// Model units for one unit of the clip.
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// By bone how it is turned against its parent, relative to the reference pose, in the axes of the model's rest
    /// pose; `None` for the root.
    fn turns_from_reference(&self, seconds: f64) -> Vec<Option<DQuat>> {
        let motions = self.world_motions(seconds);
        let turn = |(own, motion): (&DrivenBone, &RigidMotion)| {
            let parent = own.parent?;
            let base = match self.back_from_rest {
                Some(_) => DQuat::IDENTITY,
                None => self.bones[parent].base.inverse() * own.base,
            };
            Some((base.inverse() * motions[parent].rotation.inverse() * motion.rotation).normalize())
        };
        self.bones.iter().zip(&motions).map(turn).collect()
    }

    /// Adds a line to what was noticed.
    pub fn warn(&mut self, line: String) {
        self.warnings.push(line);
    }

    /// Where the bones are at a time of the clip in seconds.
    pub fn pose_at(&self, seconds: f64) -> RigPose {
        let world = self.world_motions(seconds);
        let root = world[0];
        let bones: Vec<RigidMotion> = world.iter().map(|motion| motion.seen_from(&root)).collect();
        RigPose {
            turns: self.half_turns.at(seconds, &bones),
            bones,
            root,
        }
    }

    fn world_motions(&self, seconds: f64) -> Vec<RigidMotion> {
        match self.back_from_rest {
            Some(_) => self.skin_motions(seconds),
            None => {
                let mut world = self.fitted_motions(seconds);
                if let Some(feet) = &self.feet {
                    feet.plant(seconds, &mut world);
                }
                world
            }
        }
    }

    fn fitted_motions(&self, seconds: f64) -> Vec<RigidMotion> {
        let state = ClipState::at(&self.clip, seconds);
        let mut world: Vec<RigidMotion> = Vec::with_capacity(self.bones.len());
        for bone in &self.bones {
            let turned = self.heading * state.turns[bone.joint] * bone.back_from_reference * self.heading.inverse();
            let mut rotation = (turned * bone.base).normalize();
            let to = match bone.parent {
                None => {
                    let way = self.heading * (state.places[bone.joint] - self.root_origin);
                    bone.from + way * self.scale
                }
                Some(parent) => {
                    if let Some(limit) = bone.limit {
                        let base = (self.bones[parent].base.inverse() * bone.base).normalize();
                        rotation = world[parent].rotation
                            * within_limit(world[parent].rotation.inverse() * rotation, base, limit);
                    }
                    world[parent].place(bone.from)
                }
            };
            world.push(RigidMotion {
                rotation: rotation.normalize(),
                from: bone.from,
                to,
            });
        }
        world
    }
}

/// The inverse; nothing for a transform that flattens space.
fn inverse_or_identity(transform: &DAffine3) -> DAffine3 {
    let inverse = transform.inverse();
    if inverse.is_finite() {
        inverse
    } else {
        DAffine3::IDENTITY
    }
}

/// A turn relative to a parent, brought back to at most `limit` radians from `base`.
fn within_limit(relative: DQuat, base: DQuat, limit: f64) -> DQuat {
    let beyond = relative * base.inverse();
    let beyond = if beyond.w < 0.0 { -beyond } else { beyond };
    let sine = beyond.xyz().length();
    let half = libm::atan2(sine, beyond.w);
    if 2.0 * half <= limit || sine == 0.0 {
        return relative;
    }
    rotation_about(beyond.xyz() / sine, limit) * base
}

/// When a frame of a clip is, in seconds; of clips that were not recorded in frames, only the first is known.
fn time_of_frame(clip: &MotionClip, frame: usize) -> Result<f64, RigError> {
    let count = clip.recorded.map_or(1, |r| r.count);
    if frame >= count {
        let problem = format!("is {frame}, the clip has {count} frames, counted from 0");
        return Err(RigError::field("referenceFrame", problem));
    }
    Ok(clip.recorded.map_or(0.0, |r| r.interval * frame as f64))
}

fn joint_named(clip: &MotionClip, name: &str, bone: &RigBone, field: &'static str) -> Result<usize, RigError> {
    clip.skeleton.joint_named(name).ok_or_else(|| {
        let joints = clip.skeleton.joints.iter();
        let names = listed_names(joints.map(|j| j.name.as_str()).filter(|n| !n.is_empty()));
        let problem = format!(
            "\"{name}\" of bone \"{}\" is not a joint of the clip; it has {names}",
            bone.id
        );
        RigError::field(field, problem)
    })
}

/// The first joint below another that lies elsewhere.
fn first_below_elsewhere(clip: &MotionClip, joint: usize, places: &[DVec3]) -> Option<usize> {
    let joints = &clip.skeleton.joints;
    let mut is_below = vec![false; joints.len()];
    is_below[joint] = true;
    for number in joint + 1..joints.len() {
        if joints[number].parent.is_some_and(|p| is_below[p]) {
            if places[number] != places[joint] {
                return Some(number);
            }
            is_below[number] = true;
        }
    }
    None
}

/// From how many degrees on a twist is reported: so far no limb turns, and what hangs on it is wrung.
const LARGEST_TWIST: f64 = 170.0;
/// How many bones are reported.
const MOST_REPORTED: usize = 8;

impl RigDriver {
    /// Warns of bones that are twisted about their own axes by more than 170 degrees against their parents, from how they stand in
    /// the reference pose: once of each, of the frame where it is most. `frames` are numbers and times in seconds.
    pub fn warn_of_twists(&mut self, rig: &MotionRig, frames: impl Iterator<Item = (usize, f64)>) {
        let mut worst: Vec<Option<(f64, usize)>> = vec![None; rig.bones.len()];
        for (frame, seconds) in frames {
            let turns = self.turns_from_reference(seconds);
            for ((bone, turn), worst) in rig.bones.iter().zip(turns).zip(&mut worst) {
                let Some((turn, axis)) = turn.zip(bone.direction()) else {
                    continue;
                };
                let Some(twist) = clear_twist(turn, axis) else {
                    continue;
                };
                let degrees = twist.to_degrees().abs();
                if degrees > LARGEST_TWIST && worst.is_none_or(|(most, _)| degrees > most) {
                    *worst = Some((degrees, frame));
                }
            }
        }
        let reported = rig.bones.iter().zip(worst);
        let twisted: Vec<_> = reported.filter_map(|(bone, worst)| Some((&bone.id, worst?))).collect();
        for (bone, (degrees, frame)) in twisted.iter().take(MOST_REPORTED) {
            self.warn(format!(
                "bone \"{bone}\" is twisted by {degrees:.0} degrees about its own axis in frame {frame}, against how it stands in \
                 the reference pose"
            ));
        }
        if let Some(more @ 1..) = twisted.len().checked_sub(MOST_REPORTED) {
            self.warn(format!(
                "{more} more bones are twisted by more than {LARGEST_TWIST} degrees"
            ));
        }
    }
}
