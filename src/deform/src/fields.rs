//! Bounded harmonic fields: how much each handle has to say at each node (paper section 2.1; Zayer et al. 2005).
//!
//! The field of a handle is 1 on its nodes, 0 on those of the others and harmonic between. All fields sum to 1, so one of
//! them need not be solved for; the others are solved together. Soft handles enter as a pull towards 1, which keeps both
//! properties. Animations blend with the few handles that have a say at each node.

use crate::body::DeformableBody;
use crate::error::Error;
use crate::handles::ownership::{NodeOwnership, UNHELD};
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_mesh::graph::MeshGraph;
use pliant_solver::{Constraints, InitialGuess, LinearSystem, SolveControl, SolveOptions, Workspace};
use rayon::prelude::*;

/// The fields of the handles that constrain one kind of quantity.
#[derive(Debug, Clone, Default)]
pub struct HarmonicFields {
    /// By hold, the frozen surroundings last: its field, one value per node; empty for a hold without a say.
    pub(crate) fields: Vec<Vec<f32>>,
    /// By component: whether any handle has a say in it. Elsewhere all fields are 0.
    pub(crate) covered: Vec<bool>,
    /// Solver iterations.
    pub(crate) iterations: usize,
}

impl HarmonicFields {
    /// The field of a hold: one value in [0, 1] per node, or empty when it has no say anywhere.
    pub fn of(&self, hold: usize) -> &[f32] {
        self.fields.get(hold).map_or(&[], Vec::as_slice)
    }

    /// The joint between a region and what is free around it: the mean of the graph's edges, each weighing w (u_i − u_j)², its
    /// share of the Dirichlet energy of the region's harmonic field, times exp(−½ (d / 2r)²). Here d is the distance from the
    /// centre of the region's border, and r the root of the mean square of d over the border. Turned about this point a region
    /// arrives with little bending around it; the second factor keeps the point near, where the field falls in far limbs also.
    /// `None` for a region without a border or a field that falls nowhere.
    ///
    /// All sums run over fixed pieces in their order.
    pub fn joint(&self, hold: usize, region: &[u32], graph: &MeshGraph, pool: &Pool) -> Option<DVec3> {
        let field = self.of(hold);
        let origin = graph.positions[*region.first().filter(|_| !field.is_empty())? as usize];
        let mut within = vec![false; graph.nodes()];
        region.iter().for_each(|&i| within[i as usize] = true);
        let weight = |e: usize| graph.weights.as_ref().map_or(1.0, |w| f64::from(w[e]));
        let middle = |i: u32, j: u32| (graph.positions[i as usize] + graph.positions[j as usize]) * 0.5 - origin;
        let edges = |i: u32| graph.entries(i).zip(graph.row(i));

        let border = PointSums::over(region.len(), pool, |k, sum| {
            let i = region[k];
            for (e, &j) in edges(i).filter(|(_, j)| !within[**j as usize]) {
                sum.add(weight(e), middle(i, j));
            }
        });
        let center = border.mean()?;
        let spread = 8.0 * (border.square / border.weight - center.length_squared()).max(0.0);
        if spread <= 0.0 {
            return Some(origin + center);
        }
        let falls = PointSums::over(graph.nodes(), pool, |i, sum| {
            for (e, &j) in edges(i as u32).filter(|(_, j)| **j as usize > i) {
                let fall = f64::from(field[i] - field[j as usize]);
                let at = middle(i as u32, j);
                sum.add(
                    fall * fall * weight(e) * libm::exp(-at.distance_squared(center) / spread),
                    at,
                );
            }
        });
        falls.mean().map(|joint| origin + joint)
    }

    /// Number of holds.
    pub fn holds(&self) -> usize {
        self.fields.len()
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.fields.iter().map(|f| f.capacity() * 4).sum::<usize>() + self.covered.capacity()
    }
}

/// Sums of weighted points.
#[derive(Clone, Copy, Default)]
struct PointSums {
    weight: f64,
    point: DVec3,
    square: f64,
}

impl PointSums {
    /// Adds up what `add` adds for each of `count` items.
    fn over(count: usize, pool: &Pool, add: impl Fn(usize, &mut Self) + Sync) -> Self {
        const PIECE: usize = 8192;
        let pieces = pool.map(count.div_ceil(PIECE), 1, |piece| {
            let mut sum = Self::default();
            (piece * PIECE..((piece + 1) * PIECE).min(count)).for_each(|k| add(k, &mut sum));
            sum
        });
        pieces.iter().fold(Self::default(), |all, own| Self {
            weight: all.weight + own.weight,
            point: all.point + own.point,
            square: all.square + own.square,
        })
    }

    fn add(&mut self, weight: f64, point: DVec3) {
        self.weight += weight;
        self.point += point * weight;
        self.square += point.length_squared() * weight;
    }

    /// The weighted mean; `None` without weight.
    fn mean(&self) -> Option<DVec3> {
        Some(self.point / self.weight).filter(|mean| self.weight > 0.0 && mean.is_finite())
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
        for (node, &k) in ownership.hard.iter().enumerate().filter(|(_, k)| **k != UNHELD) {
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

/// Relative residual to which fields are solved. Blending needs no more, and bends show no difference below it.
const FIELD_TOLERANCE: f64 = 1e-5;

/// Solves the fields of all handles in one go, all columns together. Also returns the system, if there was anything to solve.
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
    let active: Vec<usize> = (0..=handles)
        .zip(ownership.active(handles))
        .filter(|(_, a)| *a)
        .map(|(k, _)| k)
        .collect();
    let mut solved = HarmonicFields {
        fields: vec![Vec::new(); handles + 1],
        covered,
        ..HarmonicFields::default()
    };
    let Some((&first, others)) = active.split_first() else {
        return Ok((solved, None));
    };
    let (mut x, mut system) = (Vec::new(), None);
    if !others.is_empty() {
        let columns = solve_columns(body, ownership, &solved.covered, others, exec)?;
        (x, system, solved.iterations) = (columns.x, Some(columns.system), columns.iterations);
    }
    exec.pool
        .install(|| share_out(body, &mut solved, first, others, &mut x));
    Ok((solved, system))
}

/// The fields of all handles but one as they were solved, and the system that they were solved with.
struct SolvedColumns {
    /// By node: a value for each column.
    x: Vec<f64>,
    system: LinearSystem,
    iterations: usize,
}

/// Solves the fields of the handles `others`, a column for each; `covered` says of each component whether any handle has a
/// say in it.
fn solve_columns(
    body: &DeformableBody,
    ownership: &NodeOwnership,
    covered: &[bool],
    others: &[usize],
    exec: &Exec<'_>,
) -> Result<SolvedColumns, Error> {
    let nodes = body.nodes();
    let columns = others.len();
    let in_cover = |i: usize| covered[body.graph.component[i] as usize];
    let mut x = vec![0.0; nodes * columns];
    let mut column_of = vec![usize::MAX; others.iter().max().map_or(0, |k| k + 1)];
    others.iter().enumerate().for_each(|(c, &k)| column_of[k] = c);
    for (node, &k) in ownership.hard.iter().enumerate() {
        if k != UNHELD && column_of[k as usize] != usize::MAX {
            x[node * columns + column_of[k as usize]] = 1.0;
        }
    }
    let mut rhs = vec![0.0; nodes * columns];
    for &(node, k, stiffness) in ownership.soft.iter() {
        if column_of[k as usize] != usize::MAX {
            rhs[node as usize * columns + column_of[k as usize]] += stiffness;
        }
    }
    let fixed: Vec<bool> = (0..nodes)
        .map(|i| ownership.hard[i] != UNHELD || !in_cover(i))
        .collect();
    let stiffness = ownership.stiffness();
    let constraints = Constraints {
        fixed: &fixed,
        stiffness: stiffness.as_deref(),
    };
    let system = body.hierarchy.constrain(&constraints, exec.pool)?;
    let options = SolveOptions {
        start: InitialGuess::FullMultigrid {
            frames: None,
            rest: None,
        },
        tolerance: Some(FIELD_TOLERANCE),
        ..Default::default()
    };
    let mut workspace = Workspace::default();
    let stats =
        system
            .equations(&body.hierarchy, columns, &rhs)
            .solve(&mut x, &options, &mut workspace, exec, &mut |_| SolveControl::Continue)?;
    Ok(SolvedColumns {
        x,
        system,
        iterations: stats.iterations,
    })
}

/// Makes fields of the columns: the solver stops short of the exact solution, so bounds and sum are restored to the last bit
/// that matters, and the first handle gets what the others leave.
fn share_out(body: &DeformableBody, solved: &mut HarmonicFields, first: usize, others: &[usize], x: &mut [f64]) {
    let (nodes, columns) = (body.nodes(), others.len());
    x.par_chunks_mut(columns.max(1)).for_each(|row| {
        row.iter_mut().for_each(|u| *u = u.clamp(0.0, 1.0));
        let sum: f64 = row.iter().sum();
        if sum > 1.0 {
            row.iter_mut().for_each(|u| *u /= sum);
        }
    });
    for (c, &k) in others.iter().enumerate() {
        solved.fields[k] = (0..nodes).into_par_iter().map(|i| x[i * columns + c] as f32).collect();
    }
    let covered = &solved.covered;
    let rest: Vec<f32> = (0..nodes)
        .into_par_iter()
        .map(|i| match covered[body.graph.component[i] as usize] {
            true => (1.0 - x[i * columns..(i + 1) * columns].iter().sum::<f64>()).clamp(0.0, 1.0) as f32,
            false => 0.0,
        })
        .collect();
    solved.fields[first] = rest;
}

/// A share below this is left out.
const LEAST: f32 = 1e-3;

/// By node the handles that have a say there, the one with the most first, with their shares, which sum to 1.
#[derive(Debug, Clone, Default)]
pub(crate) struct SparseShares {
    /// Where each node's begin; one more at the end.
    first: Vec<u32>,
    shares: Vec<(u32, f32)>,
}

impl SparseShares {
    /// Those of fields.
    pub fn of(fields: &HarmonicFields, nodes: usize, pool: &Pool) -> Self {
        let active: Vec<usize> = (0..fields.fields.len()).filter(|&k| !fields.of(k).is_empty()).collect();
        let of_node = |node: usize| {
            let all = active.iter().map(|&k| (k as u32, fields.of(k)[node]));
            let mut some: Vec<(u32, f32)> = all.filter(|s| s.1 >= LEAST).collect();
            some.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
            let sum: f32 = some.iter().map(|s| s.1).sum();
            some.iter_mut().for_each(|s| s.1 /= sum);
            some
        };
        let by_node: Vec<Vec<(u32, f32)>> = pool.map(nodes, 1024, of_node);
        let mut first = Vec::with_capacity(nodes + 1);
        first.push(0);
        let mut total = 0;
        for some in &by_node {
            total += some.len() as u32;
            first.push(total);
        }
        Self {
            first,
            shares: by_node.into_iter().flatten().collect(),
        }
    }

    /// How many nodes there are.
    pub fn nodes(&self) -> usize {
        self.first.len().saturating_sub(1)
    }

    /// The shares at a node.
    pub fn at(&self, node: usize) -> &[(u32, f32)] {
        &self.shares[self.first[node] as usize..self.first[node + 1] as usize]
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.first.capacity() * 4 + self.shares.capacity() * 8
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::body::BodyOptions;
    use crate::handles::ownership::{HandleConstraint, HandleSetup};
    use crate::handles::system::HandleSystem;
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
}
