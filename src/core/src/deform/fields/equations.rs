//! The equations of first-pass fields, a column for each handle but one.

use crate::deform::body::DeformableBody;
use rayon::prelude::*;

/// The equations of all fields but one, a column for each.
pub(in crate::deform) struct FieldEquations<'a> {
    pub body: &'a DeformableBody,
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
pub(in crate::deform) fn references(
    body: &DeformableBody,
    columns: usize,
    fixed: &[bool],
    rhs: &[f64],
    x: &[f64],
) -> Vec<f64> {
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
