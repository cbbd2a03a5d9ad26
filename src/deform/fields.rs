//! Bounded harmonic fields: how much each handle has to say at each node (paper section 2.1; Zayer et al. 2005).
//!
//! The field of a handle is 1 on its nodes, 0 on those of the others and harmonic between. All fields sum to 1, so one of
//! them need not be solved for. Soft handles enter as a pull towards 1, which keeps both properties.

use super::rig::{NOBODY, Ownership};
use super::{Body, Error, Restart};
use crate::exec::Exec;
use crate::pool::Pool;
use crate::solver::{Constraints, Control, SolveOptions, Start, System, Workspace};
use rayon::prelude::*;
use std::sync::Arc;

/// Relative residual to which fields are solved. Blending needs no more, and bends show no difference below it.
const FIELD_TOLERANCE: f64 = 1e-5;
/// The same for fields that begin from those before an edit: what was relaxed around the edit mostly reaches it at once, for
/// several edits in turn. What they leave adds up until it is reached, and a solve takes it away.
const RESTARTED_TOLERANCE: f64 = 3e-5;

/// The fields of the handles that constrain one kind of quantity.
#[derive(Debug, Clone, Default)]
pub struct Fields {
    /// By hold, the frozen surroundings last: its field, one value per node; empty for a hold without a say.
    pub(super) fields: Vec<Vec<f32>>,
    /// By component: whether any handle has a say in it. Elsewhere all fields are 0.
    pub(super) covered: Vec<bool>,
    /// Solver iterations.
    pub(super) iterations: usize,
    /// By hold: norm of the residual of its equations, in units of edge weights; infinite where nothing was solved.
    pub(super) residuals: Vec<f64>,
    /// By node: who holds it hard.
    pub(super) hard: Arc<Vec<u32>>,
}

impl Fields {
    /// The field of a hold: one value in [0, 1] per node, or empty when it has no say anywhere.
    pub fn of(&self, hold: usize) -> &[f32] {
        self.fields.get(hold).map_or(&[], Vec::as_slice)
    }

    /// Bytes held on the heap.
    pub fn bytes(&self) -> usize {
        self.fields.iter().map(|f| f.capacity() * 4).sum::<usize>()
            + self.covered.capacity()
            + self.residuals.capacity() * 8
    }
}

/// A hard handle is small when it has less than this part of its component's nodes.
const SMALL: f64 = 1.0 / 256.0;
/// How much of its component all handles together spread over when each is as small as can be.
const SPREAD: f64 = 1.0 / 8.0;
/// The field's value down to which a small handle may spread.
const LOWEST: f32 = 0.5;

impl Fields {
    /// The fields with the surroundings of small handles made parts of them, where rotations are blended; `None` when no
    /// handle is small.
    ///
    /// Around a handle of a few vertices a harmonic field falls like 1 / distance, so nearly all of the way to the other
    /// handles' rotations is made in the first few rings. Where it is above a level c, min(1, u / c) is the field of the
    /// region {u ≥ c}: harmonic outside, with a gradient that is that much gentler. The others share what is left.
    pub(super) fn around_small(&self, body: &Body, ownership: &Ownership, pool: &Pool) -> Option<Self> {
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
    fn levels(&self, body: &Body, ownership: &Ownership) -> Option<Vec<f32>> {
        let mut sizes = vec![0usize; body.graph.components];
        body.graph.component.iter().for_each(|&c| sizes[c as usize] += 1);
        // Of each hold, how many nodes it has and how many its component has.
        let mut holders = vec![(0usize, 0usize); self.fields.len()];
        for (node, &k) in ownership.hard.iter().enumerate().filter(|(_, k)| **k != NOBODY) {
            let (own, of) = &mut holders[k as usize];
            *own += 1;
            *of = (*of).max(sizes[body.graph.component[node] as usize]);
        }
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
            levels[k] = level.clamp(LOWEST, 1.0);
        }
        levels.iter().any(|l| *l < 1.0).then_some(levels)
    }
}

/// Solves the fields of all holds in one go, all columns together: from nothing, or from those before an edit. Also answers
/// the system, if there was anything to solve.
pub(super) fn solve(
    body: &Body,
    ownership: &Ownership,
    holds: usize,
    restart: Option<(&Restart<'_>, &Fields)>,
    exec: &Exec<'_>,
) -> Result<(Fields, Option<System>), Error> {
    let nodes = body.nodes();
    let covered = ownership.covered(body);
    let active: Vec<usize> = (0..=holds)
        .zip(ownership.active(holds))
        .filter(|(_, a)| *a)
        .map(|(k, _)| k)
        .collect();
    let mut fields = vec![Vec::new(); holds + 1];
    let Some((&first, others)) = active.split_first() else {
        let none = Fields {
            fields,
            covered,
            ..Fields::default()
        };
        return Ok((none, None));
    };
    let in_cover = |i: usize| covered[body.graph.component[i] as usize];
    let columns = others.len();
    let mut iterations = 0;
    let mut residuals = vec![f64::INFINITY; holds + 1];
    let mut solved = None;
    let mut x = vec![0.0; nodes * columns];
    if columns > 0 {
        let mut column_of = vec![usize::MAX; holds + 1];
        others.iter().enumerate().for_each(|(c, &k)| column_of[k] = c);
        for (node, &k) in ownership.hard.iter().enumerate() {
            if k != NOBODY && column_of[k as usize] != usize::MAX {
                x[node * columns + column_of[k as usize]] = 1.0;
            }
        }
        let mut rhs = vec![0.0; nodes * columns];
        for &(node, k, stiffness) in &ownership.soft {
            if column_of[k as usize] != usize::MAX {
                rhs[node as usize * columns + column_of[k as usize]] += stiffness;
            }
        }
        let fixed: Vec<bool> = (0..nodes)
            .map(|i| ownership.hard[i] != NOBODY || !in_cover(i))
            .collect();
        let stiffness = ownership.stiffness();
        let constraints = Constraints {
            fixed: &fixed,
            stiffness: stiffness.as_deref(),
        };
        let references = exec.pool.install(|| references(body, columns, &fixed, &rhs, &x));
        let equations = Equations {
            body,
            columns: others,
            fixed: &fixed,
            hard: &ownership.hard,
            is_soft: stiffness.is_some(),
            references: &references,
        };
        // Relaxing takes one thread; constraints have work for the others.
        let (guess, system) = exec.pool.install(|| {
            rayon::join(
                || restart.and_then(|(restart, before)| restart.guess(&equations, before, &mut x, exec.pool)),
                || body.hierarchy.constrain(&constraints, exec.pool),
            )
        });
        let system = system?;
        let mut reached = match &guess {
            Some(residuals) => residuals.clone(),
            None => vec![f64::INFINITY; columns],
        };
        if reached.iter().any(|r| *r > RESTARTED_TOLERANCE) {
            let from_nothing = Start::FullMultigrid {
                frames: None,
                rest: None,
            };
            let (start, tolerance) = match guess {
                Some(_) => (Start::Given, RESTARTED_TOLERANCE),
                None => (from_nothing, FIELD_TOLERANCE),
            };
            let options = SolveOptions {
                start,
                tolerance: Some(tolerance),
                ..Default::default()
            };
            let mut workspace = Workspace::default();
            let stats = system.solve(
                &body.hierarchy,
                columns,
                &rhs,
                &mut x,
                &options,
                &mut workspace,
                exec,
                &mut |_| Control::Continue,
            )?;
            iterations = stats.iterations;
            reached = stats.residuals;
        }
        for ((&k, &reference), relative) in others.iter().zip(&references).zip(reached) {
            residuals[k] = relative * reference;
        }
        solved = Some(system);
    }
    exec.pool.install(|| {
        // The solver stops short of the exact solution, so bounds and sum are restored to the last bit that matters.
        x.par_chunks_mut(columns.max(1)).for_each(|row| {
            row.iter_mut().for_each(|u| *u = u.clamp(0.0, 1.0));
            let sum: f64 = row.iter().sum();
            if sum > 1.0 {
                row.iter_mut().for_each(|u| *u /= sum);
            }
        });
        for (c, &k) in others.iter().enumerate() {
            fields[k] = (0..nodes).into_par_iter().map(|i| x[i * columns + c] as f32).collect();
        }
        fields[first] = (0..nodes)
            .into_par_iter()
            .map(|i| match in_cover(i) {
                true => (1.0 - x[i * columns..(i + 1) * columns].iter().sum::<f64>()).clamp(0.0, 1.0) as f32,
                false => 0.0,
            })
            .collect();
    });
    let fields = Fields {
        fields,
        covered,
        iterations,
        residuals,
        hard: Arc::clone(&ownership.hard),
    };
    Ok((fields, solved))
}

/// The equations of all fields but one, a column for each.
pub(super) struct Equations<'a> {
    pub body: &'a Body,
    /// The hold of each column.
    pub columns: &'a [usize],
    /// By node: whether its value is given.
    pub fixed: &'a [bool],
    /// By node: who holds it hard.
    pub hard: &'a [u32],
    /// Whether any handle pulls.
    pub is_soft: bool,
    /// By column: the norm of the right-hand side with what given values bring in.
    pub references: &'a [f64],
}

/// The norm of each column's right-hand side once given values are moved there. Looks at given nodes and their neighbours
/// alone.
fn references(body: &Body, columns: usize, fixed: &[bool], rhs: &[f64], x: &[f64]) -> Vec<f64> {
    const BLOCK: usize = 1 << 14;
    // Border nodes are few, and so are those with a pull.
    let found = fixed.par_chunks(BLOCK).enumerate().map(|(block, flags)| {
        let first = block * BLOCK;
        let mut near: Vec<u32> = Vec::new();
        for (i, &is_fixed) in (first..).zip(flags) {
            if is_fixed {
                near.extend(body.graph.row(i as u32).iter().filter(|&&j| !fixed[j as usize]));
            } else if rhs[i * columns..(i + 1) * columns].iter().any(|b| *b != 0.0) {
                near.push(i as u32);
            }
        }
        near
    });
    let mut border: Vec<u32> = found.flatten_iter().collect();
    border.sort_unstable();
    border.dedup();
    let mut squares = vec![0.0; columns];
    let mut row = vec![0.0; columns];
    for i in border {
        let i = i as usize;
        row.copy_from_slice(&rhs[i * columns..(i + 1) * columns]);
        for (j, w) in body.edges(i).filter(|&(j, _)| fixed[j]) {
            let given = &x[j * columns..(j + 1) * columns];
            row.iter_mut().zip(given).for_each(|(b, v)| *b += w * v);
        }
        squares.iter_mut().zip(&row).for_each(|(sum, b)| *sum += b * b);
    }
    squares.into_iter().map(f64::sqrt).collect()
}

#[cfg(test)]
mod tests {
    use super::super::{BodyOptions, Hold, Rig, Rigging};
    use super::*;
    use crate::asset::shapes;
    use crate::mesh::{Mesh, Weld};
    use crate::progress::Silent;

    fn rig(body: &Body, holds: [Vec<u32>; 3], pool: &Pool) -> Rig {
        let holds = holds.map(|nodes| Hold {
            nodes,
            position: true,
            rotation: true,
            ..Default::default()
        });
        let rigging = Rigging {
            holds: holds.to_vec(),
            ..Default::default()
        };
        Rig::build(body, rigging, &Exec::new(pool, &Silent)).expect("a rig")
    }

    #[test]
    fn small_handles_take_their_surroundings_along() {
        let pool = Pool::new(2).expect("threads start");
        let (positions, triangles) = shapes::icosphere(1.0, 4);
        let mesh = Mesh::build(&positions, &triangles, Weld::Exact).expect("a mesh");
        let body = Body::build(&mesh, &BodyOptions::default(), &Exec::new(&pool, &Silent)).expect("a body");
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
        let steepest = |fields: &Fields, k: usize| {
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
        let body = Body::build(&mesh, &BodyOptions::default(), &Exec::new(&pool, &Silent)).expect("a body");
        let cap = |keep: &dyn Fn(&glam::DVec3) -> bool| {
            let nodes = (0u32..).zip(&body.graph.positions);
            nodes.filter(|(_, p)| keep(p)).map(|(n, _)| n).collect::<Vec<_>>()
        };
        let holds = [cap(&|p| p.z < -0.8), cap(&|p| p.z > 0.8), cap(&|p| p.x > 0.8)];
        assert!(rig(&body, holds, &pool).blending_fields.is_none());
    }
}
