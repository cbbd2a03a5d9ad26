//! Laws of winding numbers.

use glam::DVec3;
use pliant::graph::WindingTree;
use pliant::pool::Pool;
use shapes::Shape;

use crate::support::shapes;

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
