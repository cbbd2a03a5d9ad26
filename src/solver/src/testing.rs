//! Small graphs and hierarchies for unit tests.

use crate::build::hierarchy::Hierarchy;
use crate::constrain::system::LinearSystem;
use crate::graph::WeightedGraph;
use crate::options::{BuildOptions, Constraints};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_exec::progress::Silent;

/// A block of a cubic lattice, 26 neighbours inside.
pub(crate) struct BoxLattice {
    pub(crate) offsets: Vec<u32>,
    pub(crate) neighbours: Vec<u32>,
    pub(crate) weights: Option<Vec<f32>>,
    pub(crate) positions: Vec<[f64; 3]>,
}

impl BoxLattice {
    /// So many vertices along each side; a third of them under Miri, which takes a second for what takes a millisecond.
    pub(crate) fn new(nx: i32, ny: i32, nz: i32) -> BoxLattice {
        let [nx, ny, nz] = [nx, ny, nz].map(|n| if cfg!(miri) { (n + 2) / 3 } else { n });
        let mut block = BoxLattice {
            offsets: vec![0],
            neighbours: Vec::new(),
            weights: None,
            positions: Vec::new(),
        };
        let box_of = |i: [i32; 3], j: [i32; 3]| {
            (i[0]..j[0]).flat_map(move |x| (i[1]..j[1]).flat_map(move |y| (i[2]..j[2]).map(move |z| [x, y, z])))
        };
        let size = [nx, ny, nz];
        for here in box_of([0; 3], size) {
            block.positions.push(here.map(f64::from));
            let (mut low, mut high) = (here, here);
            for c in 0..3 {
                low[c] = (here[c] - 1).max(0);
                high[c] = (here[c] + 2).min(size[c]);
            }
            let others = box_of(low, high).filter(|there| *there != here);
            block
                .neighbours
                .extend(others.map(|[x, y, z]| ((x * ny + y) * nz + z) as u32));
            block.offsets.push(block.neighbours.len() as u32);
        }
        block
    }

    /// Weights between 1/8 and 8 that depend on the pair of ids.
    pub(crate) fn weighted(mut self) -> BoxLattice {
        let n = self.positions.len();
        let weight = |a: u32, b: u32| (1 + (a.min(b) * 31 + a.max(b) * 17) % 64) as f32 / 8.0;
        let row = |i: usize| self.offsets[i] as usize..self.offsets[i + 1] as usize;
        let weights = (0..n)
            .flat_map(|i| row(i).map(move |e| (i, e)))
            .map(|(i, e)| weight(i as u32, self.neighbours[e]));
        self.weights = Some(weights.collect());
        self
    }

    pub(crate) fn view(&self) -> WeightedGraph<'_> {
        WeightedGraph {
            offsets: &self.offsets,
            neighbours: &self.neighbours,
            weights: self.weights.as_deref(),
            positions: Some(&self.positions),
        }
    }

    pub(crate) fn hierarchy(&self, coarsest: usize) -> Hierarchy {
        let options = BuildOptions {
            coarsest,
            ..BuildOptions::default()
        };
        Hierarchy::build(&self.view(), &options, &Exec::new(&pool(), &Silent)).unwrap()
    }

    /// The first vertices, those of the plane i = 0, are fixed.
    pub(crate) fn system(&self, hierarchy: &Hierarchy) -> LinearSystem {
        let fixed: Vec<bool> = self.positions.iter().map(|p| p[0] == 0.0).collect();
        hierarchy
            .constrain(
                &Constraints {
                    fixed: &fixed,
                    stiffness: None,
                },
                &pool(),
            )
            .unwrap()
    }
}

/// One thread; two under Miri, which looks for what they do to each other.
pub(crate) fn pool() -> Pool {
    Pool::new(if cfg!(miri) { 2 } else { 1 }).unwrap()
}
