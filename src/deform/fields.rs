//! Bounded harmonic fields: how much each handle has to say at each node (paper section 2.1; Zayer et al. 2005).
//!
//! The field of a handle is 1 on its nodes, 0 on those of the others and harmonic between. All fields sum to 1, so one of
//! them need not be solved for. Soft handles enter as a pull towards 1, which keeps both properties.

use super::rig::{NOBODY, Ownership};
use super::{Body, Error};
use crate::pool::Pool;
use crate::progress::Progress;
use crate::solver::{Constraints, Control, SolveOptions, Start, Workspace};
use rayon::prelude::*;

/// Relative residual to which fields are solved. Blending needs no more, and bends show no difference below it.
const FIELD_TOLERANCE: f64 = 1e-5;

/// The fields of the handles that constrain one kind of quantity.
#[derive(Debug, Clone, Default)]
pub struct Fields {
    /// By hold, the frozen surroundings last: its field, one value per node; empty for a hold without a say.
    pub(super) fields: Vec<Vec<f32>>,
    /// By component: whether any handle has a say in it. Elsewhere all fields are 0.
    pub(super) covered: Vec<bool>,
    /// Solver iterations.
    pub(super) iterations: usize,
}

impl Fields {
    /// The field of a hold: one value in [0, 1] per node, or empty when it has no say anywhere.
    pub fn of(&self, hold: usize) -> &[f32] {
        self.fields.get(hold).map_or(&[], Vec::as_slice)
    }

    /// Bytes held on the heap.
    pub fn bytes(&self) -> usize {
        self.fields.iter().map(|f| f.capacity() * 4).sum::<usize>() + self.covered.capacity()
    }
}

/// Solves the fields of all holds in one go, all columns together.
pub(super) fn solve(
    body: &Body,
    ownership: &Ownership,
    holds: usize,
    pool: &Pool,
    progress: &dyn Progress,
) -> Result<Fields, Error> {
    let nodes = body.nodes();
    let covered = ownership.covered(body);
    let active: Vec<usize> = (0..=holds)
        .zip(ownership.active(holds))
        .filter(|(_, a)| *a)
        .map(|(k, _)| k)
        .collect();
    let mut fields = vec![Vec::new(); holds + 1];
    let Some((&first, others)) = active.split_first() else {
        return Ok(Fields {
            fields,
            covered,
            iterations: 0,
        });
    };
    let in_cover = |i: usize| covered[body.graph.component[i] as usize];
    let columns = others.len();
    let mut iterations = 0;
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
        let system = body.hierarchy.constrain(&constraints, pool)?;
        let options = SolveOptions {
            start: Start::FullMultigrid {
                frames: None,
                rest: None,
            },
            tolerance: Some(FIELD_TOLERANCE),
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
            pool,
            progress,
            &mut |_| Control::Continue,
        )?;
        iterations = stats.iterations;
    }
    pool.install(|| {
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
    Ok(Fields {
        fields,
        covered,
        iterations,
    })
}
