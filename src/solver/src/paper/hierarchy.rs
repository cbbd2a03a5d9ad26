//! The levels of the paper's hierarchy and the equations on them.

use crate::build::hierarchy::Hierarchy;
use crate::dense::Inverse;
use crate::options::{BuildOptions, LevelSize};
use crate::paper::coarsen::coarsen;
use crate::paper::equations::LevelEquations;
use crate::paper::kept::UncutGraph;
use crate::paper::level::PaperLevel;
use crate::paper::restrict::{OperatorReading, restricted};

/// Most vertices of a coarsest level that could not be coarsened any further.
const DENSE: usize = 1000;

/// The levels of one set of constraints.
#[derive(Debug)]
pub(crate) struct PaperHierarchy {
    /// Vertex of the caller's graph that each vertex of the finest level stands for, ascending.
    pub(super) vertices: Vec<u32>,
    /// Its row in the parent module's order.
    pub(super) rows: Vec<u32>,
    /// Finest first; at least one.
    pub(super) levels: Vec<PaperLevel>,
    /// `chains[s][k]`: on level s + k, the defect equations of the original equations of level s; those themselves for
    /// k = 0. Pairs of equal s + k share their graph.
    pub(super) chains: Vec<Vec<LevelEquations>>,
    /// The coarsest equations of each chain.
    pub(super) inverses: Vec<Inverse>,
    /// Conjugate-gradient steps after each cycle; `None`: two where a tolerance of 1e-5 or less is asked for.
    pub(super) steps: Option<usize>,
    /// False if the graph resisted coarsening: its coarse levels would have grown too dense or hardly shrunk.
    pub(super) usable: bool,
}

impl PaperHierarchy {
    /// Builds the levels over the free vertices: those that `fixed` does not hold.
    ///
    /// `stiffness` is α of soft constraints in row order of `hierarchy`, whose scaling of weights is adopted.
    pub(crate) fn build(kept: &UncutGraph, hierarchy: &Hierarchy, fixed: &[bool], stiffness: &[f64]) -> PaperHierarchy {
        let options = &kept.options;
        let (vertices, rows, finest, original) = kept.free(hierarchy, fixed, stiffness);
        let (levels, usable) = levels(finest, options);
        let mut built = PaperHierarchy {
            vertices,
            rows,
            levels,
            chains: Vec::new(),
            inverses: Vec::new(),
            steps: options.interleave,
            usable,
        };
        if usable {
            built.fill_chains(original);
        }
        built
    }

    /// Equations of every chain: originals from level to level, and from each of them its defect equations.
    fn fill_chains(&mut self, mut original: LevelEquations) {
        for s in 0..self.levels.len() {
            let next = self
                .below(s)
                .map(|c| restricted(&self.levels[s], &original, c, OperatorReading::Pruned));
            let mut chain = vec![original];
            for k in s..self.levels.len() - 1 {
                let equations = restricted(
                    &self.levels[k],
                    &chain[k - s],
                    &self.levels[k + 1],
                    OperatorReading::Held,
                );
                chain.push(equations);
            }
            let last = (&self.levels[self.levels.len() - 1], &chain[chain.len() - 1]);
            self.inverses.push(last.1.inverse(last.0));
            self.chains.push(chain);
            original = match next {
                Some(next) => next,
                None => break,
            };
        }
    }

    fn below(&self, level: usize) -> Option<&PaperLevel> {
        self.levels.get(level + 1)
    }

    /// Sizes of the levels, finest first.
    pub(crate) fn level_sizes(&self) -> Vec<LevelSize> {
        let facts = |l: &PaperLevel| LevelSize {
            vertices: l.vertices(),
            edges: l.neighbours.len() / 2,
        };
        self.levels.iter().filter(|l| l.vertices() > 0).map(facts).collect()
    }

    /// Bytes held.
    pub(crate) fn byte_size(&self) -> usize {
        let levels: usize = self.levels.iter().map(PaperLevel::byte_size).sum();
        let chains: usize = self.chains.iter().flatten().map(LevelEquations::byte_size).sum();
        let inverses: usize = self.inverses.iter().map(Inverse::byte_size).sum();
        levels + chains + inverses + 4 * (self.vertices.len() + self.rows.len())
    }
}

/// Coarsens until a level is small enough to be solved directly. False if that was given up.
fn levels(finest: PaperLevel, options: &BuildOptions) -> (Vec<PaperLevel>, bool) {
    let mut levels = vec![finest];
    loop {
        let last = levels.len() - 1;
        if levels[last].vertices() <= options.coarsest {
            return (levels, true);
        }
        match coarsen(&mut levels[last], options.coarsening) {
            Some(coarse) => levels.push(coarse),
            None => {
                let usable = levels[last].vertices() <= DENSE;
                return (levels, usable);
            }
        }
    }
}
