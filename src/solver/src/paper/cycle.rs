//! Algorithm 1 with γ = 1: a V-cycle on the defect equations.

use crate::lanes::{WIDTH, WideLanes};
use crate::paper::hierarchy::PaperHierarchy;
use crate::paper::restrict::{OperatorReading, correct, restrict_defect};
use crate::paper::smooth::{defect, sweep};
use crate::progress::{Cancelled, Progress, check};

/// Sweeps before and after the coarse correction (section 6).
const SWEEPS: usize = 2;

/// Vectors of one level.
#[derive(Debug, Default)]
pub(super) struct PaperVectors {
    pub(super) b: Vec<WideLanes>,
    pub(super) x: Vec<WideLanes>,
    defect: Vec<WideLanes>,
}

/// Vectors of all levels, finest first.
pub(super) fn vectors(paper: &PaperHierarchy) -> Vec<PaperVectors> {
    let vectors = |n: usize| PaperVectors {
        b: vec![[0.0; WIDTH]; n],
        x: vec![[0.0; WIDTH]; n],
        defect: vec![[0.0; WIDTH]; n],
    };
    paper.levels.iter().map(|l| vectors(l.vertices())).collect()
}

impl PaperHierarchy {
    /// One V(2,2) cycle on the original equations of level `s`: improves `vectors[0].x` for `vectors[0].b`. `vectors`
    /// begins at that level.
    pub(super) fn cycle(
        &self,
        s: usize,
        vectors: &mut [PaperVectors],
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        self.descend(s, 0, OperatorReading::Held, vectors, progress)
    }

    /// The same on step `k` of chain `s`.
    pub(super) fn descend(
        &self,
        s: usize,
        k: usize,
        reading: OperatorReading,
        vectors: &mut [PaperVectors],
        progress: &dyn Progress,
    ) -> Result<(), Cancelled> {
        let Some((here, below)) = vectors.split_first_mut() else {
            return Ok(());
        };
        let (level, equations) = (&self.levels[s + k], &self.chains[s][k]);
        if below.is_empty() {
            self.solve_coarsest(s, here);
            return Ok(());
        }
        for _ in 0..SWEEPS {
            check(progress)?;
            sweep(level, equations, &here.b, &mut here.x);
        }
        defect(level, equations, &here.b, &here.x, &mut here.defect);
        restrict_defect(level, equations, reading, &here.defect, &mut below[0].b);
        below[0].x.fill([0.0; WIDTH]);
        self.descend(s, k + 1, reading, below, progress)?;
        correct((level, equations, reading), &below[0].x, &here.defect, &mut here.x);
        for _ in 0..SWEEPS {
            check(progress)?;
            sweep(level, equations, &here.b, &mut here.x);
        }
        Ok(())
    }

    /// The coarsest equations of chain `s`, solved exactly.
    pub(super) fn solve_coarsest(&self, s: usize, vectors: &mut PaperVectors) {
        let inverse = &self.inverses[s];
        for (i, x) in vectors.x.iter_mut().enumerate() {
            *x = inverse.row_times(i, &vectors.b);
        }
    }
}
