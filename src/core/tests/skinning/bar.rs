//! A bar that three bones carry.

use glam::{DQuat, DVec3};
use pliant_core::motion::BoneInfluences;
use pliant_core::motion::decomposition::{ShapeSequence, SkinDecomposition};
use pliant_core::motion::rig::RigidMotion;
use std::f64::consts::TAU;

/// Points of a bar of 6 by 1 by 1 along x, in no regular order of distances.
pub fn bar_points() -> Vec<DVec3> {
    let part = |k: usize, s: f64| (k as f64 * s).fract();
    let points = (0..1200).map(|k| {
        DVec3::new(
            6.0 * (k as f64 + 0.5) / 1200.0,
            part(k, 0.618_033_988_7) - 0.5,
            part(k, 0.414_213_562_3) - 0.5,
        )
    });
    points.collect()
}

/// Where three bones are in a frame: each turned about the end of the one before, all of them carried.
pub fn bar_motions(frame: usize) -> Vec<RigidMotion> {
    let wave = |s: f64| (frame as f64 * s * TAU).sin();
    let carried = RigidMotion {
        rotation: DQuat::from_euler(
            glam::EulerRot::XYZ,
            0.3 * wave(0.11),
            0.8 * wave(0.05),
            0.2 * wave(0.17),
        ),
        from: DVec3::ZERO,
        to: DVec3::new(3.0 * wave(0.03), wave(0.02), 0.5 * frame as f64),
    };
    let mut rotation = carried.rotation;
    let mut to = carried.place(DVec3::ZERO);
    let mut motions = Vec::new();
    for bone in 0..3 {
        let s = 0.07 + 0.04 * bone as f64;
        rotation *= DQuat::from_euler(glam::EulerRot::XYZ, wave(s), 0.9 * wave(s * 1.3), 0.7 * wave(s * 0.6));
        let from = DVec3::X * (2.0 * bone as f64);
        motions.push(RigidMotion { rotation, from, to });
        to += rotation * (DVec3::X * 2.0);
    }
    motions
}

/// Each point with the bone around it.
pub fn rigid_influences(points: &[DVec3]) -> Vec<BoneInfluences> {
    let bones = points.iter().map(|p| (p.x / 2.0).clamp(0.0, 2.0) as u16);
    bones.map(BoneInfluences::one).collect()
}

/// Each point with the two bones next to it, one fading out where the other fades in.
pub fn smooth_influences(points: &[DVec3]) -> Vec<BoneInfluences> {
    let blended = points.iter().map(|p| {
        let along = (p.x / 2.0 - 0.5).clamp(0.0, 2.0);
        let bone = (along as u16).min(1);
        let share = along - f64::from(bone);
        BoneInfluences::from_pairs(&mut [(bone, 1.0 - share), (bone + 1, share)]).expect("weights")
    });
    blended.collect()
}

/// What a skin makes of points.
pub fn placed(points: &[DVec3], influences: &[BoneInfluences], motions: &[RigidMotion]) -> Vec<DVec3> {
    let blend = |(p, v): (&DVec3, &BoneInfluences)| v.blend(|bone| motions[bone].place(*p));
    points.iter().zip(influences).map(blend).collect()
}

/// Frames of the bar, as a sequence and as they are.
pub fn bar_sequence(influences: &[BoneInfluences], frames: usize) -> (ShapeSequence, Vec<Vec<DVec3>>) {
    let points = bar_points();
    let mut sequence = ShapeSequence::new(&points).expect("a shape");
    let given: Vec<_> = (0..frames)
        .map(|f| placed(&points, influences, &bar_motions(f)))
        .collect();
    given.iter().for_each(|x| sequence.push(x).expect("a frame"));
    (sequence, given)
}

/// The largest distance between what a decomposition plays and the frames.
pub fn largest_error(found: &SkinDecomposition, rest: &[DVec3], given: &[Vec<DVec3>]) -> f64 {
    let mut largest = 0.0f64;
    for (motions, given) in found.motions.iter().zip(given) {
        let played = placed(rest, &found.influences, motions);
        largest = played
            .iter()
            .zip(given)
            .map(|(a, b)| a.distance(*b))
            .fold(largest, f64::max);
    }
    largest
}
