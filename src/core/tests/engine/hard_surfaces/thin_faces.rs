//! Needles and caps do not open, and how finely a part is divided does not decide where it goes.

use super::models::{LongSide, data_models, open_model, open_shape};
use glam::DVec3;
use pliant_core::asset::shapes;
use pliant_core::deform::NeedlesAndCaps;
use pliant_core::engine::{Deformer, HandlePoses, ModelShape, SolveMode, SolveSettings};
use pliant_core::exec::Exec;
use pliant_core::mesh::{Mesh, Weld};
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use std::f64::consts::FRAC_PI_4;

fn solve(deformer: &mut Deformer, poses: &HandlePoses, exec: &Exec<'_>) -> ModelShape {
    let settings = SolveSettings::default();
    let solved = deformer.solve(poses, &settings, SolveMode::Commit, exec, &mut |_| true);
    solved.expect("the pose solves")
}

/// The bar with every tenth face between its ends split: at a point beside one of its corners, which makes needles, and at one just off its
/// longest edge, which makes caps.
fn bar_with_thin_faces(off: f64) -> shapes::Shape {
    let (mut positions, faces) = shapes::box_with_cells(DVec3::new(1.0, 1.0, 6.0), [5, 5, 30]);
    let mut triangles = Vec::new();
    for (k, t) in faces.into_iter().enumerate() {
        let p = t.map(|v| positions[v as usize]);
        let middle = (p[0] + p[1] + p[2]) / 3.0;
        let between = p.iter().all(|p| p.z > 1.3 && p.z < 4.7);
        let place = match k % 10 {
            0 if between => p[0].lerp(middle, off),
            5 if between => {
                let longest = (0..3).max_by(|&i, &j| {
                    let side = |k: usize| p[k].distance(p[(k + 1) % 3]);
                    side(i).total_cmp(&side(j))
                });
                let i = longest.expect("three sides");
                p[i].lerp(p[(i + 1) % 3], 0.4).lerp(middle, off)
            }
            _ => {
                triangles.push(t);
                continue;
            }
        };
        let m = positions.len() as u32;
        positions.push(place);
        triangles.extend([[t[0], t[1], m], [t[1], t[2], m], [t[2], t[0], m]]);
    }
    (positions, triangles)
}

#[test]
fn thin_faces_stay_thin_in_a_bend() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    for off in [0.05, 1e-3, 1e-6] {
        let (positions, triangles) = bar_with_thin_faces(off);
        let mut deformer = open_shape(&positions, &triangles, &exec);
        let side = LongSide::of(&positions);
        side.hold_ends(&mut deformer, &exec).expect("handles");
        let poses = deformer
            .change_poses(&deformer.initial_poses(), [("top", side.turn(0.6))])
            .expect("a pose");
        let shape = solve(&mut deformer, &poses, &exec);
        let quality = deformer.quality(&shape.positions, &pool);
        assert!(quality.max_stretch < 4.0, "{off}: {quality:?}");
        assert_eq!(quality.flipped_triangles, 0, "{off}: {quality:?}");
        // What handles hold is where they say, however thin the faces there are.
        let misplaced = deformer
            .constraint_error(&shape.positions, &poses)
            .expect("poses of these handles");
        assert!(misplaced < 1e-9, "{off}: {misplaced}");
    }
}

#[test]
fn even_meshes_have_no_thin_faces() {
    let even = [
        shapes::box_with_cells(DVec3::new(1.0, 2.0, 3.0), [4, 8, 12]),
        shapes::icosphere(1.0, 4),
        shapes::torus(1.0, 0.3, 60, 20),
        shapes::cylinder(0.5, 3.0, 24, 20, false),
    ];
    let pool = Pool::new(2).expect("threads");
    for (positions, triangles) in even {
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a mesh");
        assert!(NeedlesAndCaps::find(&mesh, &pool).is_empty());
    }
    let (positions, triangles) = bar_with_thin_faces(1e-3);
    let thin = Mesh::build(&positions, &triangles, Weld::Exact).expect("a mesh");
    assert!(!NeedlesAndCaps::find(&thin, &pool).is_empty());
}

#[test]
fn faces_neither_open_nor_turn_over_where_handles_do_not_force_it_on_nine_models_in_ten() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (mut models, mut bad) = (0, Vec::new());
    for path in data_models("stretch and flips of real models") {
        let Some(mut deformer) = open_model(&path, &exec) else {
            continue;
        };
        // A handful of faces shows nothing, and the largest ones take their time.
        if !(100..60_000).contains(&deformer.rest().len()) {
            continue;
        }
        let side = LongSide::of(deformer.rest());
        if side.hold_ends(&mut deformer, &exec).is_err() {
            continue;
        }
        let poses = deformer
            .change_poses(&deformer.initial_poses(), [("top", side.turn(FRAC_PI_4))])
            .expect("a pose");
        let shape = solve(&mut deformer, &poses, &exec);
        let stretch = deformer.quality(&shape.positions, &pool).max_stretch;
        let flips = side.free_flips(&deformer, &shape.positions);
        models += 1;
        if stretch > 10.0 || flips > 0 {
            bad.push(format!("{}: stretch {stretch:.1}, {flips} flips", path.display()));
        }
    }
    println!("{} of {models} models\n{}", bad.len(), bad.join("\n"));
    assert!(
        bad.len() * 10 <= models,
        "{} of {models}:\n{}",
        bad.len(),
        bad.join("\n")
    );
}
