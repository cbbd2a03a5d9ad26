//! Bounded harmonic fields: how much each handle has to say at each node (paper section 2.1; Zayer et al. 2005).
//!
//! The field of a handle is 1 on its nodes, 0 on those of the others and harmonic between. All fields sum to 1, so one of
//! them need not be solved for; the others are solved together. Soft handles enter as a pull towards 1, which keeps both
//! properties. Animations blend with the few handles that have a say at each node.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::field_solver::FieldSolver;
use crate::handles::ownership::{NodeOwnership, UNHELD};
use crate::shares::{ShareRow, SparseShares};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_solver::LinearSystem;
use rayon::prelude::*;

/// A share below this is left out where an animation blends.
const LEAST: f32 = 1e-3;

/// So many handles have whole fields. With more of them, shares that are next to nothing are left out
/// ([`BodyOptions::local_fields`](crate::BodyOptions)).
pub const MOST_WHOLE_FIELDS: usize = 64;

/// The fields of the handles that constrain one kind of quantity.
#[derive(Debug, Clone, Default)]
pub struct HarmonicFields {
    kept: KeptFields,
    /// By component: whether any handle has a say in it. Elsewhere all fields are 0.
    pub(crate) covered: Vec<bool>,
    /// Solver iterations.
    pub(crate) iterations: usize,
}

/// How fields are kept.
#[derive(Debug, Clone)]
enum KeptFields {
    /// By hold, the frozen surroundings last: its field, one value per node; empty for a hold without a say.
    Whole(Vec<Vec<f32>>),
    /// Those of many handles: by hold whether it has a say, and by node the shares of those that have one there.
    Sparse { has_say: Vec<bool>, shares: SparseShares },
}

impl Default for KeptFields {
    fn default() -> Self {
        Self::Whole(Vec::new())
    }
}

impl HarmonicFields {
    /// The field of a hold: one value in [0, 1] per node, or empty when it has no say anywhere. With more than 64 handles fields
    /// are not kept whole, and this is empty too; [`HarmonicFields::at`] has the values then.
    pub fn of(&self, hold: usize) -> &[f32] {
        match &self.kept {
            KeptFields::Whole(fields) => fields.get(hold).map_or(&[], Vec::as_slice),
            KeptFields::Sparse { .. } => &[],
        }
    }

    /// The value of a hold's field at a node, in [0, 1].
    pub fn at(&self, hold: usize, node: usize) -> f32 {
        match &self.kept {
            KeptFields::Whole(_) => self.of(hold).get(node).copied().unwrap_or(0.0),
            KeptFields::Sparse { shares, .. } => shares.share_of(hold, node),
        }
    }

    /// Whether a hold has a say anywhere.
    pub(crate) fn has_say(&self, hold: usize) -> bool {
        match &self.kept {
            KeptFields::Whole(fields) => fields.get(hold).is_some_and(|field| !field.is_empty()),
            KeptFields::Sparse { has_say, .. } => has_say.get(hold) == Some(&true),
        }
    }

    /// Calls `each` with every hold whose field is above 0 at a node, by rising number, and the field there.
    pub(crate) fn each_at(&self, node: usize, mut each: impl FnMut(usize, f32)) {
        match &self.kept {
            KeptFields::Whole(fields) => {
                for (hold, field) in fields.iter().enumerate() {
                    match field.get(node) {
                        Some(&u) if u > 0.0 => each(hold, u),
                        _ => {}
                    }
                }
            }
            KeptFields::Sparse { shares, .. } => shares.at(node).iter().for_each(|&(hold, u)| each(hold as usize, u)),
        }
    }

    /// By node what an animation blends with: the largest shares first, next to nothing left out; they sum to 1.
    pub(crate) fn largest_shares(&self, nodes: usize, pool: &Pool) -> SparseShares {
        SparseShares::of_rows(nodes, pool, |node| {
            let mut some = Vec::new();
            self.each_at(node, |k, u| {
                if u >= LEAST {
                    some.push((k as u32, u));
                }
            });
            some.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            let sum: f32 = some.iter().map(|s| s.1).sum();
            some.iter_mut().for_each(|s| s.1 /= sum);
            some
        })
    }

    /// Shares by node, where fields are not kept whole.
    pub(crate) fn sparse(&self) -> Option<&SparseShares> {
        match &self.kept {
            KeptFields::Whole(_) => None,
            KeptFields::Sparse { shares, .. } => Some(shares),
        }
    }

    /// Number of holds.
    pub fn holds(&self) -> usize {
        match &self.kept {
            KeptFields::Whole(fields) => fields.len(),
            KeptFields::Sparse { has_say, .. } => has_say.len(),
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        let kept = match &self.kept {
            KeptFields::Whole(fields) => fields.iter().map(|f| f.capacity() * 4).sum::<usize>(),
            KeptFields::Sparse { has_say, shares } => has_say.capacity() + shares.byte_size(),
        };
        kept + self.covered.capacity()
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
    pub(crate) fn around_small(&self, body: &DeformableBody, ownership: &NodeOwnership, pool: &Pool) -> Option<Self> {
        let levels = self.levels(body, ownership)?;
        let kept = match &self.kept {
            KeptFields::Whole(fields) => KeptFields::Whole(spread_whole(fields, &levels, body.nodes(), pool)),
            KeptFields::Sparse { has_say, shares } => KeptFields::Sparse {
                has_say: has_say.clone(),
                shares: SparseShares::of_rows(body.nodes(), pool, |node| spread_row(shares.at(node), &levels)),
            },
        };
        Some(Self {
            kept,
            ..self.clone_facts()
        })
    }

    /// All but the fields.
    fn clone_facts(&self) -> Self {
        Self {
            kept: KeptFields::default(),
            covered: self.covered.clone(),
            iterations: self.iterations,
        }
    }

    /// By hold: the value down to which it spreads; 1 for those that are not small. `None` when none is.
    fn levels(&self, body: &DeformableBody, ownership: &NodeOwnership) -> Option<Vec<f32>> {
        let mut sizes = vec![0usize; body.graph.components];
        body.graph.component.iter().for_each(|&c| sizes[c as usize] += 1);
        // Of each hold, how many nodes it has and how many its component has.
        let mut holders = vec![(0usize, 0usize); self.holds()];
        for (node, &k) in ownership.hard.iter().enumerate().filter(|(_, k)| **k != UNHELD) {
            let (own, of) = &mut holders[k as usize];
            *own += 1;
            *of = (*of).max(sizes[body.graph.component[node] as usize]);
        }
        let stats = &body.graph.stats;
        let lowest = LOWEST[usize::from(stats.lattice_nodes > 0 && stats.shell_nodes == 0)];
        let active = (0..self.holds()).filter(|&k| self.has_say(k)).count().max(1);
        let mut by_hold = self.sparse().map(|shares| shares.by_hold(self.holds(), |_| true));
        let mut levels = vec![1.0f32; self.holds()];
        for (k, &(own, of)) in holders.iter().enumerate() {
            let bound = SMALL * of as f64;
            if own == 0 || own as f64 >= bound || !self.has_say(k) {
                continue;
            }
            // Fading out towards handles that are not small any more.
            let more = SPREAD * of as f64 / active as f64 * (1.0 - own as f64 / bound);
            let rank = (own + more as usize).min(body.nodes() - 1);
            let mut values: Vec<f32> = match &mut by_hold {
                None => self.of(k).to_vec(),
                Some(lists) => std::mem::take(&mut lists[k]).into_iter().map(|s| s.1).collect(),
            };
            // Left out is next to nothing.
            let level = match rank < values.len() {
                true => *values.select_nth_unstable_by(rank, |a, b| b.total_cmp(a)).1,
                false => 0.0,
            };
            levels[k] = level.clamp(lowest, 1.0);
        }
        levels.iter().any(|l| *l < 1.0).then_some(levels)
    }
}

/// Whole fields with the surroundings of small handles made parts of them; `levels` is by hold.
fn spread_whole(whole: &[Vec<f32>], levels: &[f32], nodes: usize, pool: &Pool) -> Vec<Vec<f32>> {
    let active: Vec<usize> = (0..whole.len()).filter(|&k| !whole[k].is_empty()).collect();
    let spread = |i: usize, k: usize| match levels[k] < 1.0 {
        true => (whole[k][i] / levels[k]).min(1.0),
        false => 0.0,
    };
    // By node: what all small handles have together, and what the others' fields are to be multiplied by.
    let shares: Vec<(f32, f32)> = pool.install(|| {
        (0..nodes)
            .into_par_iter()
            .map(|i| {
                let small: f32 = active.iter().map(|&k| spread(i, k)).sum();
                let others: f32 = active.iter().filter(|&&k| levels[k] >= 1.0).map(|&k| whole[k][i]).sum();
                let left = (1.0 - small).max(0.0);
                (small, if others > 0.0 { left / others } else { 0.0 })
            })
            .collect()
    });
    let mut fields = whole.to_vec();
    for &k in &active {
        let field = &mut fields[k];
        pool.install(|| {
            field
                .par_iter_mut()
                .zip(&shares)
                .enumerate()
                .for_each(|(i, (u, &(small, others)))| {
                    // Where no other handle has anything to take back, the small ones share all.
                    let all = if small > 1.0 || others == 0.0 { small } else { 1.0 };
                    *u = match levels[k] < 1.0 {
                        true if all > 0.0 => (spread(i, k) / all).min(1.0),
                        true => 0.0,
                        false => (*u * others).min(1.0),
                    };
                });
        });
    }
    fields
}

/// The same for the shares at one node.
fn spread_row(row: &[(u32, f32)], levels: &[f32]) -> ShareRow {
    let is_small = |k: u32| levels[k as usize] < 1.0;
    let spread = |&(k, u): &(u32, f32)| (u / levels[k as usize]).min(1.0);
    let small: f32 = row.iter().filter(|s| is_small(s.0)).map(spread).sum();
    let others: f32 = row.iter().filter(|s| !is_small(s.0)).map(|s| s.1).sum();
    let others = if others > 0.0 {
        (1.0 - small).max(0.0) / others
    } else {
        0.0
    };
    let all = if small > 1.0 || others == 0.0 { small } else { 1.0 };
    let share = |s: &(u32, f32)| match is_small(s.0) {
        true if all > 0.0 => (spread(s) / all).min(1.0),
        true => 0.0,
        false => (s.1 * others).min(1.0),
    };
    row.iter().map(|s| (s.0, share(s))).filter(|s| s.1 > 0.0).collect()
}

/// Solves the fields of all handles: those of few in one go, all columns together, those of many each around its handle. Also
/// returns the system, if there was anything to solve.
///
/// A solve begins from nothing even where an edit has changed little: fields that began from those before the edit would
/// depend, within their tolerance, on when the handles were set.
pub(crate) fn solve_fields(
    body: &DeformableBody,
    ownership: &NodeOwnership,
    handles: usize,
    exec: &Exec<'_>,
) -> Result<(HarmonicFields, Option<LinearSystem>), Error> {
    let covered = ownership.covered(body);
    let has_say = ownership.active(handles);
    let active: Vec<usize> = (0..=handles).filter(|&k| has_say[k]).collect();
    let mut solved = HarmonicFields {
        kept: KeptFields::Whole(vec![Vec::new(); handles + 1]),
        covered,
        iterations: 0,
    };
    let Some((&first, others)) = active.split_first() else {
        return Ok((solved, None));
    };
    let solver = match others.is_empty() {
        true => None,
        false => Some(FieldSolver::new(body, ownership, &solved.covered, exec)?),
    };
    match solver {
        Some(solver) if body.local_fields && active.len() > MOST_WHOLE_FIELDS => {
            let shares = solver.solve_sparse(&active, handles + 1)?;
            solved.kept = KeptFields::Sparse { has_say, shares };
            Ok((solved, Some(solver.system)))
        }
        solver => {
            let mut x = Vec::new();
            if let Some(solver) = &solver {
                (x, solved.iterations) = solver.solve_columns(others)?;
            }
            let (of_others, rest) = exec
                .pool
                .install(|| share_out(body, &solved.covered, others.len(), &mut x));
            let mut fields = vec![Vec::new(); handles + 1];
            others.iter().zip(of_others).for_each(|(&k, field)| fields[k] = field);
            fields[first] = rest;
            solved.kept = KeptFields::Whole(fields);
            Ok((solved, solver.map(|solver| solver.system)))
        }
    }
}

/// Makes fields of the columns: the solver stops short of the exact solution, so bounds and sum are restored to the last bit
/// that matters. Also returns what they leave to one more. `covered` is by component.
fn share_out(body: &DeformableBody, covered: &[bool], columns: usize, x: &mut [f64]) -> (Vec<Vec<f32>>, Vec<f32>) {
    x.par_chunks_mut(columns.max(1)).for_each(|row| {
        row.iter_mut().for_each(|u| *u = u.clamp(0.0, 1.0));
        let sum: f64 = row.iter().sum();
        if sum > 1.0 {
            row.iter_mut().for_each(|u| *u /= sum);
        }
    });
    let (nodes, x) = (body.nodes(), &*x);
    let field = |c: usize| {
        (0..nodes)
            .into_par_iter()
            .map(move |i| x[i * columns + c] as f32)
            .collect()
    };
    let fields = (0..columns).map(field).collect();
    let rest = (0..nodes)
        .into_par_iter()
        .map(|i| match covered[body.graph.component[i] as usize] {
            true => (1.0 - x[i * columns..(i + 1) * columns].iter().sum::<f64>()).clamp(0.0, 1.0) as f32,
            false => 0.0,
        });
    (fields, rest.collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::BodyOptions;
    use crate::handles::ownership::{HandleConstraint, HandleSetup};
    use crate::handles::system::HandleSystem;
    use crate::pose::{FirstPass, FitOrder, PoseRequest, Quality, SolutionExtent, SolveStart};
    use crate::rotation::Transform;
    use crate::second_pass::state::SolveState;
    use glam::DVec3;
    use pliant_asset::shapes;
    use pliant_exec::Exec;
    use pliant_exec::progress::Silent;
    use pliant_mesh::{Mesh, Weld};

    fn handles(body: &DeformableBody, holds: [Vec<u32>; 3], pool: &Pool) -> HandleSystem {
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
        HandleSystem::build(body, setup, &Exec::new(pool, &Silent)).expect("handles")
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
        let handles = handles(&body, [below(-0.7), top, side.into_iter().collect()], &pool);
        let (plain, spread) = (
            &handles.rotation_fields,
            handles.blending_fields.as_ref().expect("two are small"),
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
            let owner = handles.rotation.hard[i];
            if owner != UNHELD {
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
        assert!(handles(&body, holds, &pool).blending_fields.is_none());
    }

    /// A long bar with 100 points all over it as hard handles.
    fn bar_of_points(pool: &Pool) -> (DeformableBody, HandleSystem) {
        let (positions, triangles) = shapes::box_with_cells(DVec3::new(0.5, 0.5, 16.0), [4, 4, 128]);
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a mesh");
        let exec = Exec::new(pool, &Silent);
        let options = BodyOptions {
            local_fields: true,
            ..Default::default()
        };
        let body = DeformableBody::build(&mesh, &options, &exec).expect("a body");
        let mut vertices: Vec<u32> = (0..body.graph.surface as u32).collect();
        let along = |n: &u32| body.graph.positions[*n as usize].z;
        vertices.sort_by(|a, b| along(a).total_cmp(&along(b)).then(a.cmp(b)));
        let hold = |k: usize| HandleConstraint {
            nodes: vec![vertices[(2 * k + 1) * vertices.len() / 200]],
            position: true,
            rotation: true,
            scale: true,
            ..Default::default()
        };
        let setup = HandleSetup {
            handles: (0..100).map(hold).collect(),
            ..Default::default()
        };
        let handles = HandleSystem::build(&body, setup, &exec).expect("handles");
        (body, handles)
    }

    /// The fields of all handles, solved for on the whole graph.
    fn whole_fields(body: &DeformableBody, handles: &HandleSystem, pool: &Pool) -> HarmonicFields {
        let exec = Exec::new(pool, &Silent);
        let covered = handles.rotation.covered(body);
        let solver = FieldSolver::new(body, &handles.rotation, &covered, &exec).expect("a system");
        let holds: Vec<usize> = (1..handles.handle_count()).collect();
        let (mut x, _) = solver.solve_columns(&holds).expect("columns");
        let (fields, rest) = share_out(body, &covered, holds.len(), &mut x);
        HarmonicFields {
            kept: KeptFields::Whole([rest].into_iter().chain(fields).collect()),
            covered,
            iterations: 0,
        }
    }

    #[test]
    fn fields_of_many_handles_sum_to_one_and_are_nearly_those_of_the_whole_graph() {
        let pool = Pool::new(2).expect("threads start");
        let (body, handles) = bar_of_points(&pool);
        let whole = whole_fields(&body, &handles, &pool);
        let shares = handles.rotation_fields.sparse().expect("many handles");
        let (mut worst, mut kept) = (0.0f32, 0);
        for node in 0..body.nodes() {
            let some = shares.at(node);
            kept += some.len();
            assert!(some.is_sorted_by(|a, b| a.0 < b.0));
            assert!(some.iter().all(|s| s.1 > 0.0 && s.1 <= 1.0), "{some:?}");
            let sum: f32 = some.iter().map(|s| s.1).sum();
            assert!((sum - 1.0).abs() < 1e-5, "node {node}: {sum}");
            let off = (0..100).map(|k| (handles.rotation_fields.at(k, node) - whole.at(k, node)).abs());
            worst = worst.max(off.sum());
            if let Some(k) = handles.hard_holder(node) {
                assert_eq!(some, [(k as u32, 1.0)]);
            }
        }
        assert!(worst < 0.02, "shares are off by {worst} in all");
        assert!(kept < 40 * body.nodes(), "{kept} shares of {} nodes", body.nodes());
    }

    #[test]
    fn shapes_of_many_handles_are_nearly_those_of_whole_fields() {
        let pool = Pool::new(2).expect("threads start");
        let exec = Exec::new(&pool, &Silent);
        let (body, mut handles) = bar_of_points(&pool);
        let transforms: Vec<Transform> = (0..100)
            .map(|k| {
                let pivot = body.graph.positions[handles.setup.handles[k].nodes[0] as usize];
                Transform {
                    translation: DVec3::Z * (0.1 * libm::sin(3.0 * pivot.x)),
                    rotation: DVec3::new(0.5 * libm::cos(3.0 * pivot.x), 0.3 * pivot.y, 0.4 * pivot.z),
                    pivot,
                    ..Transform::IDENTITY
                }
            })
            .collect();
        let solve = |body: &DeformableBody, handles: &HandleSystem, start: SolveStart| {
            let request = PoseRequest {
                transforms: &transforms,
                quality: Quality {
                    refine: Some(0),
                    ..Default::default()
                },
                start,
                first_pass: FirstPass::Harmonic,
                fits: FitOrder::GraphAlone,
                extent: SolutionExtent::Graph,
                smooth_borders: false,
            };
            let solved = handles.solve(body, &request, &mut SolveState::default(), &exec, &mut |_| true);
            solved.expect("a solution").positions
        };
        let fresh = solve(&body, &handles, SolveStart::Fresh);
        let dragged = solve(&body, &handles, SolveStart::Warm);
        let one = Pool::new(1).expect("threads start");
        let (other, again) = bar_of_points(&one);
        assert_eq!(fresh, solve(&other, &again, SolveStart::Fresh));

        let whole = whole_fields(&body, &handles, &pool);
        handles.blending_fields = whole.around_small(&body, &handles.rotation, &pool);
        handles.rotation_fields = whole;
        let expected = solve(&body, &handles, SolveStart::Fresh);
        for (shape, most) in [(fresh, 1e-3), (dragged, 3e-3)] {
            let off = shape.iter().zip(&expected).map(|(a, b)| a.distance(*b) / body.diagonal);
            let off = off.fold(0.0, f64::max);
            assert!(off < most, "a node is off by {off} of the diagonal");
        }
    }
}
