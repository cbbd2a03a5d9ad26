//! Direct solution of small dense systems.

use crate::lanes::{WIDTH, WideLanes};

/// A pivot below this part of its diagonal entry belongs to a part of the graph that nothing holds.
const SINGULAR: f64 = 1e-9;

/// The inverse of a small symmetric matrix, from its Cholesky factor.
///
/// On a singular part (a component without constraint) one pivot comes out as nothing but rounding; its diagonal entry
/// takes its place, which pins that unknown softly. For right-hand sides that sum to zero over the part this still
/// gives a solution.
#[derive(Debug, Default)]
pub(crate) struct Inverse {
    size: usize,
    entries: Vec<f64>,
}

impl Inverse {
    /// Inverts the `size` × `size` matrix, row-major, of which only the lower triangle is read.
    pub(crate) fn new(mut matrix: Vec<f64>, size: usize) -> Self {
        let n = size;
        let a = &mut matrix;
        // Cholesky, row by row: rows are contiguous in both factors of each inner product.
        for i in 0..n {
            let (above, row) = a.split_at_mut(i * n);
            for j in 0..i {
                let other = &above[j * n..j * n + j + 1];
                row[j] = (row[j] - dot(&row[..j], &other[..j])) / other[j];
            }
            let diagonal = row[i];
            let pivot = diagonal - dot(&row[..i], &row[..i]);
            // Not a plain comparison: a pivot that is not a number must be replaced too.
            let sound = pivot > SINGULAR * diagonal;
            row[i] = if sound {
                pivot.sqrt()
            } else {
                diagonal.max(f64::MIN_POSITIVE).sqrt()
            };
        }
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

/// Inner product in four interleaved sums.
#[inline]
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let mut sums = [0.0; 4];
    let (fours_a, fours_b) = (a.chunks_exact(4), b.chunks_exact(4));
    let rest: f64 = fours_a
        .remainder()
        .iter()
        .zip(fours_b.remainder())
        .map(|(x, y)| x * y)
        .sum();
    for (x, y) in fours_a.zip(fours_b) {
        for c in 0..4 {
            sums[c] += x[c] * y[c];
        }
    }
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}

#[cfg(test)]
mod tests {
    use super::*;

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
            let inverse = Inverse::new(a.clone(), n);
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
        let inverse = Inverse::new(a.clone(), n);
        let mut b = vec![[0.0; WIDTH]; n];
        b[2] = [1.0; WIDTH];
        b[9] = [-1.0; WIDTH];
        let x: Vec<WideLanes> = (0..n).map(|i| inverse.row_times(i, &b)).collect();
        for i in 0..n {
            let ax: f64 = (0..n).map(|j| a[i * n + j] * x[j][1]).sum();
            assert!((ax - b[i][1]).abs() < 1e-9, "row {i}: {ax}");
        }
        assert_eq!(Inverse::new(vec![0.0], 1).row_times(0, &[[0.0; WIDTH]]), [0.0; WIDTH]);
    }
}
