//! A body after an edit of its mesh, in time proportional to the edit: the graph is resampled around the change, the
//! hierarchy is repaired.

use crate::deform::body::{DeformableBody, place};
use crate::deform::error::Error;
use crate::exec::Exec;
use crate::graph::{self, MeshChange, TieOptions};
use crate::mesh::BoundingBox;
use crate::solver::{self, Hierarchy};
use glam::DVec3;
use rayon::prelude::*;
use std::ops::RangeInclusive;

/// A followed body keeps solving coordinates while the mesh's diagonal is this many units long,
const LENGTHS: RangeInclusive<f64> = 0.125..=8.0;
/// and its middle within so many units of their origin.
const FARTHEST: f64 = 8.0;

/// Lattice edges that a deformation has stretched or squeezed beyond this share of their rest length are strained.
const STRAIN: RangeInclusive<f64> = 0.6..=1.6;
/// A lattice with more than this part of its edges strained is not worth keeping.
const MOST_STRAINED: f64 = 0.05;
/// One of so many lattice nodes is tested.
const SAMPLE: usize = 8;

impl DeformableBody {
    /// The body of the mesh after `change`; `None` where a new one has to be built: where [`graph::resample`] says so,
    /// when the mesh has grown or moved out of the solving coordinates, or when a deformation has strained the lattice.
    ///
    /// `moved` has all nodes, in model space, where a deformation that has become the rest shape left them; `None` when
    /// the rest shape was edited. `ties` are those of the body, with the families of the vertices after the edit. Edges
    /// keep their weights but around the change. The result depends on the arguments alone. Reports the stages "graph"
    /// and "hierarchy".
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn follow(
        &self,
        change: &MeshChange<'_>,
        moved: Option<&[DVec3]>,
        ties: Option<&TieOptions>,
        exec: &Exec<'_>,
    ) -> Result<Option<DeformableBody>, Error> {
        exec.progress.report("graph", 0.0);
        let bounds = exec.pool.install(|| bounds(change.positions));
        let middle = bounds.min + (bounds.max - bounds.min) * 0.5;
        let lost = !LENGTHS.contains(&((bounds.max - bounds.min).length() / self.unit))
            || (middle - self.origin).length() > FARTHEST * self.unit;
        let is_strained = |m: &[DVec3]| m.len() != self.nodes() || exec.pool.install(|| self.is_strained(m));
        if lost || moved.is_some_and(is_strained) {
            return Ok(None);
        }
        let at = moved.unwrap_or(&self.graph.positions);
        let is_worn = self.hierarchy.is_worn();
        // Much of a graph's change takes one thread. A copy of the hierarchy, which knows nothing of it, has work for the others.
        let (resampled, hierarchy) = exec.pool.install(|| {
            rayon::join(
                || graph::resample_tied(&self.graph, at, change, ties, exec),
                || (!is_worn).then(|| self.hierarchy.clone_in_parallel(exec.pool)),
            )
        });
        let Some(resampled) = resampled? else {
            return Ok(None);
        };
        let graph = resampled.graph;
        let rest = exec.pool.install(|| place(&graph.positions, self.origin, self.unit));

        exec.check()?;
        exec.progress.report("hierarchy", 0.0);
        let view = solver::WeightedGraph {
            offsets: &graph.offsets,
            neighbours: &graph.neighbours,
            weights: graph.weights.as_deref(),
            positions: Some(&rest),
        };
        let hierarchy = match hierarchy {
            None => Hierarchy::build(&view, self.hierarchy.options(), exec)?,
            Some(mut hierarchy) => {
                let change = solver::GraphChange {
                    new_from_old: &resampled.new_from_old,
                    touched: &resampled.touched,
                };
                hierarchy.repair(&view, &change, exec)?;
                hierarchy
            }
        };
        Ok(Some(Self {
            diagonal: self.diagonal_of(&bounds),
            too_large: self.too_large.clone(),
            hierarchy,
            single: Default::default(),
            origin: self.origin,
            unit: self.unit,
            graph,
        }))
    }

    fn diagonal_of(&self, bounds: &BoundingBox) -> f64 {
        match (bounds.max - bounds.min).length() {
            length if length > 0.0 => length,
            _ => self.diagonal,
        }
    }

    /// Whether a deformation has strained too many edges of the lattice.
    fn is_strained(&self, moved: &[DVec3]) -> bool {
        let lattice = self.graph.surface + self.graph.stats.shell_nodes;
        let edges_of = |node: usize| {
            let (mut all, mut strained) = (0usize, 0usize);
            for &other in self.graph.row(node as u32) {
                let other = other as usize;
                if other < lattice {
                    continue;
                }
                let before = self.graph.positions[node].distance_squared(self.graph.positions[other]);
                let now = moved[node].distance_squared(moved[other]);
                let (least, most) = (STRAIN.start(), STRAIN.end());
                all += 1;
                strained += usize::from(!(least * least * before..=most * most * before).contains(&now));
            }
            (all, strained)
        };
        let nodes = (lattice..self.nodes())
            .into_par_iter()
            .step_by(SAMPLE)
            .with_min_len(1024);
        let (all, strained) = nodes.map(edges_of).reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        strained as f64 > MOST_STRAINED * all as f64
    }
}

fn bounds(positions: &[DVec3]) -> BoundingBox {
    const BLOCK: usize = 1 << 15;
    let parts: Vec<BoundingBox> = positions.par_chunks(BLOCK).map(BoundingBox::of).collect();
    let corners: Vec<DVec3> = parts.iter().flat_map(|b| [b.min, b.max]).collect();
    BoundingBox::of(&corners)
}
