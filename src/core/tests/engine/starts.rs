//! Poses that go on from the shape of others: they stay on its side, and depend on nothing else.

use glam::DVec3;
use pliant_core::asset::{FileSet, shapes};
use pliant_core::engine::{
    Deformer, DeformerLimits, Error, Handle, HandlePose, ModelShape, OpenOptions, PoseChain, PoseRecipe, Region,
    SolveMode, SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use pliant_core::reference::Method;

/// A tube that is held at both ends.
fn tube(exec: &Exec<'_>) -> Deformer {
    let mut text = String::new();
    let (points, triangles) = shapes::cylinder(0.3, 4.0, 12, 24, true);
    for p in &points {
        text += &format!("v {} {} {}\n", p.x, p.y, p.z);
    }
    for t in &triangles {
        let [a, b, c] = t.map(|v| v + 1);
        text += &format!("f {a} {b} {c}\n");
    }
    let (file, limits) = (FileSet::single("tube.obj", text), DeformerLimits::default());
    let mut deformer = Deformer::open(file, &OpenOptions::default(), &limits, exec).expect("a model");
    let low = Handle::new("low", Region::half_space([0.0, 0.0, -1.0], -0.3));
    let high = Handle::new("high", Region::half_space([0.0, 0.0, 1.0], 3.7));
    deformer.set_handles([low, high], exec).expect("right handles");
    deformer
}

/// The upper end turned about y, and near the lower one, so that the tube bends to the side.
fn bent(deformer: &Deformer, degrees: f64) -> PoseRecipe {
    let pose = HandlePose {
        translation: Some(DVec3::new(0.0, 0.0, -1.0)),
        ..HandlePose::rotation([0.0, degrees.to_radians(), 0.0])
    };
    let poses = deformer.change_poses(&deformer.initial_poses(), [("high", pose)]);
    PoseRecipe {
        poses: poses.expect("poses"),
        settings: SolveSettings::default(),
    }
}

fn solve(
    deformer: &mut Deformer,
    starts: &[PoseRecipe],
    pose: &PoseRecipe,
    mode: SolveMode,
    exec: &Exec<'_>,
) -> ModelShape {
    let chain = PoseChain {
        starts: starts.to_vec(),
        pose: pose.clone(),
    };
    let solved = deformer.solve_from(&chain, mode, exec, &mut |_| true);
    solved.expect("solved")
}

/// Where the middle of the tube is across its axis.
fn side(shape: &ModelShape) -> f64 {
    shape.positions.iter().map(|p| p.x).sum::<f64>() / shape.positions.len() as f64
}

#[test]
fn a_pose_stays_on_the_side_that_it_goes_on_from() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = tube(&exec);
    let [to, over] = [170.0, -170.0].map(|degrees| bent(&deformer, degrees));
    let from_nothing = |deformer: &mut Deformer, pose| side(&solve(deformer, &[], pose, SolveMode::Commit, &exec));
    let there = from_nothing(&mut deformer, &to);
    let other = from_nothing(&mut deformer, &over);
    assert!(there * other < 0.0, "{there} and {other}");
    let stays = side(&solve(
        &mut deformer,
        std::slice::from_ref(&to),
        &over,
        SolveMode::Commit,
        &exec,
    ));
    assert!(
        stays * there > 0.0 && stays.abs() > 0.5 * there.abs(),
        "{stays} from {there}"
    );
}

#[test]
fn it_depends_on_its_starts_and_on_nothing_before_them() {
    let exec_pools = [1, 2].map(|threads| Pool::new(threads).expect("threads"));
    let mut seen = Vec::new();
    for pool in &exec_pools {
        let exec = Exec::new(pool, &Silent);
        let mut deformer = tube(&exec);
        let [a, b, c] = [60.0, 120.0, 150.0].map(|degrees| bent(&deformer, degrees));
        for before in [None, Some(SolveMode::Drag), Some(SolveMode::Commit)] {
            for mode in [SolveMode::Commit, SolveMode::Anew] {
                if let Some(before) = before {
                    solve(&mut deformer, &[], &c, before, &exec);
                }
                let shape = solve(&mut deformer, &[a.clone(), b.clone()], &c, mode, &exec);
                seen.push(shape.positions);
            }
        }
        let other = solve(&mut deformer, std::slice::from_ref(&a), &c, SolveMode::Commit, &exec);
        assert_ne!(other.positions, seen[0], "another start is another shape");
    }
    assert!(seen.windows(2).all(|pair| pair[0] == pair[1]));
}

#[test]
fn a_method_without_fits_is_refused() {
    let pool = Pool::new(1).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = tube(&exec);
    let start = bent(&deformer, 30.0);
    let mut pose = bent(&deformer, 60.0);
    pose.settings.method = Method::SpatialRbf;
    let chain = PoseChain {
        starts: vec![start],
        pose,
    };
    let solved = deformer.solve_from(&chain, SolveMode::Commit, &exec, &mut |_| true);
    assert!(matches!(solved, Err(Error::Invalid { field, .. }) if field == "options.method"));
}
