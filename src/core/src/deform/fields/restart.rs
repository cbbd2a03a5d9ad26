//! First-pass fields after an edit begin where those before it ended.

use crate::deform::fields::equations::FieldEquations;
use crate::deform::fields::harmonic::HarmonicFields;
use crate::deform::handles::setup::HandleSetup;
use crate::mesh::NONE;
use crate::pool::Pool;
use crate::solver::{LocalRelaxation, WeightedGraph};
use rayon::prelude::*;
use std::sync::Arc;

/// The fields of a rig, to begin those of another one from.
#[derive(Debug, Clone)]
pub struct KeptFields {
    pub(in crate::deform) rotation: Arc<HarmonicFields>,
    pub(in crate::deform) scale: Option<Arc<HarmonicFields>>,
    pub(in crate::deform) setup: Arc<HandleSetup>,
}

impl KeptFields {
    /// What the rig was built from.
    pub fn setup(&self) -> &HandleSetup {
        &self.setup
    }

    /// Bytes held on the heap; the rig that they come from holds the same ones.
    pub fn byte_size(&self) -> usize {
        self.rotation.byte_size() + self.scale.as_ref().map_or(0, |f| f.byte_size())
    }
}

/// Where the fields of a rig with the same holds begin, on a body that an edit has made of another one.
#[derive(Debug, Clone, Copy)]
pub struct FieldRestart<'a> {
    /// The fields before the edit.
    pub before: &'a KeptFields,
    /// For each node its number before the edit, or `u32::MAX`.
    pub old_from_new: &'a [u32],
    /// Nodes that are new, or have other neighbours than before; rising.
    pub touched: &'a [u32],
}

impl FieldRestart<'_> {
    /// Fills free rows of `x` from the fields before; what changed is relaxed with its surroundings. Answers the residual
    /// of each column over the norm of its right-hand side: what the old fields left, and what is left around the change.
    /// `None` when the fields before do not fit; `x` is then as it was.
    pub(in crate::deform) fn guess(
        &self,
        equations: &FieldEquations<'_>,
        before: &HarmonicFields,
        x: &mut [f64],
        pool: &Pool,
    ) -> Option<Vec<f64>> {
        let FieldEquations { columns, fixed, .. } = *equations;
        let old: Vec<&[f32]> = columns.iter().map(|&k| before.of(k)).collect();
        let nodes = self.old_from_new.len();
        if nodes != equations.body.nodes() || old.iter().any(|f| f.is_empty()) {
            return None;
        }
        pool.install(|| {
            x.par_chunks_mut(columns.len())
                .zip(self.old_from_new)
                .zip(fixed)
                .filter(|((_, was), fixed)| **was != NONE && !**fixed)
                .for_each(|((row, &was), _)| {
                    for (value, field) in row.iter_mut().zip(&old) {
                        *value = field.get(was as usize).copied().unwrap_or(0.0).into();
                    }
                });
        });
        // Falloff follows the shape, so pulls may have changed anywhere.
        if equations.is_soft {
            return Some(vec![f64::INFINITY; columns.len()]);
        }
        let graph = &equations.body.graph;
        let relaxation = LocalRelaxation {
            graph: WeightedGraph {
                offsets: &graph.offsets,
                neighbours: &graph.neighbours,
                weights: graph.weights.as_deref(),
                positions: None,
            },
            fixed,
            has_value: &|node| self.old_from_new[node] != NONE || fixed[node],
            references: equations.references,
        };
        let left = relaxation.relax_around(self.seeds(equations, before, pool), x);
        let relative = |(c, left): (usize, f64)| {
            let before = before.residuals[columns[c]];
            (before * before + left * left).sqrt() / equations.references[c]
        };
        // Without anything to go by the solver has the word.
        let judged = |r: f64| if r.is_finite() { r } else { f64::INFINITY };
        Some(left.into_iter().enumerate().map(relative).map(judged).collect())
    }

    /// Free nodes whose equations changed, rising.
    fn seeds(&self, equations: &FieldEquations<'_>, before: &HarmonicFields, pool: &Pool) -> Vec<u32> {
        let FieldEquations { body, fixed, hard, .. } = *equations;
        // A node that another handle holds than before, or none, has a say in the equations around it.
        let is_other = |(n, (&was, held)): (usize, (&u32, &u32))| {
            let differs = was != NONE && before.hard.get(was as usize) != Some(held);
            differs.then_some(n as u32)
        };
        let nodes = self.old_from_new.par_iter().zip(hard).enumerate();
        let other: Vec<u32> = pool.install(|| nodes.filter_map(is_other).collect());
        let mut seeds: Vec<u32> = self.touched.to_vec();
        for n in other {
            seeds.push(n);
            seeds.extend(body.graph.row(n));
        }
        seeds.retain(|&n| !fixed[n as usize]);
        seeds.sort_unstable();
        seeds.dedup();
        seeds
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes;
    use crate::deform::body::{BodyOptions, DeformableBody};
    use crate::deform::handles::setup::{HandleConstraint, HandleSetup};
    use crate::deform::handles::system::HandleSystem;
    use crate::exec::Exec;
    use crate::mesh::{Mesh, Weld};
    use crate::progress::Silent;

    /// A ball with its inside.
    fn ball(times: u32, pool: &Pool) -> DeformableBody {
        let (positions, triangles) = shapes::icosphere(1.0, times);
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a mesh");
        DeformableBody::build(&mesh, &BodyOptions::default(), &Exec::new(pool, &Silent)).expect("a body")
    }

    /// The nodes of which `keep` is true, held in every way.
    fn hold(body: &DeformableBody, keep: impl Fn(&glam::DVec3) -> bool) -> HandleConstraint {
        let nodes = (0u32..).zip(&body.graph.positions);
        HandleConstraint {
            nodes: nodes.filter(|(_, p)| keep(p)).map(|(n, _)| n).collect(),
            position: true,
            rotation: true,
            scale: true,
            ..Default::default()
        }
    }

    #[test]
    fn what_is_told_of_relaxed_fields_is_true() {
        let pool = Pool::new(2).expect("threads start");
        let body = ball(5, &pool);
        let setup = HandleSetup {
            handles: vec![
                hold(&body, |p| p.z < -0.7),
                hold(&body, |p| p.z > 0.7),
                hold(&body, |p| p.x > 0.8),
            ],
            ..Default::default()
        };
        let rig = HandleSystem::build(&body, setup.clone(), &Exec::new(&pool, &Silent)).expect("a rig");
        let kept = rig.keep_fields();

        // A patch on the side is new, and nobody knows its values.
        let middle = glam::DVec3::new(-1.0, 0.0, 0.0);
        let is_new = |n: u32| body.graph.positions[n as usize].distance(middle) < 0.15;
        let nodes = body.nodes() as u32;
        let old_from_new: Vec<u32> = (0..nodes).map(|n| if is_new(n) { NONE } else { n }).collect();
        let is_touched = |n: &u32| is_new(*n) || body.graph.row(*n).iter().any(|&j| is_new(j));
        let touched: Vec<u32> = (0..nodes).filter(is_touched).collect();
        assert!(touched.len() > 100, "{} nodes", touched.len());
        let restart = FieldRestart {
            before: &kept,
            old_from_new: &old_from_new,
            touched: &touched,
        };
        let again = HandleSystem::restart(&body, setup, Some(&restart), &Exec::new(&pool, &Silent)).expect("a rig");
        assert_eq!(again.field_iterations, 0, "relaxing is enough");

        let (before, now) = (rig.rotation_fields(), again.rotation_fields());
        for k in 1..3 {
            let (u, was) = (now.of(k), before.of(k));
            let farthest = u.iter().zip(was).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(farthest < 2e-4, "hold {k} moved by {farthest}");
            let free = (0..body.nodes()).filter(|&i| now.hard[i] == u32::MAX);
            let residual = |i: usize| -> f64 {
                let flow = body.edges(i).map(|(j, w)| w * (f64::from(u[j]) - f64::from(u[i])));
                flow.sum()
            };
            let truth = free.map(|i| residual(i) * residual(i)).sum::<f64>().sqrt();
            let told = now.residuals[k];
            assert!(
                truth <= 1.1 * told && told <= 2.0 * truth,
                "hold {k}: {truth} in truth, told {told}"
            );
            assert!(told > before.residuals[k], "an edit leaves something");
        }
    }

    #[test]
    fn a_handle_that_lost_nodes_is_noticed() {
        let pool = Pool::new(1).expect("threads start");
        let body = ball(4, &pool);
        let with = |top: f64| HandleSetup {
            handles: vec![hold(&body, |p| p.z < -0.7), hold(&body, |p| p.z > top)],
            ..Default::default()
        };
        let rig = HandleSystem::build(&body, with(0.6), &Exec::new(&pool, &Silent)).expect("a rig");
        let kept = rig.keep_fields();
        let old_from_new: Vec<u32> = (0..body.nodes() as u32).collect();
        let restart = FieldRestart {
            before: &kept,
            old_from_new: &old_from_new,
            touched: &[],
        };
        let again = HandleSystem::restart(&body, with(0.8), Some(&restart), &Exec::new(&pool, &Silent)).expect("a rig");
        let fresh = HandleSystem::build(&body, with(0.8), &Exec::new(&pool, &Silent)).expect("a rig");
        let (a, b) = (again.rotation_fields().of(1), fresh.rotation_fields().of(1));
        let farthest = a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(farthest < 2e-4, "off by {farthest}");
    }
}
