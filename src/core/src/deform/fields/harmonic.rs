//! Bounded harmonic fields: how much each handle has to say at each node (paper section 2.1; Zayer et al. 2005).
//!
//! The field of a handle is 1 on its nodes, 0 on those of the others and harmonic between. All fields sum to 1, so one of
//! them need not be solved for. Soft handles enter as a pull towards 1, which keeps both properties.

use crate::deform::body::DeformableBody;
use crate::deform::handles::ownership::{NOBODY, NodeOwnership};
use crate::pool::Pool;
use rayon::prelude::*;

/// The fields of the handles that constrain one kind of quantity.
#[derive(Debug, Clone, Default)]
pub struct HarmonicFields {
    /// By hold, the frozen surroundings last: its field, one value per node; empty for a hold without a say.
    pub(in crate::deform) fields: Vec<Vec<f32>>,
    /// By component: whether any handle has a say in it. Elsewhere all fields are 0.
    pub(in crate::deform) covered: Vec<bool>,
    /// Solver iterations.
    pub(in crate::deform) iterations: usize,
}

impl HarmonicFields {
    /// The field of a hold: one value in [0, 1] per node, or empty when it has no say anywhere.
    pub fn of(&self, hold: usize) -> &[f32] {
        self.fields.get(hold).map_or(&[], Vec::as_slice)
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.fields.iter().map(|f| f.capacity() * 4).sum::<usize>() + self.covered.capacity()
    }
}

/// A hard handle is small when it has less than this part of its component's nodes.
const SMALL: f64 = 1.0 / 256.0;
/// How much of its component all handles together spread over when each is as small as can be.
const SPREAD: f64 = 1.0 / 8.0;
/// The field's value down to which a small handle may spread; where the interior follows the shape, its lattice holds the surface
/// around a vertex, and a field falls to half as much in the first ring.
const LOWEST: [f32; 2] = [0.5, 0.25];

impl HarmonicFields {
    /// The fields with the surroundings of small handles made parts of them, where rotations are blended; `None` when no
    /// handle is small.
    ///
    /// Around a handle of a few vertices a harmonic field falls like 1 / distance, so nearly all of the way to the other
    /// handles' rotations is made in the first few rings. Where it is above a level c, min(1, u / c) is the field of the
    /// region {u ≥ c}: harmonic outside, with a gradient that is that much gentler. The others share what is left.
    pub(in crate::deform) fn around_small(
        &self,
        body: &DeformableBody,
        ownership: &NodeOwnership,
        pool: &Pool,
    ) -> Option<Self> {
        let levels = self.levels(body, ownership)?;
        let active: Vec<usize> = (0..self.fields.len()).filter(|&k| !self.fields[k].is_empty()).collect();
        let spread = |i: usize, k: usize| match levels[k] < 1.0 {
            true => (self.fields[k][i] / levels[k]).min(1.0),
            false => 0.0,
        };
        // By node: what all small handles have together, and what the others' fields are to be multiplied by.
        let shares: Vec<(f32, f32)> = pool.install(|| {
            (0..body.nodes())
                .into_par_iter()
                .map(|i| {
                    let small: f32 = active.iter().map(|&k| spread(i, k)).sum();
                    let others: f32 = active
                        .iter()
                        .filter(|&&k| levels[k] >= 1.0)
                        .map(|&k| self.fields[k][i])
                        .sum();
                    let left = (1.0 - small).max(0.0);
                    (small, if others > 0.0 { left / others } else { 0.0 })
                })
                .collect()
        });
        let mut fields = self.clone();
        for &k in &active {
            let field = &mut fields.fields[k];
            pool.install(|| {
                field
                    .par_iter_mut()
                    .zip(&shares)
                    .enumerate()
                    .for_each(|(i, (u, &(small, others)))| {
                        // Where no other handle has anything to take back, the small ones share all.
                        let whole = if small > 1.0 || others == 0.0 { small } else { 1.0 };
                        *u = match levels[k] < 1.0 {
                            true if whole > 0.0 => (spread(i, k) / whole).min(1.0),
                            true => 0.0,
                            false => (*u * others).min(1.0),
                        };
                    });
            });
        }
        Some(fields)
    }

    /// By hold: the value down to which it spreads; 1 for those that are not small. `None` when none is.
    fn levels(&self, body: &DeformableBody, ownership: &NodeOwnership) -> Option<Vec<f32>> {
        let mut sizes = vec![0usize; body.graph.components];
        body.graph.component.iter().for_each(|&c| sizes[c as usize] += 1);
        // Of each hold, how many nodes it has and how many its component has.
        let mut holders = vec![(0usize, 0usize); self.fields.len()];
        for (node, &k) in ownership.hard.iter().enumerate().filter(|(_, k)| **k != NOBODY) {
            let (own, of) = &mut holders[k as usize];
            *own += 1;
            *of = (*of).max(sizes[body.graph.component[node] as usize]);
        }
        let stats = &body.graph.stats;
        let lowest = LOWEST[usize::from(stats.lattice_nodes > 0 && stats.shell_nodes == 0)];
        let active = self.fields.iter().filter(|f| !f.is_empty()).count().max(1);
        let mut levels = vec![1.0f32; self.fields.len()];
        for (k, &(own, of)) in holders.iter().enumerate() {
            let bound = SMALL * of as f64;
            if own == 0 || own as f64 >= bound || self.fields[k].is_empty() {
                continue;
            }
            // Fading out towards handles that are not small any more.
            let more = SPREAD * of as f64 / active as f64 * (1.0 - own as f64 / bound);
            let rank = (own + more as usize).min(self.fields[k].len() - 1);
            let mut values = self.fields[k].clone();
            let (_, level, _) = values.select_nth_unstable_by(rank, |a, b| b.total_cmp(a));
            levels[k] = level.clamp(lowest, 1.0);
        }
        levels.iter().any(|l| *l < 1.0).then_some(levels)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes;
    use crate::deform::body::BodyOptions;
    use crate::deform::handles::setup::{HandleConstraint, HandleSetup};
    use crate::deform::handles::system::HandleSystem;
    use crate::exec::Exec;
    use crate::mesh::{Mesh, Weld};
    use crate::progress::Silent;

    fn rig(body: &DeformableBody, holds: [Vec<u32>; 3], pool: &Pool) -> HandleSystem {
        let holds = holds.map(|nodes| HandleConstraint {
            nodes,
            position: true,
            rotation: true,
            ..Default::default()
        });
        let setup = HandleSetup {
            handles: holds.to_vec(),
            ..Default::default()
        };
        HandleSystem::build(body, setup, &Exec::new(pool, &Silent)).expect("a rig")
    }

    #[test]
    fn small_handles_take_their_surroundings_along() {
        let pool = Pool::new(2).expect("threads start");
        let (positions, triangles) = shapes::icosphere(1.0, 4);
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a mesh");
        let body = DeformableBody::build(&mesh, &BodyOptions::default(), &Exec::new(&pool, &Silent)).expect("a body");
        let below = |z: f64| {
            let nodes = (0u32..).zip(&body.graph.positions);
            nodes.filter(|(_, p)| p.z < z).map(|(n, _)| n).collect::<Vec<_>>()
        };
        let top = (0u32..).zip(&positions).filter(|(_, p)| p.z > 0.995).map(|(n, _)| n);
        let top: Vec<u32> = top.take(2).collect();
        let side = (0u32..).zip(&positions).find(|(_, p)| p.x > 0.99).map(|(n, _)| n);
        let rig = rig(&body, [below(-0.7), top, side.into_iter().collect()], &pool);
        let (plain, spread) = (
            &rig.rotation_fields,
            rig.blending_fields.as_ref().expect("two are small"),
        );
        let graph = &body.graph;
        let steepest = |fields: &HarmonicFields, k: usize| {
            let over = |i: usize| graph.row(i as u32).iter().map(move |&j| (i, j as usize));
            let edges = (0..body.nodes()).flat_map(over);
            edges
                .map(|(i, j)| (fields.of(k)[i] - fields.of(k)[j]).abs())
                .fold(0.0, f32::max)
        };
        for k in 1..3 {
            let (before, after) = (steepest(plain, k), steepest(spread, k));
            assert!(
                after < 0.7 * before,
                "handle {k}: {before} between neighbours, now {after}"
            );
        }
        for i in 0..body.nodes() {
            let values = [0, 1, 2].map(|k| spread.of(k)[i]);
            assert!(values.iter().all(|u| (0.0..=1.0).contains(u)), "{values:?}");
            assert!((values.iter().sum::<f32>() - 1.0).abs() < 1e-5, "{values:?}");
            let owner = rig.rotation.hard[i];
            if owner != NOBODY {
                assert!(
                    (values[owner as usize] - 1.0).abs() < 1e-6,
                    "node {i} of {owner}: {values:?}"
                );
            }
        }
    }

    #[test]
    fn fields_of_large_handles_stay_as_they_are() {
        let pool = Pool::new(1).expect("threads start");
        let (positions, triangles) = shapes::icosphere(1.0, 3);
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a mesh");
        let body = DeformableBody::build(&mesh, &BodyOptions::default(), &Exec::new(&pool, &Silent)).expect("a body");
        let cap = |keep: &dyn Fn(&glam::DVec3) -> bool| {
            let nodes = (0u32..).zip(&body.graph.positions);
            nodes.filter(|(_, p)| keep(p)).map(|(n, _)| n).collect::<Vec<_>>()
        };
        let holds = [cap(&|p| p.z < -0.8), cap(&|p| p.z > 0.8), cap(&|p| p.x > 0.8)];
        assert!(rig(&body, holds, &pool).blending_fields.is_none());
    }
}
