//! Refinement: rotations that are fitted to the result, and solved with again.

use crate::support::bench;
use crate::support::messages::DeformerMessages;

use bench::*;
use glam::{DMat3, DQuat, DVec3};
use pliant::asset::shapes;
use pliant::engine::{Deformer, HandlePoses, ModelShape, Recipe, SolveMode, SolveSettings, digest};
use pliant::exec::Exec;
use pliant::progress::Silent;
use pliant::wire::{DeformOptions, pb};

fn settings(refine: u32, smoothing: f64) -> SolveSettings {
    let options = pb::Options {
        tolerance: 1e-6,
        refine: Some(refine),
        rotation_smoothing: smoothing,
        ..Default::default()
    };
    DeformOptions::check(&options, "options", 8)
        .expect("valid options")
        .solve
}

fn posed(bench: &Deformer, entries: &[(&str, pb::HandlePose)]) -> HandlePoses {
    bench
        .change_poses_message(&bench.initial_poses(), &pose(entries))
        .expect("a pose of these handles")
}

fn run(bench: &mut Deformer, poses: &HandlePoses, settings: &SolveSettings, mode: SolveMode) -> ModelShape {
    bench
        .solve(poses, settings, mode, &Exec::new(&pool(2), &Silent), &mut |_| true)
        .expect("the pose solves")
}

fn refined(bench: &mut Deformer, entries: &[(&str, pb::HandlePose)], refine: u32) -> Vec<DVec3> {
    let poses = posed(bench, entries);
    run(bench, &poses, &settings(refine, 0.0), SolveMode::Commit)
        .positions
        .to_vec()
}

fn volume((_, faces): &Shape, at: &[DVec3]) -> f64 {
    let corner = |f: &[u32; 3], k: usize| at[f[k] as usize];
    faces
        .iter()
        .map(|f| corner(f, 0).dot(corner(f, 1).cross(corner(f, 2))))
        .sum::<f64>()
        / 6.0
}

/// The bar's top pulled far aside without being turned: the first pass sees no rotation at all.
#[test]
fn refinement_bends_what_is_only_moved() {
    let shape = bar();
    let aside = [("top", shift(DVec3::new(2.5, 0.0, -1.0)))];
    let mut bench = bent_bar();
    let rest = volume(&shape, &shape.0);
    let [plain, some, more] = [0, 4, 20].map(|refine| {
        let now = refined(&mut bench, &aside, refine);
        let lost = 1.0 - volume(&shape, &now) / rest;
        println!("refine {refine}: {lost:.4} of the volume lost");
        lost
    });
    assert!(plain > 0.25, "the paper's two passes shear: {plain}");
    assert!(some < 0.2 * plain && more < 0.05 * plain, "{plain} {some} {more}");
}

/// What a rod that is twisted or bent by an angle between its ends loses of its volume: with it kept, and let go.
fn volumes_lost(axis: DVec3, angle: f64) -> [f64; 2] {
    let shape = shapes::cylinder(0.5, 4.0, 32, 48, true);
    let mut bench = bench(&shape);
    set(&mut bench, vec![handle("base", below(0.3)), handle("top", above(3.7))]);
    let poses = posed(&bench, &[("top", turn(axis * angle, DVec3::new(0.0, 0.0, 2.0)))]);
    let rest = volume(&shape, &shape.0);
    [pb::options::Volume::Keep, pb::options::Volume::Free].map(|kept| {
        let options = pb::Options {
            volume: kept.into(),
            ..Default::default()
        };
        let options = DeformOptions::check(&options, "options", 8).expect("valid options");
        let now = run(&mut bench, &poses, &options.solve, SolveMode::Commit).positions;
        1.0 - volume(&shape, &now) / rest
    })
}

#[test]
fn a_twist_keeps_its_volume_unless_it_may_go() {
    for (degrees, most) in [(120.0, 0.02), (360.0, 0.08)] {
        let [kept, free] = volumes_lost(DVec3::Z, f64::to_radians(degrees));
        println!("{degrees} degrees: {kept:.4} and {free:.4} of the volume lost");
        assert!(
            kept.abs() < most && kept.abs() < 0.4 * free,
            "{degrees}: {kept} and {free}"
        );
    }
    // A gentle bend loses little, and less with it kept.
    let [kept, free] = volumes_lost(DVec3::X, 0.4);
    assert!(kept.abs() < free.abs() && free < 0.02, "{kept} and {free}");
}

/// Edges at which neighbours lie folded onto each other (their normals over 120° apart, under 90° in the rest pose), and crossing triangles.
fn folds_and_crossings(bench: &Deformer, (rest, faces): &Shape, now: &[DVec3]) -> (usize, u32) {
    let normal = |at: &[DVec3], f: &[u32; 3]| {
        let [a, b, c] = f.map(|v| at[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    };
    let mut sides: std::collections::BTreeMap<[u32; 2], Vec<&[u32; 3]>> = Default::default();
    for f in faces {
        for k in 0..3 {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            sides.entry([a.min(b), a.max(b)]).or_default().push(f);
        }
    }
    let cosine = |at: &[DVec3], pair: &[&[u32; 3]]| normal(at, pair[0]).dot(normal(at, pair[1]));
    let pairs = sides.values().filter(|faces| faces.len() == 2);
    let folds = pairs
        .filter(|pair| cosine(now, pair) < -0.5 && cosine(rest, pair) > 0.0)
        .count();
    let exec_pool = pool(2);
    let found = bench
        .measure(now, true, &Exec::new(&exec_pool, &Silent))
        .expect("no cancel");
    (folds, found.self_intersections.expect("asked for"))
}

#[test]
fn fits_that_nobody_asked_for_add_no_folds_and_no_crossings() {
    let shape = shapes::cylinder(0.5, 3.0, 40, 60, true);
    let aside = |x: f64, z: f64| shift(DVec3::new(x, 0.0, z));
    let nod = |angle: f64| turn(DVec3::X * angle, DVec3::Z * 1.5);
    let cases = [
        (0.4, aside(0.6, -0.2), true),
        (0.8, aside(0.6, -0.2), false),
        (0.4, nod(1.57), true),
        (0.6, nod(1.92), true),
    ];
    for (free, pose, must_help) in cases {
        let mut bench = bench(&shape);
        set(
            &mut bench,
            vec![
                handle("base", below(1.49 - 0.5 * free)),
                handle("top", above(1.51 + 0.5 * free)),
            ],
        );
        let poses = posed(&bench, &[("top", pose)]);
        // With what takes the strain from borders some of these poses have no faults that the watch could mend.
        for recipe in [Recipe::Unbuckled, Recipe::SmoothBorders] {
            let mut commit = |settings: SolveSettings| {
                let shape = run(&mut bench, &poses, &settings, SolveMode::Commit);
                (shape.positions.to_vec(), shape)
            };
            let default = SolveSettings {
                recipe,
                ..SolveSettings::default()
            };
            let (watched, again) = (commit(default).0, commit(default).0);
            assert_eq!(digest(&watched), digest(&again));
            let mut asked = default;
            asked.quality.refine = Some(4);
            let fitted = commit(asked).0;
            asked.quality.refine = Some(0);
            let plain = commit(asked).0;
            if recipe == Recipe::Unbuckled {
                let as_they_come = commit(SolveSettings {
                    recipe: Recipe::AsTheyCome,
                    ..default
                });
                let as_they_come = digest(&as_they_come.0);
                assert_eq!(
                    digest(&fitted),
                    as_they_come,
                    "fits that are asked for stay as they are"
                );
            }
            let [watched, fitted, plain] =
                [watched, fitted, plain].map(|now| folds_and_crossings(&bench, &shape, &now));
            println!("{free}: fitted {fitted:?}, without fits {plain:?}, by default {watched:?}");
            assert!(watched.0 <= plain.0.max(fitted.0) && watched.1 <= plain.1.max(fitted.1));
            let cost = |(folds, crossings): (usize, u32)| 4 * folds as u32 + crossings;
            assert!(cost(watched) <= cost(fitted).min(cost(plain)));
            if must_help && recipe == Recipe::Unbuckled {
                assert!(cost(watched) < cost(fitted), "{fitted:?} became {watched:?}");
            }
        }
    }
}

#[test]
fn without_refinement_nothing_but_the_two_passes_happens() {
    let mut bench = bent_bar();
    let turned = [("top", turn(DVec3::new(0.0, 0.0, 1.0), DVec3::ZERO))];
    let poses = posed(&bench, &turned);
    let plain = run(&mut bench, &poses, &settings(0, 0.0), SolveMode::Commit);
    let smooth = run(&mut bench, &poses, &settings(0, 5.0), SolveMode::Commit);
    assert_eq!(
        digest(&plain.positions),
        digest(&smooth.positions),
        "smoothing belongs to fits"
    );
    let some = run(&mut bench, &poses, &settings(1, 0.0), SolveMode::Commit);
    assert!(largest_distance(&plain.positions, &some.positions) > 1e-4);
}

/// Moving all handles together moves the model as a whole, however often rotations are fitted.
#[test]
fn a_rigid_motion_stays_a_rigid_motion() {
    let shape = bar();
    let mut bench = bent_bar();
    let vector = DVec3::new(0.4, -1.9, 1.1);
    let mut motion = turn(vector, DVec3::new(1.0, 2.0, 3.0));
    motion.translation = vec![0.3, -2.0, 0.7];
    for smoothing in [0.0, 2.0] {
        let poses = posed(&bench, &[("base", motion.clone()), ("top", motion.clone())]);
        let now = run(&mut bench, &poses, &settings(6, smoothing), SolveMode::Commit);
        let q = DQuat::from_scaled_axis(vector);
        let pivot = DVec3::new(1.0, 2.0, 3.0);
        let want: Vec<DVec3> = shape
            .0
            .iter()
            .map(|p| q * (*p - pivot) + pivot + DVec3::new(0.3, -2.0, 0.7))
            .collect();
        let off = largest_distance(&now.positions, &want);
        assert!(off < 1e-5, "smoothing {smoothing}: off by {off}");
    }
}

#[test]
fn turning_the_scene_turns_the_refined_result() {
    let shape = bar();
    let scene = DQuat::from_scaled_axis(DVec3::new(0.5, -0.8, 0.3));
    let (by, vector) = (DVec3::new(1.0, 0.4, -0.8), DVec3::new(0.6, 0.2, -0.4));
    let turned_shape: Shape = (shape.0.iter().map(|p| scene * *p).collect(), shape.1.clone());
    let solve = |shape: &Shape, q: DQuat| {
        let mut bench = bench_with(shape, &surface_alone(), &pool(2));
        let along = q * DVec3::Z;
        set(
            &mut bench,
            vec![
                handle("base", half_space((-along).to_array(), -0.3)),
                handle("top", half_space(along.to_array(), 3.7)),
            ],
        );
        let mut moved = turn(q * vector, q * DVec3::new(0.0, 0.0, 4.0));
        moved.translation = (q * by).to_array().to_vec();
        refined(&mut bench, &[("top", moved)], 5)
    };
    let plain = solve(&shape, DQuat::IDENTITY);
    let turned = solve(&turned_shape, scene);
    let off = plain
        .iter()
        .zip(&turned)
        .map(|(p, t)| (scene * *p).distance(*t))
        .fold(0.0, f64::max);
    assert!(off < 4e-5, "off by {off}");
}

/// Smoothing evens out how the bend is spread, and never turns what handles hold.
#[test]
fn smoothing_spreads_rotations_and_handles_keep_theirs() {
    let shape = bar();
    let mut bench = bent_bar();
    let moved = pb::HandlePose {
        translation: vec![2.0, 0.0, -1.2],
        ..turn(DVec3::new(0.0, 1.2, 0.0), DVec3::new(0.0, 0.0, 4.0))
    };
    let poses = posed(&bench, &[("top", moved)]);
    let bumpiness = |now: &[DVec3]| {
        // Turning from one triangle to the next, beyond that in the rest pose.
        let normal = |at: &[DVec3], f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| at[v as usize]);
            (b - a).cross(c - a).normalize()
        };
        let mut sum = 0.0;
        for pair in shape.1.chunks_exact(2) {
            let angle = |at: &[DVec3]| normal(at, &pair[0]).angle_between(normal(at, &pair[1]));
            sum += (angle(now) - angle(&shape.0)).abs();
        }
        sum
    };
    let plain = run(&mut bench, &poses, &settings(10, 0.0), SolveMode::Commit).positions;
    let smooth = run(&mut bench, &poses, &settings(10, 4.0), SolveMode::Commit).positions;
    assert!(
        bumpiness(&smooth) < bumpiness(&plain),
        "{} {}",
        bumpiness(&smooth),
        bumpiness(&plain)
    );
    let map = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(0.0, 1.2, 0.0)));
    for (p, now) in shape.0.iter().zip(smooth.iter()).filter(|(p, _)| p.z >= 3.75) {
        let want = map * (*p - DVec3::new(0.0, 0.0, 4.0)) + DVec3::new(2.0, 0.0, 2.8);
        assert!(now.distance(want) < 1e-9);
    }
}

#[test]
fn refined_commits_repeat_to_the_bit_whatever_was_dragged() {
    let mut bench = bent_bar();
    let end = [("top", shift(DVec3::new(1.5, 0.3, -0.5)))];
    let poses = posed(&bench, &end);
    let first = run(&mut bench, &poses, &settings(4, 0.5), SolveMode::Commit);
    for k in 1..6 {
        let on_the_way = posed(&bench, &[("top", shift(DVec3::new(0.4 * f64::from(k), 0.0, 0.2)))]);
        run(&mut bench, &on_the_way, &settings(2, 0.0), SolveMode::Drag);
    }
    let again = run(&mut bench, &poses, &settings(4, 0.5), SolveMode::Commit);
    assert_eq!(digest(&first.positions), digest(&again.positions));
    for threads in [1, 3] {
        let other = bench
            .solve(
                &poses,
                &settings(4, 0.5),
                SolveMode::Commit,
                &Exec::new(&pool(threads), &Silent),
                &mut |_| true,
            )
            .expect("the pose solves");
        assert_eq!(digest(&first.positions), digest(&other.positions), "{threads} threads");
    }
}

/// While dragging, each frame goes on from the rotations of the one before: frames stay near each other and near what
/// a commit makes of the last pose, and a frame that is cut short loses nothing for good.
#[test]
fn dragging_carries_refinement_on_without_pops() {
    let mut bench = bent_bar();
    let pose_at = |bench: &Deformer, t: f64| posed(bench, &[("top", shift(DVec3::new(2.0 * t, 0.0, -0.6 * t)))]);
    let mut last: Option<Vec<DVec3>> = None;
    let frames = 40;
    let step = 2.1 / f64::from(frames);
    for k in 1..=frames {
        let poses = pose_at(&bench, f64::from(k) / f64::from(frames));
        let mut cut = |now: &pliant::engine::SolveUpdate<'_>| k % 3 != 0 || now.refined == 0;
        let solved = bench
            .solve(
                &poses,
                &settings(2, 0.0),
                SolveMode::Drag,
                &Exec::new(&pool(2), &Silent),
                &mut cut,
            )
            .expect("the pose solves");
        if let Some(last) = &last {
            let jump = largest_distance(&solved.positions, last);
            assert!(jump < 3.0 * step, "frame {k} jumps by {jump}, the handle moved {step}");
        }
        last = Some(solved.positions.to_vec());
    }
    // Standing still, it settles.
    let poses = pose_at(&bench, 1.0);
    let mut jumps = Vec::new();
    for _ in 0..15 {
        let solved = run(&mut bench, &poses, &settings(2, 0.0), SolveMode::Drag);
        jumps.push(largest_distance(&solved.positions, last.as_ref().unwrap()));
        last = Some(solved.positions.to_vec());
    }
    assert!(jumps[14] < 0.01, "still moving: {jumps:?}");
    let commit = run(&mut bench, &poses, &settings(20, 0.0), SolveMode::Commit);
    let pop = largest_distance(&commit.positions, last.as_ref().unwrap());
    assert!(pop < 0.06, "the commit is {pop} away from the last frame");
}

#[test]
fn parts_and_regions_that_do_not_move_keep_their_bits() {
    let shape = bar();
    let mut bench = bench(&shape);
    let request = pb::SetHandlesRequest {
        handles: vec![handle("top", above(3.75))],
        region_of_interest: Some(above(2.0)),
        ..Default::default()
    };
    set_all(&mut bench, &request);
    for refine in [0, 6] {
        let now = refined(&mut bench, &[("top", shift(DVec3::new(1.0, 0.0, 0.3)))], refine);
        let (mut still, mut moved) = (0, 0);
        for (now, rest) in now.iter().zip(&shape.0) {
            if rest.z < 2.0 {
                assert_eq!(now.to_array().map(f64::to_bits), rest.to_array().map(f64::to_bits));
                still += 1;
            } else {
                moved += usize::from(now != rest);
            }
        }
        assert!(still > 100 && moved > 100, "{still} still, {moved} moved");
    }
}

/// Scales of the first pass stay in force: a bar whose top is twice as large keeps growing towards it.
#[test]
fn refinement_keeps_scales() {
    let shape = bar();
    let mut bench = bent_bar();
    let doubled = pb::HandlePose {
        scale: vec![2.0],
        pivot: vec![0.0, 0.0, 4.0],
        ..Default::default()
    };
    let now = refined(&mut bench, &[("top", doubled)], 5);
    let width = |low: f64, high: f64| {
        shape
            .0
            .iter()
            .zip(&now)
            .filter(|(p, _)| (low..high).contains(&p.z))
            .map(|(_, p)| p.x.abs())
            .fold(0.0, f64::max)
    };
    let (thin, middle, thick) = (width(0.5, 1.0), width(1.9, 2.1), width(3.0, 3.5));
    assert!(
        thin < middle && middle < thick && thick > 0.7,
        "{thin} {middle} {thick}"
    );
}

/// Flat, inverted and empty neighbourhoods: results stay finite and within reach.
#[test]
fn hard_poses_stay_finite() {
    let sheet = shapes::grid(1.0, 1.0, [20, 20]);
    let mut bench = bench(&sheet);
    set(
        &mut bench,
        vec![
            handle("left", half_space([-1.0, 0.0, 0.0], -0.1)),
            handle("right", half_space([1.0, 0.0, 0.0], 0.9)),
        ],
    );
    for pose in [
        shift(DVec3::new(-0.9, 0.0, 0.0)),
        shift(DVec3::new(-2.0, 0.0, 0.0)),
        turn(DVec3::new(0.0, std::f64::consts::PI, 0.0), DVec3::new(0.5, 0.5, 0.0)),
        pb::HandlePose {
            scale: vec![1e-3],
            ..Default::default()
        },
    ] {
        let now = refined(&mut bench, &[("right", pose.clone())], 30);
        assert!(now.iter().all(|p| p.is_finite() && p.length() < 5.0), "{pose:?}");
    }
}
