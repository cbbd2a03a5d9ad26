//! Frames of a drag that keep surfaces from crossing.

use glam::DVec3;
use pliant_core::asset::FileSet;
use pliant_core::asset::sample::body_glb;
use pliant_core::engine::{
    Contact, Deformer, DeformerLimits, Handle, HandlePose, HandleRotation, OpenOptions, Region, SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use std::sync::Arc;

/// Frames in which the elbow goes to 145 degrees, and as many back.
const STEPS: usize = 30;

fn body(exec: &Exec<'_>) -> Deformer {
    let files = FileSet::single("body.glb", body_glb());
    let mut deformer =
        Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), exec).expect("a model");
    let handles = [
        Handle::new("body", Region::half_space([-1.0, 0.0, 0.0], -0.3)),
        Handle::new("forearm", Region::half_space([1.0, 0.0, 0.0], 0.65)),
    ];
    deformer.set_handles(handles.to_vec(), exec).expect("right handles");
    deformer
}

/// The frames of a drag that bends the elbow and stretches it again.
fn frames(deformer: &mut Deformer, contact: Contact, exec: &Exec<'_>) -> Vec<Arc<Vec<DVec3>>> {
    let settings = SolveSettings {
        contact,
        ..SolveSettings::default()
    };
    let mut drag = deformer.drag(&settings);
    let steps = (0..=STEPS).chain((0..STEPS).rev());
    let frame = |k: usize| {
        let turn = DVec3::NEG_Y * (145f64.to_radians() * k as f64 / STEPS as f64);
        let pose = HandlePose {
            rotation: Some(HandleRotation::Vector(turn)),
            ..HandlePose::default()
        };
        drag.solve([("forearm", pose)], exec).expect("a frame").positions
    };
    steps.map(frame).collect()
}

const AVOIDED: Contact = Contact::Avoided { clearance: None };

#[test]
fn a_bending_elbow_hardly_crosses() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let [without, with] = [Contact::Ignored, AVOIDED].map(|contact| frames(&mut body(&exec), contact, &exec));
    let deformer = body(&exec);
    let pairs = |positions: &[DVec3]| deformer.crossing_pairs(positions, 0, &exec).expect("no cancel").new;
    let (mut before, mut after) = (0, 0);
    for (k, (without, with)) in without.iter().zip(&with).enumerate() {
        let [own, left] = [without, with].map(|positions| pairs(positions));
        assert!(left <= own, "frame {k}: {own} pairs without, {left} with");
        assert!(
            own > 0 || without == with,
            "frame {k} does not cross and has other bits"
        );
        (before, after) = (before + own, after + left);
    }
    assert!(before > 500, "{before} pairs without");
    assert!(after * 20 <= before, "{after} of {before} pairs");
}

#[test]
fn the_same_poses_have_the_same_bits_for_any_number_of_threads() {
    let all = [1, 2, 8].map(|threads| {
        let pool = Pool::new(threads).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        frames(&mut body(&exec), AVOIDED, &exec)
    });
    assert!(all.iter().all(|frames| *frames == all[0]));
}

#[test]
fn a_commit_does_not_depend_on_the_drag_before_it() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let settings = SolveSettings {
        contact: AVOIDED,
        ..SolveSettings::default()
    };
    let pose = HandlePose {
        rotation: Some(HandleRotation::Vector(DVec3::NEG_Y * 2.5)),
        ..HandlePose::default()
    };
    let shapes = [false, true].map(|drags| {
        let mut deformer = body(&exec);
        if drags {
            frames(&mut deformer, AVOIDED, &exec);
        }
        let shape = deformer.commit([("forearm", pose.clone())], &settings, &exec);
        shape.expect("a shape").positions
    });
    assert!(shapes[0] == shapes[1]);
}
