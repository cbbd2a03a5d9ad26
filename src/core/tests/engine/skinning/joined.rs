//! Fitted weights of a mesh: neighbours get weights that are alike, and frames are played as well.

use glam::{DQuat, DVec3};
use pliant_core::asset::shapes;
use pliant_core::exec::Exec;
use pliant_core::motion::BoneInfluences;
use pliant_core::motion::decomposition::{
    DecompositionOptions, ShapeSequence, SkinDecomposition, decompose, fit_weights,
};
use pliant_core::motion::rig::RigidMotion;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

const FRAMES: usize = 12;

/// A bar that bends in the middle, and five bones: one half, and four that move the other half nearly alike, as those of a hand that
/// stays closed.
fn bending_bar() -> (Vec<DVec3>, Vec<[u32; 3]>, Vec<Vec<RigidMotion>>) {
    let (rest, triangles) = shapes::box_with_cells(DVec3::new(6.0, 1.0, 1.0), [36, 6, 6]);
    let middle = DVec3::new(3.0, 0.5, 0.5);
    let of_frame = |frame: usize| {
        let angle = 0.08 * frame as f64;
        let bone = |k: usize| RigidMotion {
            rotation: DQuat::from_rotation_z(if k == 0 { 0.0 } else { angle * (1.0 + 1e-3 * k as f64) }),
            from: middle,
            to: middle,
        };
        (0..5).map(bone).collect()
    };
    (rest, triangles, (0..FRAMES).map(of_frame).collect())
}

/// The bar in its frames, with shakes of a thousandth as a solver leaves them.
fn sequence_of(rest: &[DVec3], motions: &[Vec<RigidMotion>]) -> ShapeSequence {
    let mut sequence = ShapeSequence::new(rest).expect("a shape");
    for (frame, bones) in motions.iter().enumerate() {
        let place = |(v, p): (usize, &DVec3)| {
            let share = ((p.x - 2.4) / 1.2).clamp(0.0, 1.0);
            let shake = |k: usize| (((v * 7919 + frame * 104_729 + k * 1_299_709) % 1000) as f64 - 500.0) * 4e-6;
            bones[0].place(*p).lerp(bones[1 + v % 4].place(*p), share) + DVec3::new(shake(0), shake(1), shake(2))
        };
        let places: Vec<DVec3> = rest.iter().enumerate().map(place).collect();
        sequence.push(&places).expect("a frame");
    }
    sequence
}

/// Edges across which a weight changes by more than a half.
fn jumps(triangles: &[[u32; 3]], influences: &[BoneInfluences]) -> usize {
    let weight = |v: u32, bone: usize| {
        let own = influences[v as usize].iter().find(|own| own.0 == bone);
        own.map_or(0.0, |own| own.1)
    };
    let bones = influences
        .iter()
        .flat_map(|own| own.iter().map(|o| o.0))
        .max()
        .unwrap_or(0);
    let jumps = |a: u32, b: u32| (0..=bones).any(|bone| (weight(a, bone) - weight(b, bone)).abs() > 0.5);
    let edges = triangles
        .iter()
        .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])]);
    edges.filter(|(a, b)| a < b && jumps(*a, *b)).count()
}

#[test]
fn weights_do_not_jump_between_bones_that_move_alike() {
    let (rest, triangles, motions) = bending_bar();
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut sequence = sequence_of(&rest, &motions);
    let given = |sequence: &ShapeSequence| fit_weights(sequence, &motions, 4, &exec).expect("weights");
    let found = |sequence: &ShapeSequence| {
        let options = DecompositionOptions {
            bones: 6,
            iterations: 6,
            ..DecompositionOptions::default()
        };
        decompose(sequence, &options, &exec).expect("a skin")
    };
    let apart = [given(&sequence), found(&sequence)];
    sequence.join(&triangles);
    let joined = [given(&sequence), found(&sequence)];
    assert!(
        jumps(&triangles, &apart[0].influences) > 100,
        "the fit alone says nothing of neighbours"
    );
    for (apart, joined) in apart.iter().zip(&joined) {
        assert_eq!(jumps(&triangles, &joined.influences), 0);
        assert!(joined.rms <= 1.03 * apart.rms, "{} against {}", joined.rms, apart.rms);
        assert_weights_hold(joined);
    }
}

fn assert_weights_hold(skin: &SkinDecomposition) {
    for own in &skin.influences {
        assert!((own.weights.iter().sum::<f64>() - 1.0).abs() < 1e-12 && own.iter().count() <= 4);
    }
}

#[test]
fn threads_change_no_bit_of_joined_weights() {
    let (rest, triangles, motions) = bending_bar();
    let mut sequence = sequence_of(&rest, &motions);
    sequence.join(&triangles);
    let weights = |threads: usize| {
        let pool = Pool::new(threads).expect("threads");
        fit_weights(&sequence, &motions, 4, &Exec::new(&pool, &Silent)).expect("weights")
    };
    assert_eq!(weights(1), weights(3));
}
