//! Graphs and systems for the tests of this module.

use crate::build::hierarchy::Hierarchy;
use crate::constrain::system::LinearSystem;
use crate::options::{BuildOptions, CoarseOperators, Constraints};
use crate::paper::hierarchy::PaperHierarchy;
use crate::testing::{BoxLattice, pool};
use pliant_exec::Exec;
use pliant_exec::progress::Silent;

/// A body-centred cubic lattice of `n` cells a side: 14 neighbours inside, as in volume graphs.
pub(crate) fn lattice(n: i32) -> BoxLattice {
    let mut points = Vec::new();
    for x in 0..2 * n {
        for y in 0..2 * n {
            for z in 0..2 * n {
                if x % 2 == y % 2 && y % 2 == z % 2 {
                    points.push([x, y, z]);
                }
            }
        }
    }
    let steps = (-2..=2i32)
        .flat_map(|x| (-2..=2i32).flat_map(move |y| (-2..=2i32).map(move |z| [x, y, z])))
        .filter(|[x, y, z]| {
            matches!(
                (x.abs(), y.abs(), z.abs()),
                (1, 1, 1) | (2, 0, 0) | (0, 2, 0) | (0, 0, 2)
            )
        });
    let steps: Vec<[i32; 3]> = steps.collect();
    joined(&points, |p| {
        steps.iter().map(|s| [p[0] + s[0], p[1] + s[1], p[2] + s[2]]).collect()
    })
}

/// A square of the triangular mesh kind, bent to half a cylinder: six neighbours inside, as in surface graphs.
pub(crate) fn sheet(n: i32) -> BoxLattice {
    let points: Vec<[i32; 3]> = (0..n).flat_map(|x| (0..n).map(move |y| [x, y, 0])).collect();
    let steps = [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [1, 1, 0], [-1, -1, 0]];
    let mut block = joined(&points, |p| {
        steps.iter().map(|s| [p[0] + s[0], p[1] + s[1], 0]).collect()
    });
    for p in &mut block.positions {
        let angle = std::f64::consts::PI * p[0] / f64::from(n);
        p[0] = f64::from(n) * libm::sin(angle);
        p[2] = f64::from(n) * libm::cos(angle);
    }
    block
}

/// Vertices in a row.
pub(crate) fn path(n: i32) -> BoxLattice {
    let points: Vec<[i32; 3]> = (0..n).map(|x| [x, 0, 0]).collect();
    joined(&points, |p| vec![[p[0] - 1, 0, 0], [p[0] + 1, 0, 0]])
}

fn joined(points: &[[i32; 3]], neighbours: impl Fn([i32; 3]) -> Vec<[i32; 3]>) -> BoxLattice {
    let mut block = BoxLattice {
        offsets: vec![0],
        neighbours: Vec::new(),
        weights: None,
        positions: points.iter().map(|p| p.map(f64::from)).collect(),
    };
    for &p in points {
        let begin = block.neighbours.len();
        let around = neighbours(p);
        let present = around.iter().filter_map(|q| points.binary_search(q).ok());
        block.neighbours.extend(present.map(|j| j as u32));
        block.neighbours[begin..].sort_unstable();
        block.offsets.push(block.neighbours.len() as u32);
    }
    block
}

/// Options with the paper's ratio of level sizes.
pub(crate) fn options(coarsest: usize) -> BuildOptions {
    BuildOptions {
        operators: CoarseOperators::Paper,
        coarsening: 0.2,
        coarsest,
        ..BuildOptions::default()
    }
}

pub(crate) fn built(
    block: &BoxLattice,
    fixed: &[bool],
    stiffness: Option<&[f64]>,
    coarsest: usize,
) -> (Hierarchy, LinearSystem) {
    let hierarchy = Hierarchy::build(&block.view(), &options(coarsest), &Exec::new(&pool(), &Silent)).unwrap();
    let system = hierarchy.constrain(&Constraints { fixed, stiffness }, &pool()).unwrap();
    (hierarchy, system)
}

/// The paper's hierarchy of a block whose first plane is fixed.
pub(crate) fn held(block: &BoxLattice, coarsest: usize) -> (Hierarchy, LinearSystem) {
    let fixed: Vec<bool> = block.positions.iter().map(|p| p[0] == 0.0).collect();
    built(block, &fixed, None, coarsest)
}

pub(crate) fn paper(system: &LinearSystem) -> &PaperHierarchy {
    system.paper.as_ref().unwrap()
}
