//! Direct solution of small dense systems by Cholesky factors of dense symmetric positive definite matrices, by blocks, on any number of threads.
//!
//! The crate factors dense matrices here alone: [`CholeskyFactor`] block after block, and the inverse of a coarsest level as
//! one block. What differs is the rule for pivots that the matrix does not determine.

use std::ops::Range;

use rayon::prelude::*;

use crate::lanes::{WIDTH, WideLanes};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;

/// A pivot below this part of its diagonal entry belongs to a part of the graph that nothing holds.
const SINGULAR: f64 = 1e-9;

/// The inverse of a small symmetric matrix, from its Cholesky factor.
///
/// On a singular part (a component without constraint) one pivot comes out as nothing but rounding; its diagonal entry
/// takes its place, which pins that unknown softly. For right-hand sides that sum to zero over the part this still
/// gives a solution.
#[derive(Debug, Default)]
pub(crate) struct DenseInverse {
    size: usize,
    entries: Vec<f64>,
}

impl DenseInverse {
    /// Inverts the `size` × `size` matrix, row-major, of which only the lower triangle is read.
    pub(crate) fn new(mut matrix: Vec<f64>, size: usize) -> Self {
        let n = size;
        let a = &mut matrix;
        // Not a plain comparison: a pivot that is not a number must be replaced too.
        factor_rows(a, n, 0..n, |diagonal, pivot| match pivot > SINGULAR * diagonal {
            true => pivot,
            false => diagonal.max(f64::MIN_POSITIVE),
        });
        // The transposed inverse of the factor, row by row, in the upper triangle of a second matrix.
        let mut inverse = vec![0.0; n * n];
        for j in 0..n {
            let column = &mut inverse[j * n..(j + 1) * n];
            column[j] = 1.0 / a[j * n + j];
            for i in j + 1..n {
                let row = &a[i * n..i * n + i + 1];
                column[i] = -dot(&row[j..i], &column[j..i]) / row[i];
            }
        }
        // A⁻¹ = L⁻ᵀ L⁻¹: inner products of those rows from the larger index on.
        let mut entries = a.split_off(0);
        for i in 0..n {
            for j in 0..=i {
                let v = dot(&inverse[i * n + i..(i + 1) * n], &inverse[j * n + i..(j + 1) * n]);
                entries[i * n + j] = v;
                entries[j * n + i] = v;
            }
        }
        Self { size, entries }
    }

    pub(crate) fn size(&self) -> usize {
        self.size
    }

    /// Row `i` of the inverse times `b`.
    #[inline]
    pub(crate) fn row_times(&self, i: usize, b: &[WideLanes]) -> WideLanes {
        let mut sum = [0.0; WIDTH];
        for (a, b) in self.entries[i * self.size..(i + 1) * self.size].iter().zip(b) {
            for c in 0..WIDTH {
                sum[c] += a * b[c];
            }
        }
        sum
    }

    pub(crate) fn byte_size(&self) -> usize {
        8 * self.entries.len()
    }
}

/// Columns that are eliminated together.
const BLOCK: usize = 48;

/// The lower triangular factor L of A = L Lᵀ.
///
/// ```
/// use pliant_solver::CholeskyFactor;
/// use pliant_exec::Exec;
/// use pliant_exec::pool::Pool;
/// use pliant_exec::progress::Silent;
///
/// let pool = Pool::new(1)?;
/// let matrix = vec![4.0, 2.0, 2.0, 3.0];
/// let factor = CholeskyFactor::new(matrix, 2, 1e-12, &Exec::new(&pool, &Silent))?;
/// let mut x = [[8.0, 4.0, 0.0], [7.0, 2.0, 0.0]];
/// factor.solve(&mut x);
/// assert!((x[0][0] - 1.25).abs() < 1e-12 && (x[1][0] - 1.5).abs() < 1e-12);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Clone, Default)]
pub struct CholeskyFactor {
    size: usize,
    /// Row-major; only the lower triangle means anything.
    factor: Vec<f64>,
}

impl CholeskyFactor {
    /// Factors the `size` × `size` matrix, row-major, of which the lower triangle is read. Pivots below `least` are raised
    /// to it, which keeps unknowns near 0 that the matrix does not determine.
    ///
    /// # Errors
    /// [`Cancelled`], asked between blocks of columns.
    pub fn new(mut matrix: Vec<f64>, size: usize, least: f64, exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let n = size;
        for from in (0..n).step_by(BLOCK) {
            exec.check()?;
            let to = n.min(from + BLOCK);
            let (above, below) = matrix.split_at_mut(to * n);
            let block = &mut above[from * n..];
            // `max` also replaces what is not a number.
            factor_rows(block, n, from..to, |_, pivot| pivot.max(least));
            let block = &*block;
            exec.pool.install(|| {
                // The block's columns of every row below it.
                below.par_chunks_exact_mut(n).for_each(|row| {
                    for j in from..to {
                        let other = &block[(j - from) * n..(j - from) * n + n];
                        row[j] = (row[j] - dot(&row[from..j], &other[from..j])) / other[j];
                    }
                });
                // Those columns once more, side by side, so that rows can be updated from each other.
                let width = to - from;
                let panel: Vec<f64> = below
                    .chunks_exact(n)
                    .flat_map(|row| row[from..to].iter().copied())
                    .collect();
                below.par_chunks_exact_mut(n).enumerate().for_each(|(i, row)| {
                    let own = &panel[i * width..(i + 1) * width];
                    let others = panel.chunks_exact(width).take(i + 1);
                    row[to..=to + i]
                        .iter_mut()
                        .zip(others)
                        .for_each(|(v, other)| *v -= dot(own, other));
                });
            });
        }
        Ok(Self { size, factor: matrix })
    }

    /// Solves A x = b for three right-hand sides at once, in place.
    pub fn solve(&self, b: &mut [[f64; 3]]) {
        let n = self.size;
        let row = |i: usize| &self.factor[i * n..(i + 1) * n];
        for i in 0..n {
            let mut v = b[i];
            for (l, x) in row(i)[..i].iter().zip(&*b) {
                (0..3).for_each(|c| v[c] -= l * x[c]);
            }
            b[i] = v.map(|v| v / row(i)[i]);
        }
        for i in (0..n).rev() {
            let x = b[i].map(|v| v / row(i)[i]);
            b[i] = x;
            for (l, v) in row(i)[..i].iter().zip(&mut *b) {
                (0..3).for_each(|c| v[c] -= l * x[c]);
            }
        }
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.factor.capacity() * 8
    }
}

/// Factors the square on the diagonal that the columns of `range` have in the rows of `block`, which begin with row
/// `range.start` and are `n` long. `pivot_rule` turns a diagonal entry and its pivot into the pivot to use.
pub(crate) fn factor_rows(block: &mut [f64], n: usize, range: Range<usize>, pivot_rule: impl Fn(f64, f64) -> f64) {
    let from = range.start;
    for i in range {
        // Rows are contiguous in both factors of each inner product.
        let (above, row) = block.split_at_mut((i - from) * n);
        for j in from..i {
            let other = &above[(j - from) * n..(j - from) * n + n];
            row[j] = (row[j] - dot(&row[from..j], &other[from..j])) / other[j];
        }
        row[i] = pivot_rule(row[i], row[i] - dot(&row[from..i], &row[from..i])).sqrt();
    }
}

/// Inner product in four interleaved sums.
#[inline]
pub(crate) fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (fours_a, rest_a) = a.as_chunks::<4>();
    let (fours_b, rest_b) = b.as_chunks::<4>();
    for (x, y) in fours_a.iter().zip(fours_b) {
        (0..4).for_each(|c| sums[c] += x[c] * y[c]);
    }
    let rest: f64 = rest_a.iter().zip(rest_b).map(|(x, y)| x * y).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    fn laplacian(n: usize, extra: f64) -> Vec<f64> {
        let mut a = vec![0.0; n * n];
        for i in 1..n {
            a[i * n + i] += 1.0;
            a[(i - 1) * n + i - 1] += 1.0;
            a[i * n + i - 1] -= 1.0;
            a[(i - 1) * n + i] -= 1.0;
        }
        a[0] += extra;
        a
    }

    #[test]
    fn the_inverse_undoes_the_matrix() {
        for n in [1usize, 2, 3, 7, 40] {
            let a = laplacian(n, 0.5);
            let inverse = DenseInverse::new(a.clone(), n);
            for k in 0..n {
                let column: Vec<WideLanes> = (0..n).map(|i| [a[i * n + k], 0.0, -a[i * n + k], 0.0]).collect();
                for i in 0..n {
                    let v = inverse.row_times(i, &column);
                    let want = f64::from(u8::from(i == k));
                    assert!(
                        (v[0] - want).abs() < 1e-9 && (v[2] + want).abs() < 1e-9,
                        "n {n}: {v:?} at {i},{k}"
                    );
                }
            }
        }
    }

    #[test]
    fn a_singular_part_still_solves_consistent_systems() {
        let n = 12;
        let a = laplacian(n, 0.0);
        let inverse = DenseInverse::new(a.clone(), n);
        let mut b = vec![[0.0; WIDTH]; n];
        b[2] = [1.0; WIDTH];
        b[9] = [-1.0; WIDTH];
        let x: Vec<WideLanes> = (0..n).map(|i| inverse.row_times(i, &b)).collect();
        for i in 0..n {
            let ax: f64 = (0..n).map(|j| a[i * n + j] * x[j][1]).sum();
            assert!((ax - b[i][1]).abs() < 1e-9, "row {i}: {ax}");
        }
        assert_eq!(
            DenseInverse::new(vec![0.0], 1).row_times(0, &[[0.0; WIDTH]]),
            [0.0; WIDTH]
        );
    }

    #[test]
    fn the_solution_satisfies_the_equations_on_any_number_of_threads() {
        let sizes: &[usize] = if cfg!(miri) {
            &[1, 3, 49]
        } else {
            &[1, 3, 47, 48, 49, 131]
        };
        for &n in sizes {
            let entry = |i: usize, j: usize| {
                let near = 1.0 / (1.0 + (i.abs_diff(j)) as f64);
                if i == j { 2.0 + near } else { near }
            };
            let matrix: Vec<f64> = (0..n * n).map(|e| entry(e / n, e % n)).collect();
            let b: Vec<[f64; 3]> = (0..n).map(|i| [i as f64, 1.0, -0.5 * (i % 3) as f64]).collect();
            let solutions = [1, 2, 3].map(|threads| {
                let pool = Pool::new(threads).unwrap();
                let factor = CholeskyFactor::new(matrix.clone(), n, 0.0, &Exec::new(&pool, &Silent)).unwrap();
                let mut x = b.clone();
                factor.solve(&mut x);
                x
            });
            assert!(solutions.iter().all(|s| *s == solutions[0]), "the same bits");
            for i in 0..n {
                for c in 0..3 {
                    let left: f64 = (0..n).map(|j| entry(i, j) * solutions[0][j][c]).sum();
                    assert!((left - b[i][c]).abs() < 1e-9, "row {i} of {n}");
                }
            }
        }
    }

    #[test]
    fn what_the_matrix_does_not_determine_stays_finite() {
        let pool = Pool::new(1).unwrap();
        let factor = CholeskyFactor::new(vec![1.0, 1.0, 1.0, 1.0], 2, 1e-6, &Exec::new(&pool, &Silent)).unwrap();
        let mut x = [[1.0; 3]; 2];
        factor.solve(&mut x);
        assert!(x.iter().all(|x| x[0].is_finite() && x[0].abs() < 2.0), "{x:?}");
    }
}
