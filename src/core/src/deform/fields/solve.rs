//! Solving the fields of all handles in one go.

use crate::deform::body::DeformableBody;
use crate::deform::error::Error;
use crate::deform::fields::harmonic::HarmonicFields;
use crate::deform::handles::ownership::{NOBODY, NodeOwnership};
use crate::exec::Exec;
use crate::solver::{Constraints, InitialGuess, LinearSystem, SolveControl, SolveOptions, Workspace};
use rayon::prelude::*;

/// Relative residual to which fields are solved. Blending needs no more, and bends show no difference below it.
const FIELD_TOLERANCE: f64 = 1e-5;

/// Solves the fields of all handles in one go, all columns together. Also returns the system, if there was anything to solve.
///
/// A solve begins from nothing even where an edit has changed little: fields that began from those before the edit would
/// depend, within their tolerance, on when the handles were set.
pub(in crate::deform) fn solve_fields(
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
        if k != NOBODY && column_of[k as usize] != usize::MAX {
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
        .map(|i| ownership.hard[i] != NOBODY || !in_cover(i))
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
