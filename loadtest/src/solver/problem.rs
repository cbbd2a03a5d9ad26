//! The peers' problem file: a sparse symmetric matrix, three right-hand sides, and rest positions of its vertices.
//!
//! Little-endian: magic u64, n u64, nnz u64, row starts i64 × (n + 1), columns i32 × nnz, values f64 × nnz, right-hand
//! sides f64 × 3 n by row, rest positions f64 × 3 n by row. The matrix is whole, with its diagonal.

#![allow(unsafe_code)]

use super::companion::{NumberFile, f64_bytes, write_whole};
use crate::failure::LoadtestFailure;
use std::path::Path;

/// First eight bytes of a problem file.
const MAGIC: u64 = 0x4c41_5031;
/// Bytes before the row starts.
const HEADER: u64 = 24;

/// A linear problem is a system A x = b with three right-hand sides.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct LinearProblem {
    /// A.
    pub matrix: CompressedRows,
    /// b, one row per unknown.
    pub rhs: Vec<[f64; 3]>,
    /// Rest positions of the unknowns' vertices.
    pub rest: Vec<[f64; 3]>,
}

impl LinearProblem {
    /// Reads a file and checks that it holds what the format says: lengths against the file's size, rows rising and in
    /// range, numbers finite.
    pub fn read(path: &Path) -> Result<Self, LoadtestFailure> {
        let mut file = NumberFile::read(path)?;
        let [magic, n, nnz] = file.header()?;
        if magic != MAGIC {
            return Err(file.file_error(format_args!("begins with {magic:#x}, a problem file with {MAGIC:#x}")));
        }
        let rows = n.saturating_add(1);
        file.expect_byte_size(HEADER, &[(rows, 8), (nnz, 12), (n, 48)])?;
        if n > i32::MAX as u64 {
            return Err(file.file_error(format_args!("has {n} rows, at most {} can be numbered", i32::MAX)));
        }
        // Both fit the address space, because the file holds them.
        let (n, nnz) = (n as usize, nnz as usize);
        let starts = file.numbers(n + 1, i64::from_le_bytes)?;
        let columns = file.numbers(nnz, i32::from_le_bytes)?;
        let values = file.numbers(nnz, f64::from_le_bytes)?;
        let matrix = CompressedRows::new(starts, columns, values).map_err(|problem| file.file_error(problem))?;
        let (rhs, rest) = (file.triples(n)?, file.triples(n)?);
        for (what, rows) in [("right-hand side", &rhs), ("rest position", &rest)] {
            if let Some(i) = rows.iter().position(|row| !row.iter().all(|v| v.is_finite())) {
                return Err(file.file_error(format_args!("{what} {i} is {:?}, numbers must be finite", rows[i])));
            }
        }
        Ok(Self { matrix, rhs, rest })
    }

    /// Writes the file.
    pub fn write(&self, path: &Path) -> Result<(), LoadtestFailure> {
        let header = [MAGIC, self.matrix.rows() as u64, self.matrix.entries() as u64];
        let mut bytes: Vec<u8> = header.into_iter().flat_map(u64::to_le_bytes).collect();
        bytes.extend(self.matrix.starts.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(self.matrix.columns.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(self.matrix.values.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(f64_bytes(&self.rhs).chain(f64_bytes(&self.rest)));
        write_whole(path, &bytes)
    }
}

/// A matrix in compressed rows is square, has rising columns in every row and a positive diagonal.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct CompressedRows {
    starts: Vec<i64>,
    columns: Vec<i32>,
    values: Vec<f64>,
}

/// A graph Laplacian is such a matrix seen as a graph, with what its diagonal has beyond the weights of the edges.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GraphLaplacian {
    /// Where each row of `neighbours` begins, and the end.
    pub offsets: Vec<u32>,
    /// Neighbours of all rows.
    pub neighbours: Vec<u32>,
    /// Weights of the edges; `None` when all are 1.
    pub weights: Option<Vec<f32>>,
    /// What the diagonal has above the sum of its row's weights.
    pub stiffness: Vec<f64>,
}

impl CompressedRows {
    /// Checks and takes the three parts. The text says which row is wrong.
    pub fn new(starts: Vec<i64>, columns: Vec<i32>, values: Vec<f64>) -> Result<Self, String> {
        let Some(n) = starts.len().checked_sub(1) else {
            return Err("there are no row starts".into());
        };
        if columns.len() != values.len() {
            return Err(format!(
                "there are {} columns for {} values",
                columns.len(),
                values.len()
            ));
        }
        if starts[0] != 0 || starts[n] != columns.len() as i64 {
            let (first, last, entries) = (starts[0], starts[n], columns.len());
            return Err(format!(
                "row starts go from {first} to {last}, they must go from 0 to {entries}"
            ));
        }
        for i in 0..n {
            let row = usize::try_from(starts[i]).ok().zip(usize::try_from(starts[i + 1]).ok());
            let Some(row) = row.filter(|r| r.0 <= r.1 && r.1 <= columns.len()) else {
                let (from, to) = (starts[i], starts[i + 1]);
                return Err(format!("row {i} spans {from}..{to}, row starts must not decrease"));
            };
            let (mut before, mut diagonal) = (-1, false);
            for k in row.0..row.1 {
                let (j, v) = (columns[k], values[k]);
                if j <= before || j as usize >= n {
                    return Err(format!("row {i} has column {j}, columns must rise and be below {n}"));
                }
                if !v.is_finite() {
                    return Err(format!("row {i} has the value {v}, values must be finite"));
                }
                diagonal |= j as usize == i && v > 0.0;
                before = j;
            }
            if !diagonal {
                return Err(format!("row {i} has no positive diagonal"));
            }
        }
        Ok(Self {
            starts,
            columns,
            values,
        })
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.starts.len() - 1
    }

    /// Number of entries.
    pub fn entries(&self) -> usize {
        self.columns.len()
    }

    /// Bytes in the peers' layout: 12 an entry and 8 a row start.
    pub fn byte_size(&self) -> usize {
        12 * self.entries() + 8 * (self.rows() + 1)
    }

    /// y = A x for three columns: the work unit. One thread, row by row, one pass, with what the processor has, as the
    /// peers' loop is compiled for the machine that it runs on.
    ///
    /// # Panics
    /// When `x` or `y` have another number of rows.
    pub fn multiply(&self, x: &[[f64; 3]], y: &mut [[f64; 3]]) {
        #[cfg(target_arch = "x86_64")]
        if std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma") {
            // SAFETY: the processor has both.
            unsafe { self.multiply_fused(x, y) };
            return;
        }
        self.multiply_by(x, y, |v, p, sum| v * p + sum);
    }

    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2,fma")]
    fn multiply_fused(&self, x: &[[f64; 3]], y: &mut [[f64; 3]]) {
        self.multiply_by(x, y, f64::mul_add);
    }

    #[inline(always)]
    fn multiply_by(&self, x: &[[f64; 3]], y: &mut [[f64; 3]], add: impl Fn(f64, f64, f64) -> f64) {
        assert!(x.len() == self.rows() && y.len() == self.rows());
        let mut begin = 0;
        for (i, y) in y.iter_mut().enumerate() {
            let end = self.starts[i + 1] as usize;
            let (mut a, mut b, mut c) = (0.0, 0.0, 0.0);
            for k in begin..end {
                // SAFETY: `new` has made sure that row starts do not decrease and end at the number of entries, and
                // that every column is below the number of rows, which is the length of `x`. The unit that all figures
                // are divided by must not be slowed down by checks that the peers' loop does not have.
                let (v, p) = unsafe {
                    let column = *self.columns.get_unchecked(k) as usize;
                    (*self.values.get_unchecked(k), x.get_unchecked(column))
                };
                (a, b, c) = (add(v, p[0], a), add(v, p[1], b), add(v, p[2], c));
            }
            *y = [a, b, c];
            begin = end;
        }
    }

    /// ‖b − A x‖₂ / ‖b‖₂ of each column, and of all together.
    pub fn residuals(&self, rhs: &[[f64; 3]], x: &[[f64; 3]]) -> ([f64; 3], f64) {
        let mut product = vec![[0.0; 3]; self.rows()];
        self.multiply(x, &mut product);
        let (mut rr, mut bb) = ([0.0; 3], [0.0; 3]);
        for (b, p) in rhs.iter().zip(&product) {
            for c in 0..3 {
                rr[c] += (b[c] - p[c]) * (b[c] - p[c]);
                bb[c] += b[c] * b[c];
            }
        }
        let relative = |r: f64, b: f64| (r / if b > 0.0 { b } else { 1.0 }).sqrt();
        (
            [0, 1, 2].map(|c| relative(rr[c], bb[c])),
            relative(rr.iter().sum(), bb.iter().sum()),
        )
    }

    /// The graph whose Laplacian, with something on the diagonal, this matrix is.
    ///
    /// # Errors
    /// When it is none: an off-diagonal entry that is not negative, or a diagonal below the sum of its row's weights.
    pub fn laplacian(&self) -> Result<GraphLaplacian, String> {
        let n = self.rows();
        let entries = self.entries() - n;
        if u32::try_from(entries).is_err() {
            return Err(format!(
                "there are {entries} off-diagonal entries, at most {} can be counted",
                u32::MAX
            ));
        }
        let mut graph = GraphLaplacian {
            offsets: Vec::with_capacity(n + 1),
            neighbours: Vec::with_capacity(entries),
            weights: Some(Vec::with_capacity(entries)),
            stiffness: Vec::with_capacity(n),
        };
        graph.offsets.push(0);
        let mut weights = Vec::with_capacity(entries);
        let mut uniform = true;
        for i in 0..n {
            let (mut diagonal, mut sum) = (0.0, 0.0);
            for k in self.starts[i] as usize..self.starts[i + 1] as usize {
                let (j, v) = (self.columns[k], self.values[k]);
                if j as usize == i {
                    diagonal = v;
                    continue;
                }
                if v >= 0.0 {
                    return Err(format!("entry ({i}, {j}) is {v}, a graph Laplacian's are negative"));
                }
                sum -= v;
                uniform &= v == -1.0;
                graph.neighbours.push(j as u32);
                weights.push(-v as f32);
            }
            let extra = diagonal - sum;
            if extra < -1e-9 * diagonal {
                return Err(format!(
                    "the diagonal of row {i} is {diagonal}, below {sum}, the sum of its weights"
                ));
            }
            // Rounding of the sum is not stiffness.
            graph.stiffness.push(if extra.abs() < 1e-12 * diagonal {
                0.0
            } else {
                extra.max(0.0)
            });
            graph.offsets.push(graph.neighbours.len() as u32);
        }
        graph.weights = (!uniform).then_some(weights);
        Ok(graph)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A chain of `n` vertices, both ends tied to given neighbours.
    pub(crate) fn chain_problem(n: usize) -> LinearProblem {
        let (mut starts, mut columns, mut values) = (vec![0], Vec::new(), Vec::new());
        for i in 0..n {
            for j in i.saturating_sub(1)..(i + 2).min(n) {
                columns.push(j as i32);
                values.push(if i == j { 2.0 } else { -1.0 });
            }
            starts.push(columns.len() as i64);
        }
        LinearProblem {
            matrix: CompressedRows::new(starts, columns, values).unwrap(),
            rhs: (0..n).map(|i| [1.0, i as f64, -0.5]).collect(),
            rest: (0..n).map(|i| [i as f64, 0.0, 0.25]).collect(),
        }
    }

    fn refused(path: &Path) -> String {
        match LinearProblem::read(path) {
            Err(LoadtestFailure::Usage(text)) => text,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_problem_survives_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("chain.bin");
        let problem = chain_problem(9);
        problem.write(&path).unwrap();
        assert_eq!(LinearProblem::read(&path).unwrap(), problem);
        assert_eq!(std::fs::metadata(&path).unwrap().len(), 24 + 80 + 12 * 25 + 48 * 9);
        assert_eq!(
            std::fs::read_dir(folder.path()).unwrap().count(),
            1,
            "nothing is left beside it"
        );
    }

    #[test]
    fn lengths_are_checked_before_anything_is_allocated() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bad.bin");
        chain_problem(4).write(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let with = |at: usize, value: u64| {
            let mut bytes = whole.clone();
            bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
            std::fs::write(&path, bytes).unwrap();
            refused(&path)
        };
        assert!(with(0, 7).contains("begins with 0x7"));
        for huge in [5, 1 << 40, u64::MAX / 24, u64::MAX] {
            assert!(with(8, huge).contains("promises"), "n = {huge}");
            assert!(with(16, huge).contains("promises"), "nnz = {huge}");
        }
        std::fs::write(&path, &whole[..20]).unwrap();
        assert!(!refused(&path).is_empty());
        std::fs::write(&path, &whole[..whole.len() - 1]).unwrap();
        assert!(refused(&path).contains("promises"));
        // A row start out of order, a column out of range, a value that is not a number.
        assert!(with(24 + 8, u64::MAX).contains("row 0"));
        assert!(with(24 + 40, 0x0000_0009_0000_0000).contains("column 9"));
        assert!(with(24 + 40 + 40, f64::NAN.to_bits()).contains("NaN"));
        assert!(with(whole.len() - 8, f64::INFINITY.to_bits()).contains("rest position 3"));
    }

    #[test]
    fn a_chain_is_a_graph_tied_at_its_ends() {
        let graph = chain_problem(4).matrix.laplacian().unwrap();
        assert_eq!(
            (graph.offsets, graph.neighbours),
            (vec![0, 1, 3, 5, 6], vec![1, 0, 2, 1, 3, 2])
        );
        assert_eq!((graph.weights, graph.stiffness), (None, vec![1.0, 0.0, 0.0, 1.0]));
    }

    #[test]
    fn what_is_no_laplacian_is_refused() {
        let matrix = |off: f64, diagonal: f64| {
            CompressedRows::new(vec![0, 2, 4], vec![0, 1, 0, 1], vec![diagonal, off, off, diagonal]).unwrap()
        };
        assert!(matrix(0.5, 1.0).laplacian().unwrap_err().contains("(0, 1) is 0.5"));
        assert!(matrix(-2.0, 1.0).laplacian().unwrap_err().contains("row 0 is 1"));
        assert_eq!(matrix(-2.0, 3.0).laplacian().unwrap().weights, Some(vec![2.0, 2.0]));
    }

    #[test]
    fn the_residual_is_of_the_system_as_given() {
        let problem = chain_problem(3);
        let x = [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [3.0, 0.0, 0.0]];
        let mut y = vec![[0.0; 3]; 3];
        problem.matrix.multiply(&x, &mut y);
        assert_eq!(y.iter().map(|y| y[0]).collect::<Vec<_>>(), [0.0, 0.0, 4.0]);
        let (each, _) = problem.matrix.residuals(&problem.rhs, &x);
        assert!((each[0] - (11.0f64 / 3.0).sqrt()).abs() < 1e-15);
        assert_eq!(each[1..], [1.0, 1.0], "nothing is solved there");
    }

    #[test]
    fn rows_without_a_diagonal_are_refused() {
        let refused = CompressedRows::new(vec![0, 1, 2], vec![1, 0], vec![-1.0, -1.0]).unwrap_err();
        assert!(refused.contains("row 0 has no positive diagonal"));
    }
}
