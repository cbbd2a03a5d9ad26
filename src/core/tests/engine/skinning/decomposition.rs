//! Laws of the decomposition.

use glam::{DQuat, DVec3};
use pliant_core::exec::Exec;
use pliant_core::motion::BoneInfluences;
use pliant_core::motion::decomposition::{
    DecompositionError, DecompositionOptions, ShapeSequence, SkinDecomposition, decompose, fit_weights,
};
use pliant_core::motion::rig::RigidMotion;
use pliant_core::pool::Pool;
use pliant_core::progress::{CancelFlag, Silent};
use std::f64::consts::TAU;

fn options(bones: usize) -> DecompositionOptions {
    DecompositionOptions {
        bones,
        ..DecompositionOptions::default()
    }
}

fn run(sequence: &ShapeSequence, options: &DecompositionOptions, threads: usize) -> SkinDecomposition {
    let pool = Pool::new(threads).expect("threads");
    decompose(sequence, options, &Exec::new(&pool, &Silent)).expect("a skin")
}

fn assert_weights_hold(influences: &[BoneInfluences], most: usize) {
    for vertex in influences {
        assert!((vertex.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        assert!(vertex.weights.iter().all(|w| *w >= 0.0) && vertex.iter().count() <= most);
        assert!(vertex.weights.windows(2).all(|w| w[0] >= w[1]), "heaviest first");
    }
}

#[test]
fn rigid_parts_are_found_again_to_a_millionth() {
    let points = bar_points();
    let (sequence, given) = bar_sequence(&rigid_influences(&points), 24);
    let found = run(&sequence, &options(3), 2);
    let error = largest_error(&found, &points, &given) / sequence.diagonal();
    assert!(error < 1e-6, "{error:e}");
    assert!((found.max / sequence.diagonal() - error).abs() < 1e-6);
    assert_weights_hold(&found.influences, 4);
    let whole = found.influences.iter().filter(|v| v.weights[0] > 0.999);
    assert!(whole.count() > points.len() * 9 / 10, "parts are rigid");
}

#[test]
fn blended_parts_are_found_again_with_bones_that_they_were_not_given() {
    let points = bar_points();
    let (sequence, given) = bar_sequence(&smooth_influences(&points), 24);
    let found = run(&sequence, &options(3), 2);
    let error = largest_error(&found, &points, &given) / sequence.diagonal();
    assert!(error < 0.02, "{error:e}");
    assert!(
        found.rms / sequence.diagonal() < 0.003,
        "{:e}",
        found.rms / sequence.diagonal()
    );
    // More bones come nearer, and one bone cannot.
    let more = run(&sequence, &options(6), 2);
    assert!(more.rms < 0.5 * found.rms, "{:e} against {:e}", more.rms, found.rms);
    assert!(run(&sequence, &options(1), 2).rms > 10.0 * found.rms);
}

#[test]
fn weights_of_given_bones_are_found_again() {
    let points = bar_points();
    let influences = smooth_influences(&points);
    let (sequence, given) = bar_sequence(&influences, 24);
    let motions: Vec<_> = (0..24).map(bar_motions).collect();
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let found = fit_weights(&sequence, &motions, 4, &exec).expect("weights");
    assert!(largest_error(&found, &points, &given) / sequence.diagonal() < 1e-6);
    assert_weights_hold(&found.influences, 4);
    for (own, reported) in found.influences.iter().zip(&influences) {
        for (bone, weight) in reported.iter() {
            let seen = own.iter().find(|i| i.0 == bone).map_or(0.0, |i| i.1);
            assert!((seen - weight).abs() < 1e-5, "{seen} instead of {weight}");
        }
    }
    for (own, reported) in found.motions.iter().zip(&motions) {
        for (own, reported) in own.iter().zip(reported) {
            assert!(own.place(DVec3::ONE).distance(reported.place(DVec3::ONE)) < 1e-9);
        }
    }
    let one = fit_weights(&sequence, &motions, 1, &exec).expect("weights");
    assert_weights_hold(&one.influences, 1);
    assert!(one.rms > found.rms);
}

#[test]
fn threads_change_no_bit() {
    let (sequence, _) = bar_sequence(&smooth_influences(&bar_points()), 90);
    let asked = DecompositionOptions {
        iterations: 12,
        ..options(5)
    };
    let (one, three) = (run(&sequence, &asked, 1), run(&sequence, &asked, 3));
    assert_eq!(one, three);
    assert_eq!(one.motions.len(), 90, "frames beyond the sample have motions too");
}

#[test]
fn fewer_influences_are_kept_to() {
    let (sequence, _) = bar_sequence(&smooth_influences(&bar_points()), 12);
    for influences in 1..=2 {
        let asked = DecompositionOptions {
            influences,
            iterations: 6,
            ..options(4)
        };
        assert_weights_hold(&run(&sequence, &asked, 2).influences, influences);
    }
}

#[test]
fn a_scene_that_is_turned_and_far_away_gives_the_same_skin() {
    let points = bar_points();
    let (sequence, given) = bar_sequence(&rigid_influences(&points), 16);
    let turn = DQuat::from_euler(glam::EulerRot::XYZ, 1.0, 2.0, 0.5);
    let carry = |x: &DVec3| turn * *x * 100.0 + DVec3::new(9e3, -4e3, 1e3);
    let mut moved = ShapeSequence::new(&points).expect("a shape");
    for frame in &given {
        let there: Vec<DVec3> = frame
            .iter()
            .map(|x| turn * *x + DVec3::new(900.0, -400.0, 100.0))
            .collect();
        moved.push(&there).expect("a frame");
    }
    let here = run(&sequence, &options(3), 2);
    let there = run(&moved, &options(3), 2);
    for (a, b) in here.motions.iter().flatten().zip(there.motions.iter().flatten()) {
        let seen = turn * a.place(DVec3::ONE) + DVec3::new(900.0, -400.0, 100.0);
        assert!(seen.distance(b.place(DVec3::ONE)) < 1e-4);
    }
    // Rest shape and frames together, a hundred times as large.
    let rest: Vec<DVec3> = points.iter().map(carry).collect();
    let mut all = ShapeSequence::new(&rest).expect("a shape");
    let given: Vec<Vec<DVec3>> = given.iter().map(|f| f.iter().map(carry).collect()).collect();
    given.iter().for_each(|f| all.push(f).expect("a frame"));
    let found = run(&all, &options(3), 2);
    assert!(largest_error(&found, &rest, &given) / all.diagonal() < 1e-6);
}

#[test]
fn a_frame_after_another_turns_the_short_way() {
    let (sequence, _) = bar_sequence(&rigid_influences(&bar_points()), 60);
    let found = run(&sequence, &options(3), 2);
    for pair in found.motions.windows(2) {
        for (a, b) in pair[0].iter().zip(&pair[1]) {
            assert!(a.rotation.dot(b.rotation) > 0.0);
        }
    }
}

#[test]
fn degenerate_animations_have_skins() {
    let one = vec![DVec3::new(1.0, 2.0, 3.0)];
    let mut sequence = ShapeSequence::new(&one).expect("a point");
    sequence.push(&[DVec3::ZERO]).expect("a frame");
    let found = run(&sequence, &options(40), 1);
    assert_eq!((found.centres.len(), found.influences.len()), (1, 1));
    assert!(placed(&one, &found.influences, &found.motions[0])[0].length() < 1e-6);

    let same = vec![DVec3::ONE; 30];
    let mut sequence = ShapeSequence::new(&same).expect("points");
    sequence.push(&same).expect("a frame");
    sequence.push(&[DVec3::ZERO; 30]).expect("a frame");
    let found = run(&sequence, &options(7), 2);
    assert!(found.rms < 1e-6);
    assert_weights_hold(&found.influences, 4);

    // A line, and a shape that falls together.
    let line: Vec<DVec3> = (0..50).map(|k| DVec3::X * f64::from(k)).collect();
    let mut sequence = ShapeSequence::new(&line).expect("points");
    sequence.push(&line).expect("a frame");
    sequence.push(&vec![DVec3::Y; 50]).expect("a frame");
    let found = run(&sequence, &options(4), 2);
    assert!(
        found.rms.is_finite()
            && found
                .motions
                .iter()
                .flatten()
                .all(|m| m.rotation.is_finite() && m.to.is_finite())
    );

    let still = bar_points();
    let mut sequence = ShapeSequence::new(&still).expect("points");
    (0..3).for_each(|_| sequence.push(&still).expect("a frame"));
    assert!(run(&sequence, &options(10), 2).max < 1e-6 * sequence.diagonal());
}

#[test]
fn what_cannot_be_is_refused_with_what_may() {
    let reported = |e: DecompositionError| e.to_string();
    assert_eq!(
        reported(ShapeSequence::new(&[]).expect_err("refused")),
        "the rest shape: has no vertex, at least one is needed"
    );
    assert_eq!(
        reported(ShapeSequence::new(&[DVec3::ZERO, DVec3::NAN]).expect_err("refused")),
        "the rest shape: position 1 is not a point of finite numbers"
    );
    let mut sequence = ShapeSequence::new(&[DVec3::ZERO; 3]).expect("points");
    assert_eq!(
        reported(sequence.push(&[DVec3::ZERO; 2]).expect_err("refused")),
        "frame 0: has 2 positions, the rest shape has 3"
    );
    sequence.push(&[DVec3::ZERO; 3]).expect("a frame");
    let infinite = [DVec3::ZERO, DVec3::ZERO, DVec3::INFINITY];
    assert_eq!(
        reported(sequence.push(&infinite).expect_err("refused")),
        "frame 1: position 2 is not a point of finite numbers"
    );
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let refused = |sequence: &ShapeSequence, options: &DecompositionOptions| {
        reported(decompose(sequence, options, &exec).expect_err("refused"))
    };
    assert_eq!(refused(&sequence, &options(0)), "bones is 0, allowed are 1 to 256");
    assert_eq!(refused(&sequence, &options(257)), "bones is 257, allowed are 1 to 256");
    let five = DecompositionOptions {
        influences: 5,
        ..options(2)
    };
    assert_eq!(refused(&sequence, &five), "influences is 5, allowed are 1 to 4");
    let empty = ShapeSequence::new(&[DVec3::ZERO; 3]).expect("points");
    assert_eq!(refused(&empty, &options(2)), "frames is 0, allowed are 1 and more");
    let reported = reported(fit_weights(&sequence, &[], 4, &exec).expect_err("refused"));
    assert!(reported.starts_with("bones is 0"), "{reported}");
}

#[test]
fn cancelled_work_ends() {
    let (sequence, _) = bar_sequence(&rigid_influences(&bar_points()), 4);
    let pool = Pool::new(1).expect("a thread");
    let flag = CancelFlag::default();
    flag.cancel();
    let ended = decompose(&sequence, &options(3), &Exec::new(&pool, &flag)).expect_err("cancelled");
    assert!(matches!(ended, DecompositionError::Cancelled(_)));
}

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
