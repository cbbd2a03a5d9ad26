//! Scratch that solves share.

use crate::lanes::{Lanes, WideLanes};
use crate::solve::cycle::CoarseVectors;
use crate::solve::patches::AffinePatches;
use crate::solve::sweep::LaneDots;
use crate::storage::resize_untouched;

/// Vectors that a solve needs; reuse it and solves of the same size allocate next to nothing.
///
/// It belongs to no hierarchy: one workspace can serve systems of any size, one solve at a time.
#[derive(Debug, Default)]
pub struct Workspace {
    /// The solution so far, in row order.
    pub(crate) x: Vec<WideLanes>,
    pub(crate) fine: FineVectors,
    pub(crate) coarse: Vec<CoarseVectors>,
    pub(crate) patches: Vec<AffinePatches>,
    /// Reduction of the residual by each iteration of the present solve, slowest column.
    pub(crate) history: Vec<f64>,
    /// Vectors in double precision for the direct method and the fallback.
    pub(crate) wide: [Vec<WideLanes>; 3],
    /// Solves so far, to detect whether the residual of an earlier one was overwritten.
    pub(crate) solves: u64,
}

/// Single-precision vectors of the outer iteration on the finest level.
#[derive(Debug, Default)]
pub(crate) struct FineVectors {
    /// Residual.
    pub(crate) r: Vec<Lanes>,
    /// Preconditioned residual.
    pub(crate) z: Vec<Lanes>,
    /// What A z is made from, and scratch on the way there.
    pub(crate) t: Vec<Lanes>,
    /// Correction to the solution.
    pub(crate) e: Vec<Lanes>,
    /// Residual and correction before the last step. Their differences to the present ones are that step and A times
    /// it: the search direction.
    pub(crate) last_r: Vec<Lanes>,
    pub(crate) last_e: Vec<Lanes>,
    pub(crate) partials: Vec<LaneDots>,
}

impl FineVectors {
    pub(crate) fn resize(&mut self, rows: usize) {
        for v in [
            &mut self.r,
            &mut self.z,
            &mut self.t,
            &mut self.e,
            &mut self.last_r,
            &mut self.last_e,
        ] {
            resize_untouched(v, rows);
        }
    }
}

impl Workspace {
    /// Lets go of what only starts by full multigrid and solves in double precision need.
    pub fn release_start(&mut self) {
        self.patches = Vec::new();
        self.wide = Default::default();
    }

    /// Bytes held.
    pub fn byte_size(&self) -> usize {
        let f = &self.fine;
        let lanes: usize = [&f.r, &f.z, &f.t, &f.e, &f.last_r, &f.last_e]
            .iter()
            .map(|v| v.capacity())
            .sum();
        let wide = self.x.capacity() + self.wide.iter().map(Vec::capacity).sum::<usize>();
        let coarse: usize = self.coarse.iter().map(CoarseVectors::byte_size).sum();
        let patches: usize = self.patches.iter().map(AffinePatches::byte_size).sum();
        16 * (lanes + 3 * f.partials.capacity()) + 32 * wide + coarse + patches + 8 * self.history.capacity()
    }
}
