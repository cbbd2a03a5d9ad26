//! Laws of meshes: welding, adjacency, measures, the inspection report, winding numbers.

use glam::DVec3;
use pliant::graph::WindingTree;
use pliant::mesh::{Adjacency, Components, Mesh, NONE, Weld, inspect};
use pliant::pool::Pool;
use proptest::prelude::*;
use shapes::Shape;

use crate::support::shapes;

/// Random triangles over few points on a coarse grid, so that coincidences, repeats and collapsed faces are common.
fn soups() -> impl Strategy<Value = (Vec<DVec3>, Vec<[u32; 3]>)> {
    (3usize..40).prop_flat_map(|vertices| {
        let point = prop::array::uniform3(-3i32..4).prop_map(|p| DVec3::from_array(p.map(|c| f64::from(c) * 0.25)));
        let index = 0..vertices as u32;
        let face = [index.clone(), index.clone(), index];
        (
            prop::collection::vec(point, vertices),
            prop::collection::vec(face, 0..60),
        )
    })
}

fn welds() -> impl Strategy<Value = Weld> {
    prop_oneof![
        Just(Weld::Exact),
        Just(Weld::Rounding),
        (0.0..1.0f64).prop_map(Weld::Tolerance)
    ]
}

proptest! {
    #[test]
    fn weld_maps_fit_together(soup in soups(), weld in welds()) {
        let (positions, triangles) = soup;
        let Ok(mesh) = Mesh::build(&positions, &triangles, weld) else { return Ok(()) };
        let tolerance = match weld { Weld::Exact | Weld::Rounding => 0.0, Weld::Tolerance(t) => t };
        let mut highest = None;
        for (render, &solver) in mesh.solver_from_render.iter().enumerate() {
            if solver == NONE {
                continue;
            }
            prop_assert!(mesh.render_vertices_of(solver).contains(&(render as u32)));
            prop_assert!(mesh.positions[solver as usize].distance(positions[render]) <= tolerance * (1.0 + 1e-12));
            // Numbered by first appearance.
            prop_assert!(highest.map_or(solver == 0, |h| solver <= h + 1));
            highest = highest.max(Some(solver));
        }
        let listed: usize = (0..mesh.positions.len() as u32).map(|s| mesh.render_vertices_of(s).len()).sum();
        prop_assert_eq!(listed, mesh.solver_from_render.iter().filter(|&&s| s != NONE).count());
        // Each input face is kept, collapsed or repeated, and a kept one has the welded corners of its source.
        let sorted = |list: &[u32]| list.windows(2).all(|w| w[0] < w[1]);
        prop_assert!(sorted(&mesh.source_triangle) && sorted(&mesh.collapsed_triangles));
        prop_assert_eq!(
            mesh.triangles.len() + mesh.collapsed_triangles.len() + mesh.duplicate_triangles.len(),
            triangles.len()
        );
        for (t, &source) in mesh.triangles.iter().zip(&mesh.source_triangle) {
            prop_assert_eq!(*t, triangles[source as usize].map(|v| mesh.solver_from_render[v as usize]));
            prop_assert!(t[0] != t[1] && t[1] != t[2] && t[2] != t[0]);
        }
    }

    #[test]
    fn welding_twice_is_welding_once(soup in soups(), weld in welds()) {
        let (positions, triangles) = soup;
        let Ok(once) = Mesh::build(&positions, &triangles, weld) else { return Ok(()) };
        let twice = Mesh::build(&once.positions, &once.triangles, weld).expect("a clean mesh stays one");
        prop_assert_eq!(&twice.positions, &once.positions);
        prop_assert_eq!(&twice.triangles, &once.triangles);
        prop_assert!(twice.solver_from_render.iter().zip(0u32..).all(|(&s, v)| s == v));
    }

    #[test]
    fn adjacency_counts_every_face_and_edge(soup in soups()) {
        let (positions, triangles) = soup;
        let Ok(mesh) = Mesh::build(&positions, &triangles, Weld::Exact) else { return Ok(()) };
        let n = mesh.positions.len();
        let a = Adjacency::build(n, &mesh.triangles);
        prop_assert_eq!(a.edges.iter().map(|e| e.faces() as usize).sum::<usize>(), 3 * mesh.triangles.len());
        prop_assert!(a.edges.windows(2).all(|w| w[0].vertices < w[1].vertices));
        for v in 0..n as u32 {
            prop_assert!(!a.faces.of(v).is_empty());
            prop_assert!(a.faces.of(v).iter().all(|&f| mesh.triangles[f as usize].contains(&v)));
            let row = a.neighbours.of(v);
            prop_assert!(row.windows(2).all(|w| w[0] < w[1]) && !row.contains(&v));
            prop_assert!(row.iter().all(|&w| a.neighbours.of(w).contains(&v)));
        }
        let parts = Components::of_triangles(n, &mesh.triangles);
        prop_assert!(a.edges.iter().all(|e| parts.of_vertex[e.vertices[0] as usize] == parts.of_vertex[e.vertices[1] as usize]));
        let report = inspect(&mesh, &a);
        prop_assert_eq!(report.parts.iter().map(|p| p.triangles).sum::<usize>(), mesh.triangles.len());
        prop_assert_eq!(report.boundary_loops.iter().map(|l| l.edges).sum::<usize>(), report.boundary_edges);
        let area: f64 = report.parts.iter().map(|p| p.area).sum();
        prop_assert!((area - report.area).abs() <= 1e-12 * report.area);
    }
}

#[test]
fn reports_of_known_shapes() {
    let (p, f) = shapes::torus(40, 20, 2.0, 0.5);
    let r = shapes::report(&p, &f);
    assert!(
        r.closed && r.warnings.is_empty() && r.parts.len() == 1,
        "{:?}",
        r.warnings
    );
    let exact = 2.0 * std::f64::consts::PI.powi(2) * 2.0 * 0.25;
    assert!(
        (r.volume / exact - 1.0).abs() < 0.03,
        "volume {} of a torus of {exact}",
        r.volume
    );

    let (p, f) = shapes::sheet(10, 6);
    let r = shapes::report(&p, &f);
    assert_eq!(
        (r.closed, r.boundary_loops.len(), r.boundary_loops[0].edges),
        (false, 1, 32)
    );
    assert!((r.boundary_loops[0].length - 2.0 * (10.0 + 6.0)).abs() < 1e-9);
    assert!((r.area - 60.0).abs() < 1e-9);

    let (p, f) = shapes::both(shapes::sphere(2, 1.0), shapes::sphere(2, 0.5));
    let r = shapes::report(&p, &f);
    assert_eq!((r.parts.len(), r.closed), (2, true));
    assert!((r.parts[0].volume / r.parts[1].volume - 8.0).abs() < 1e-9);
}

#[test]
fn a_shell_with_shading_seams_is_closed_once_welded() {
    // A cube as formats store it: four render vertices for each side.
    let (p, f) = shapes::cube(1);
    let split: Vec<DVec3> = f.iter().flatten().map(|&v| p[v as usize]).collect();
    let faces: Vec<[u32; 3]> = (0..f.len() as u32).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
    let r = shapes::report(&split, &faces);
    assert_eq!(
        (r.render_vertices, r.vertices, r.coincident_vertices, r.closed),
        (36, 8, 28, true)
    );
    assert!((r.volume - 8.0).abs() < 1e-12);
}

/// Random places around a shape, some of them close to its surface.
fn places(shape: &Shape, count: usize) -> Vec<DVec3> {
    let mut state = 11u64;
    let mut next = || {
        state = state
            .wrapping_mul(6364136223846793005)
            .wrapping_add(1442695040888963407);
        (state >> 33) as f64 / (1u64 << 31) as f64
    };
    (0..count)
        .map(|i| {
            let vertex = shape.0[(next() * shape.0.len() as f64) as usize];
            let near = DVec3::new(next(), next(), next()) - DVec3::splat(0.5);
            if i % 2 == 0 {
                vertex * (2.0 * next()) + near * 0.01
            } else {
                vertex + near * 0.3
            }
        })
        .collect()
}

#[test]
fn winding_numbers_are_one_inside_zero_outside_and_equal_the_sum_over_all_faces() {
    let torus = shapes::torus(60, 30, 2.0, 0.6);
    let open = {
        let (p, mut f) = shapes::sphere(4, 1.0);
        f.truncate(f.len() * 5 / 8);
        (p, f)
    };
    let closed = [torus, shapes::sphere(4, 3.0), shapes::inside_out(shapes::cube(4))];
    for (shape, is_closed) in closed.iter().map(|s| (s, true)).chain([(&open, false)]) {
        let tree = WindingTree::build(&shape.0, &shape.1, &Pool::new(2).expect("threads"));
        let mut seen = [0; 3];
        for q in places(shape, 400) {
            let (fast, exact) = (tree.winding_number(q), shapes::winding_by_sum(shape, q));
            assert!(
                (fast - exact).abs() < 0.01,
                "{fast} by the tree, {exact} by the sum at {q}"
            );
            if is_closed {
                assert!((exact - exact.round()).abs() < 1e-6, "whole at {q}");
                seen[(exact.round() + 1.0) as usize] += 1;
            }
            assert_eq!(tree.contains(q), tree.winding_number(q).abs() > 0.5, "at {q}");
        }
        if is_closed {
            assert!(seen[1] > 50 && seen[0] + seen[2] > 50, "places on both sides: {seen:?}");
        }
    }
}
