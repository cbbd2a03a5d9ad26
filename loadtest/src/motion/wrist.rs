//! A wrist that is turned over: how much of the forearm is left around it.

use super::ballet::BALLET;
use super::blend_skinning::{bind, skinned};
use super::figure::MotionFigure;
use super::stage::{MotionFolders, MotionStage, solve};
use crate::failure::LoadtestFailure;
use glam::{DQuat, DVec3};
use pliant::engine::{AnimationRefinement, FrameTimes};
use pliant::motion::rig::{ReferencePose, RestAttitude};
use pliant::motion::{
    Interpolation, JointCurves, JointPose, KeyedCurve, MotionClip, RecordedFrames, Skeleton, SkeletonJoint,
};
use pliant::pool::Pool;

/// By how much it is turned, in degrees.
const TURN: f64 = 150.0;
/// Frames on the way, one in a 30th of a second.
const FRAMES: usize = 31;
const RATE: f64 = 30.0;
/// The hand, which is turned about the axis of the bone that it hangs on.
const HAND: &str = "lHand";
/// How far around the wrist volume counts, in radii of the hand.
const AROUND: f64 = 1.5;

/// Row 8.
pub(super) fn measure_wrist(folders: &MotionFolders<'_>, pool: &Pool) -> Result<Vec<MotionFigure>, LoadtestFailure> {
    let mut stage = folders.stage(BALLET, 0, pool)?;
    let Some(hand) = stage.rig.bones.iter().position(|bone| bone.id == HAND) else {
        return Err(LoadtestFailure::Server(format!("the rig has no bone \"{HAND}\"")));
    };
    turn_hand(&mut stage, hand);
    let times = FrameTimes {
        start: 0.0,
        rate: RATE,
        count: FRAMES,
    };
    let animation = stage.animation(times, AnimationRefinement::Carried, pool)?;
    let mut last = Vec::new();
    solve(&animation, 0..FRAMES, pool, &mut |frame| last = frame.positions)?;
    let pose = animation.driver().pose_at(times.at(FRAMES - 1));
    let blended = skinned(stage.deformer.rest(), &bind(&stage, pool)?, &pose.bones);
    let patch = WristPatch::find(&stage, hand);
    let rest = patch.volume(stage.deformer.rest());
    let change = |shape: &[DVec3]| 100.0 * (patch.volume(shape) / rest - 1.0);
    let flips = |shape: &[DVec3]| f64::from(stage.deformer.quality(shape, pool).flipped_triangles);
    Ok(vec![
        MotionFigure::below(
            8,
            "wrist by 150 degrees: volume around it",
            (change(&last), " %"),
            [Some(12.0), Some(5.0)],
        ),
        MotionFigure::below(8, "flipped triangles", (flips(&last), ""), [Some(0.0), None]),
        MotionFigure::told(8, "blend skinning: volume around it", (change(&blended), " %")),
        MotionFigure::told(8, "blend skinning: flipped triangles", (flips(&blended), "")),
    ])
}

/// Gives a stage a clip of its own rig's joints in which the hand is turned, and nothing else.
fn turn_hand(stage: &mut MotionStage, hand: usize) {
    let bones = &mut stage.rig.bones;
    let starts: Vec<DVec3> = bones.iter().map(|bone| bone.from).collect();
    let mut clip = MotionClip {
        curves: vec![JointCurves::default(); bones.len()],
        duration: (FRAMES - 1) as f64 / RATE,
        recorded: Some(RecordedFrames {
            count: FRAMES,
            interval: 1.0 / RATE,
        }),
        ..Default::default()
    };
    let mut joints = Vec::with_capacity(bones.len());
    for bone in bones.iter_mut() {
        bone.joint.clone_from(&bone.id);
        bone.aim = None;
        bone.rest = RestAttitude::Orientation;
        let above = bone.parent.map_or(DVec3::ZERO, |p| starts[p]);
        joints.push(SkeletonJoint {
            name: bone.id.clone(),
            parent: bone.parent,
            rest: JointPose::at(bone.from - above),
        });
    }
    let arm = bones[hand]
        .parent
        .and_then(|p| bones[p].direction())
        .unwrap_or(DVec3::X);
    let times: Vec<f64> = (0..FRAMES).map(|k| k as f64 / RATE).collect();
    let turn = |k: usize| DQuat::from_axis_angle(arm, (TURN * k as f64 / (FRAMES - 1) as f64).to_radians());
    let turns: Vec<DQuat> = (0..FRAMES).map(turn).collect();
    clip.curves[hand].rotation = KeyedCurve::through(times.into(), turns, Interpolation::Linear);
    clip.skeleton = Skeleton { joints };
    stage.clip = clip;
    stage.rig.reference = ReferencePose::Rest;
    stage.rig.scale = Some(1.0);
}

/// The surface around a wrist.
struct WristPatch {
    wrist: DVec3,
    triangles: Vec<[usize; 3]>,
}

impl WristPatch {
    /// Triangles near the wrist, and nearer to the hand and the forearm than to any other bone.
    fn find(stage: &MotionStage, hand: usize) -> Self {
        let bones = &stage.rig.bones;
        let wrist = bones[hand].from;
        let reach = AROUND * bones[hand].radius;
        let rest = stage.deformer.rest();
        let is_own = |p: DVec3| {
            let distance = |bone: &pliant::motion::rig::RigBone| {
                let along = bone.to - bone.from;
                let share = (p - bone.from).dot(along) / along.length_squared().max(f64::MIN_POSITIVE);
                p.distance(bone.from + along * share.clamp(0.0, 1.0))
            };
            let nearest = (0..bones.len()).min_by(|a, b| distance(&bones[*a]).total_cmp(&distance(&bones[*b])));
            nearest == Some(hand) || nearest == bones[hand].parent
        };
        let is_near = |v: &usize| rest[*v].distance(wrist) < reach && is_own(rest[*v]);
        let triangles = stage.deformer.geometry().triangles.iter();
        let triangles = triangles
            .map(|t| t.map(|v| v as usize))
            .filter(|t| t.iter().all(is_near));
        Self {
            wrist,
            triangles: triangles.collect(),
        }
    }

    /// The volume between the wrist, which stays where it is, and the surface.
    fn volume(&self, shape: &[DVec3]) -> f64 {
        let cone = |t: &[usize; 3]| {
            let [a, b, c] = t.map(|v| shape[v] - self.wrist);
            a.dot(b.cross(c)) / 6.0
        };
        self.triangles.iter().map(cone).sum()
    }
}
