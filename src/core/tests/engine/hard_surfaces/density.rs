//! How finely a part is divided does not decide where it goes.

use super::models::{LongSide, data_models, open_model, open_shape, open_surface};
use glam::DVec3;
use pliant_core::asset::shapes;
use pliant_core::edit::SubdivisionScheme;
use pliant_core::engine::{
    Deformer, Edit, EditCommand, EditedShape, Handle, HandlePose, Quality, Region, SolveMode, SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::graph::EdgeWeights;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;
use std::f64::consts::FRAC_PI_4;

/// By how much vertices go elsewhere when the triangles of one half are cut into four, over the largest displacement. The top
/// turns about the middle of what is held, whatever vertices there are. The ends are held by lists of vertices: a finer half has
/// vertices nearer to the border of a half-space, and a half-space holds those as well.
fn difference_of_density(deformer: &mut Deformer, exec: &Exec<'_>) -> Option<f64> {
    let rest = deformer.rest().clone();
    let side = LongSide::of(&rest);
    let listed = side.ends().map(|handle| list_vertices(handle, &rest));
    deformer.set_handles(listed, exec).ok()?;
    let pose = HandlePose {
        pivot: Some(side.middle_of_top(&rest)),
        ..side.turn(FRAC_PI_4)
    };
    let poses = deformer.change_poses(&deformer.initial_poses(), [("top", pose)]).ok()?;
    let settings = SolveSettings::from(Quality {
        refine: Some(0),
        tolerance: Some(1e-8),
        ..Default::default()
    });
    let before = deformer
        .solve(&poses, &settings, SolveMode::Commit, exec, &mut |_| true)
        .ok()?;
    let farthest = rest
        .iter()
        .zip(before.positions.iter())
        .map(|(p, q)| p.distance(*q))
        .fold(0.0, f64::max);
    let across = (side.axis + 1) % 3;
    let edit = Edit::Subdivide {
        region: Some(Region::half_space(
            DVec3::AXES[across],
            side.middle_of_top(&rest)[across],
        )),
        scheme: SubdivisionScheme::Midpoint,
        creases: Default::default(),
    };
    let command = EditCommand {
        edit: &edit,
        on: EditedShape::Rest,
        shape: &before,
        poses: &poses,
        settings: Some(&settings),
    };
    let after = deformer.edit(&command, exec).ok()?;
    let mut worst = 0.0f64;
    for run in &after.report.kept {
        let pairs = before.positions[run.was as usize..][..run.count as usize]
            .iter()
            .zip(&after.shape.positions[run.now as usize..]);
        worst = pairs.map(|(p, q)| p.distance(*q)).fold(worst, f64::max);
    }
    Some(worst / farthest)
}

/// A handle of a half-space as one of the vertices that it holds.
fn list_vertices(handle: Handle, rest: &[DVec3]) -> Handle {
    let Region::HalfSpace(plane) = &handle.region else {
        return handle;
    };
    let (normal, point) = plane.unit_normal_and_point();
    let held = (0..).zip(rest).filter(|(_, p)| (**p - point).dot(normal) >= 0.0);
    Handle {
        region: Region::Vertices {
            indices: held.map(|(vertex, _)| vertex).collect(),
            ranges: Vec::new(),
        },
        ..handle
    }
}

/// Shapes that are about as finely divided everywhere: name, shape.
fn even_shapes() -> Vec<(&'static str, shapes::Shape)> {
    let bar = |n: usize| shapes::box_with_cells(DVec3::new(1.0, 1.0, 6.0), [n, n, 6 * n + 1]);
    vec![
        ("bar of 10", bar(10)),
        ("bar of 16", bar(16)),
        ("torus of 60 by 20", shapes::torus(1.0, 0.3, 60, 20)),
        ("torus of 120 by 48", shapes::torus(1.0, 0.4, 120, 48)),
        ("sphere of 2562", shapes::icosphere(1.0, 4)),
        ("sphere of 10242", shapes::icosphere(1.0, 5)),
        ("cylinder of 60 by 50", shapes::cylinder(0.5, 3.0, 60, 50, false)),
    ]
}

/// By the paper's two passes, as all here.
#[test]
fn how_finely_half_of_a_surface_is_divided_does_not_decide_where_vertices_go() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    // Cotangents show where a triangle beside the finer half was cut in two, and uniform weights do not.
    for (weights, most) in [(EdgeWeights::Uniform, 0.01), (EdgeWeights::Cotangent, 0.012)] {
        for (name, (positions, triangles)) in even_shapes() {
            let mut deformer = open_surface(&positions, &triangles, weights, &exec);
            let difference = difference_of_density(&mut deformer, &exec).expect("a shape can be divided");
            assert!(difference < most, "{name}: {difference}");
        }
    }
}

/// With an inside it is more than with a surface alone: each side of a prism between surface and shell has one diagonal, which
/// leans to one side, and a finer surface gets a finer lattice. Both are less the finer the shape is; the bounds are what the
/// coarsest of these come to.
#[test]
fn how_finely_half_of_a_solid_is_divided_decides_little() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut sum = 0.0;
    for (name, (positions, triangles)) in even_shapes() {
        let mut deformer = open_shape(&positions, &triangles, &exec);
        let difference = difference_of_density(&mut deformer, &exec).expect("a shape can be divided");
        println!("{name}: {difference:.4}");
        assert!(difference < 0.09, "{name}: {difference}");
        sum += difference;
    }
    let mean = sum / even_shapes().len() as f64;
    assert!(mean < 0.045, "{mean}");
}

#[test]
fn how_finely_half_of_a_closed_model_is_divided_decides_little_on_nine_in_ten() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut found = Vec::new();
    for path in data_models("density of real models") {
        let Some(mut deformer) = open_model(&path, &exec) else {
            continue;
        };
        let rest = deformer.rest().clone();
        if !(500..20_000).contains(&rest.len()) || deformer.quality(&rest, &pool).open_surface {
            continue;
        }
        if let Some(difference) = difference_of_density(&mut deformer, &exec) {
            found.push((difference, path));
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let Some(last) = found.len().checked_sub(1) else { return };
    let at = |share: f64| found[(last as f64 * share).round() as usize].0;
    println!("median {:.4}, nine in ten below {:.4}", at(0.5), at(0.9));
    assert!(at(0.5) < 0.05, "{found:?}");
    assert!(at(0.9) < 0.1, "{found:?}");
}
