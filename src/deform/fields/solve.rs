//! Solving the fields of all handles in one go: from nothing, or from those before an edit.

use crate::deform::body::DeformableBody;
use crate::deform::error::Error;
use crate::deform::fields::equations::{FieldEquations, references};
use crate::deform::fields::harmonic::HarmonicFields;
use crate::deform::fields::restart::FieldRestart;
use crate::deform::handles::ownership::{NOBODY, NodeOwnership};
use crate::exec::Exec;
use crate::solver::{Constraints, InitialGuess, LinearSystem, SolveControl, SolveOptions, Workspace};
use rayon::prelude::*;
use std::sync::Arc;

/// Relative residual to which fields are solved. Blending needs no more, and bends show no difference below it.
const FIELD_TOLERANCE: f64 = 1e-5;

/// The same for fields that begin from those before an edit: what was relaxed around the edit mostly reaches it at once, for
/// several edits in turn. What they leave adds up until it is reached, and a solve takes it away.
const RESTARTED_TOLERANCE: f64 = 3e-5;

/// Solves the fields of all holds in one go, all columns together: from nothing, or from those before an edit. Also answers
/// the system, if there was anything to solve.
pub(in crate::deform) fn solve(
    body: &DeformableBody,
    ownership: &NodeOwnership,
    holds: usize,
    restart: Option<(&FieldRestart<'_>, &HarmonicFields)>,
    exec: &Exec<'_>,
) -> Result<(HarmonicFields, Option<LinearSystem>), Error> {
    let nodes = body.nodes();
    let covered = ownership.covered(body);
    let active: Vec<usize> = (0..=holds)
        .zip(ownership.active(holds))
        .filter(|(_, a)| *a)
        .map(|(k, _)| k)
        .collect();
    let mut fields = vec![Vec::new(); holds + 1];
    let Some((&first, others)) = active.split_first() else {
        let none = HarmonicFields {
            fields,
            covered,
            ..HarmonicFields::default()
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
        let equations = FieldEquations {
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
            let from_nothing = InitialGuess::FullMultigrid {
                frames: None,
                rest: None,
            };
            let (start, tolerance) = match guess {
                Some(_) => (InitialGuess::Given, RESTARTED_TOLERANCE),
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
                &mut |_| SolveControl::Continue,
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
    let fields = HarmonicFields {
        fields,
        covered,
        iterations,
        residuals,
        hard: Arc::clone(&ownership.hard),
    };
    Ok((fields, solved))
}
