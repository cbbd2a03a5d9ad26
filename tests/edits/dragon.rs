//! A tail pulled to more than four times its length in several commits, with automatic remeshing in between.

use crate::support::bench::obj;
use crate::support::data::data_bytes;
use crate::support::messages::{DeformerMessages, message};
use glam::DVec3;
use pliant::asset::{FileSet, shapes};
use pliant::engine::{Deformer, DeformerLimits, HandlePoses, QualityReport, SolveMode};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{DeformOptions, pb};
use serde_json::json;
use std::sync::Arc;

/// Longest side over shortest height of the worst triangle that was pulled, 1.15 at best. One triangle beside the longest edges
/// comes to 27.8, where their corners are averaged with those around them.
const WORST: f64 = 28.0;

/// The same for ninety-nine of a hundred.
const MOST: f64 = 6.0;

/// Largest singular value of a triangle's Jacobian in any step.
const STRETCH: f64 = 3.0;

/// What is pulled.
struct Tail {
    files: FileSet,
    /// From the root to the tip.
    along: DVec3,
    /// Below this everything is held, above `tip` as well.
    root: f64,
    tip: f64,
    /// How often it is pulled, and to how many times its length each time.
    steps: (usize, f64),
}

/// The tail of the dinosaur of the data folder; without it, a ridged horn on a block.
fn tail() -> (Tail, &'static str) {
    if let Some(bytes) = data_bytes("meshes/arap_dino.off") {
        let tail = Tail {
            files: FileSet::single("arap_dino.off", bytes),
            along: DVec3::new(0.9, -0.05, 0.43),
            root: 0.2,
            tip: 0.55,
            steps: (8, 1.22),
        };
        return (tail, "the dinosaur's tail");
    }
    (horn(), HORN)
}

/// A ridged horn along x from 0 to 0.6.
fn horn() -> Tail {
    let (positions, faces) = shapes::cylinder(0.1, 0.6, 32, 90, true);
    let ridged = |p: DVec3| {
        let ridges = 1.0 + 0.15 * (p.z * 120.0).sin();
        DVec3::new(p.z, p.x * ridges, p.y * ridges)
    };
    let shape = (positions.into_iter().map(ridged).collect(), faces);
    Tail {
        files: obj(&shape),
        along: DVec3::X,
        root: 0.18,
        tip: 0.55,
        steps: (4, 1.48),
    }
}

/// A state of the pull.
struct Pulled {
    positions: Arc<Vec<DVec3>>,
    quality: QualityReport,
    /// The largest of any step after which it was remeshed.
    stretch: f64,
    aspects: Vec<f64>,
    triangles: usize,
}

/// Longest side over shortest height of the triangles beyond the root, rising.
fn aspects(bench: &Deformer, shape: &[DVec3], root: f64) -> Vec<f64> {
    let mut all: Vec<f64> = (bench.geometry().triangles.iter())
        .map(|t| t.map(|v| shape[v as usize]))
        .filter(|c| c.iter().all(|p| p.x > root))
        .map(|[a, b, c]| {
            let longest = a
                .distance_squared(b)
                .max(b.distance_squared(c))
                .max(c.distance_squared(a));
            longest / (b - a).cross(c - a).length()
        })
        .collect();
    all.sort_by(f64::total_cmp);
    all
}

/// Pulls step by step, remeshing after each or never.
fn pull(tail: &Tail, remesh: bool) -> Pulled {
    let pool = Pool::new(2).expect("threads");
    let mut bench = Deformer::open(
        tail.files.clone(),
        &Default::default(),
        &DeformerLimits::default(),
        &Exec::new(&pool, &Silent),
    )
    .expect("opens");
    let handles = json!({"handles": [
        {"id": "body", "region": {"halfSpace": {"normal": [-1, 0, 0], "offset": -tail.root}}},
        {"id": "tip", "region": {"halfSpace": {"normal": [1, 0, 0], "offset": tail.tip}}},
    ]});
    bench
        .set_handles_message(&message(&handles), &Exec::new(&pool, &Silent))
        .expect("the handles fit");
    let options: pb::Options = message(&json!({"tolerance": 1e-5}));
    let settings = DeformOptions::check(&options, "options", 8).expect("valid").solve;
    let start = (tail.tip - tail.root) / tail.along.x;
    let (mut length, mut poses): (f64, HandlePoses) = (start, bench.initial_poses());
    let mut stretch = 0.0f64;
    let (mut shape, mut quality) = (bench.rest_shape(), QualityReport::default());
    let (steps, factor) = tail.steps;
    for step in 0..steps {
        let by = length * (factor - 1.0);
        length += by;
        // After an edit what is seen is the rest shape.
        let shift = tail.along * if remesh { by } else { length - start };
        let pose = json!({"handles": [{"id": "tip", "pose": {"translation": shift.to_array()}}]});
        poses = bench.change_poses_message(&poses, &message(&pose)).expect("a pose");
        let solved = bench.solve(
            &poses,
            &settings,
            SolveMode::Commit,
            &Exec::new(&pool, &Silent),
            &mut |_| true,
        );
        shape = solved.expect("solved");
        quality = bench.quality(&shape, &pool);
        if !remesh {
            continue;
        }
        assert_eq!(quality.flipped_triangles, 0, "step {step}");
        stretch = stretch.max(quality.max_stretch);
        let request: pb::EditRequest = message(&json!({"remesh": {"auto": true}}));
        let outcome = bench
            .edit_message(&request, &shape, &poses, &Exec::new(&pool, &Silent))
            .expect("remeshed");
        (poses, shape) = (outcome.poses, outcome.shape);
    }
    Pulled {
        aspects: aspects(&bench, &shape, tail.root + 0.05),
        triangles: bench.geometry().triangles.len(),
        positions: shape.positions,
        stretch,
        quality,
    }
}

#[test]
fn a_tail_pulled_to_more_than_four_times_its_length_stays_well_shaped() {
    let (tail, what) = tail();
    let [with, without] = check(&tail, what);
    if what != HORN {
        // A horn's ends are fans of thin triangles, pulled or not; a tail has none.
        assert!(at(&without.aspects, 1.0) > 2.0 * at(&with.aspects, 1.0));
        assert!(at(&without.aspects, 0.99) > 1.5 * at(&with.aspects, 0.99));
    }
}

#[test]
fn so_does_a_generated_horn() {
    check(&horn(), HORN);
}

const HORN: &str = "a horn";

/// The value below which `part` of all lie.
fn at(all: &[f64], part: f64) -> f64 {
    all[((all.len() - 1) as f64 * part) as usize]
}

fn check(tail: &Tail, what: &str) -> [Pulled; 2] {
    let with = pull(tail, true);
    let without = pull(tail, false);
    for (how, p) in [("with", &with), ("without", &without)] {
        println!(
            "{what} {how} remeshing: {} triangles, {} of them pulled; longest side over height: median {:.2}, 99 of 100 {:.2}, \
             worst {:.1}; stretch of the last step {:.2}; {} flipped",
            p.triangles,
            p.aspects.len(),
            at(&p.aspects, 0.5),
            at(&p.aspects, 0.99),
            at(&p.aspects, 1.0),
            p.quality.max_stretch,
            p.quality.flipped_triangles
        );
    }
    let extent = |p: &Pulled| p.positions.iter().map(|q| q.x).fold(f64::MIN, f64::max);
    let grown = (extent(&with) - tail.root) / (tail.tip - tail.root);
    assert!(grown > 4.0, "{grown} times as long");
    assert!((extent(&with) - extent(&without)).abs() < 1e-6 * extent(&with));
    assert!(at(&with.aspects, 1.0) < WORST && at(&with.aspects, 0.99) < MOST);
    assert!(with.stretch < STRETCH, "{}", with.stretch);
    assert!(at(&without.aspects, 1.0) >= at(&with.aspects, 1.0));
    assert!(at(&without.aspects, 0.5) > 1.4 * at(&with.aspects, 0.5));
    assert!(without.quality.max_stretch > 2.0 * with.quality.max_stretch);
    [with, without]
}
