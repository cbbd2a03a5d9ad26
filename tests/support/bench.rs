//! A bench with a generated shape, and short ways to say handles and poses.

use super::messages::DeformerMessages;
use super::shapes::obj_text;
use glam::DVec3;
use pliant::asset::{FileSet, shapes};
use pliant::engine::{Deformer, DeformerLimits, ModelShape, SolveMode, SolveSettings};
use pliant::exec::Exec;
use pliant::pool::Pool;
use pliant::progress::Silent;
use pliant::wire::{DeformOptions, Error, open_options, pb};

pub type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

pub fn pool(threads: usize) -> Pool {
    Pool::new(threads).expect("threads start")
}

pub fn obj(shape: &Shape) -> FileSet {
    FileSet::single("shape.obj", obj_text(shape))
}

pub fn bench_with(shape: &Shape, create: &pb::CreateOptions, pool: &Pool) -> Deformer {
    Deformer::open(
        obj(shape),
        &open_options(create).expect("valid options"),
        &DeformerLimits::default(),
        &Exec::new(pool, &Silent),
    )
    .expect("the shape opens")
}

pub fn bench(shape: &Shape) -> Deformer {
    bench_with(shape, &pb::CreateOptions::default(), &pool(2))
}

pub fn below(offset: f64) -> pb::Region {
    half_space([0.0, 0.0, -1.0], -offset)
}

pub fn above(offset: f64) -> pb::Region {
    half_space([0.0, 0.0, 1.0], offset)
}

pub fn half_space(normal: [f64; 3], offset: f64) -> pb::Region {
    let normal = normal.to_vec();
    region(pb::region::Region::HalfSpace(pb::region::HalfSpace { normal, offset }))
}

pub fn ball(center: [f64; 3], radius: f64) -> pb::Region {
    let center = center.to_vec();
    region(pb::region::Region::Sphere(pb::region::Sphere { center, radius }))
}

pub fn block(min: [f64; 3], max: [f64; 3]) -> pb::Region {
    let (min, max) = (min.to_vec(), max.to_vec());
    region(pb::region::Region::Box(pb::region::Box { min, max }))
}

pub fn region(kind: pb::region::Region) -> pb::Region {
    pb::Region { region: Some(kind) }
}

pub fn handle(id: &str, region: pb::Region) -> pb::Handle {
    pb::Handle {
        id: id.into(),
        region: Some(region),
        ..Default::default()
    }
}

pub fn soft(id: &str, region: pb::Region, stiffness: f64) -> pb::Handle {
    pb::Handle {
        stiffness: Some(stiffness),
        ..handle(id, region)
    }
}

/// Handles at both ends of the bar.
pub fn ends() -> Vec<pb::Handle> {
    vec![handle("base", below(0.25)), handle("top", above(3.75))]
}

pub fn try_set(bench: &mut Deformer, handles: Vec<pb::Handle>) -> Result<(), Error> {
    let request = pb::SetHandlesRequest {
        handles,
        ..Default::default()
    };
    bench.set_handles_message(&request, &Exec::new(&pool(2), &Silent))
}

pub fn set(bench: &mut Deformer, handles: Vec<pb::Handle>) {
    try_set(bench, handles).expect("the handles fit");
}

pub fn set_all(bench: &mut Deformer, request: &pb::SetHandlesRequest) {
    let exec_pool = pool(2);
    let done = bench.set_handles_message(request, &Exec::new(&exec_pool, &Silent));
    done.expect("the handles fit");
}

/// Options of a model without nodes inside.
pub fn surface_alone() -> pb::CreateOptions {
    pb::CreateOptions {
        volume_graph: Some(pb::create_options::VolumeGraph {
            mode: pb::create_options::volume_graph::Mode::Off.into(),
            ..Default::default()
        }),
        ..Default::default()
    }
}

pub fn settings(tolerance: f64) -> SolveSettings {
    DeformOptions::check(
        &pb::Options {
            tolerance,
            // The paper's two passes.
            refine: Some(0),
            ..Default::default()
        },
        "options",
        8,
    )
    .expect("valid options")
    .solve
}

pub fn pose(entries: &[(&str, pb::HandlePose)]) -> pb::Pose {
    let entry = |(id, pose): &(&str, pb::HandlePose)| pb::pose::Entry {
        id: (*id).into(),
        pose: Some(pose.clone()),
    };
    pb::Pose {
        handles: entries.iter().map(entry).collect(),
        ..Default::default()
    }
}

pub fn try_solve(bench: &mut Deformer, pose: &pb::Pose, tolerance: f64, threads: usize) -> Result<ModelShape, Error> {
    let poses = bench.change_poses_message(&bench.initial_poses(), pose)?;
    let pool = pool(threads);
    let (exec, mode) = (Exec::new(&pool, &Silent), SolveMode::Commit);
    bench.solve(&poses, &settings(tolerance), mode, &exec, &mut |_| true)
}

pub fn solve(bench: &mut Deformer, entries: &[(&str, pb::HandlePose)], tolerance: f64) -> ModelShape {
    try_solve(bench, &pose(entries), tolerance, 2).expect("the pose solves")
}

pub fn turn(vector: DVec3, pivot: DVec3) -> pb::HandlePose {
    pb::HandlePose {
        rotation_vector: vector.to_array().to_vec(),
        pivot: pivot.to_array().to_vec(),
        ..Default::default()
    }
}

pub fn shift(by: DVec3) -> pb::HandlePose {
    pb::HandlePose {
        translation: by.to_array().to_vec(),
        ..Default::default()
    }
}

pub fn largest_distance(a: &[DVec3], b: &[DVec3]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
}

/// A bar along z, 4 long and 1 wide.
pub fn bar() -> Shape {
    let (positions, triangles) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 4.0), [8, 8, 32]);
    (
        positions.iter().map(|p| *p - DVec3::new(0.5, 0.5, 0.0)).collect(),
        triangles,
    )
}

pub fn bent_bar() -> Deformer {
    let mut bench = bench(&bar());
    set(&mut bench, ends());
    bench
}
