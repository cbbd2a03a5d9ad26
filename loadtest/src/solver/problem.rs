//! The peers' problem file: a sparse symmetric matrix, three right-hand sides, and rest positions of its vertices.
//!
//! Little-endian: magic u64, n u64, nnz u64, row starts i64 × (n + 1), columns i32 × nnz, values f64 × nnz, right-hand
//! sides f64 × 3 n by row, rest positions f64 × 3 n by row. The matrix is whole, with its diagonal.

use super::matrix::CompressedRows;
use super::number_file::{NumberReader, NumberWriter};
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
        let mut file = NumberReader::open(path)?;
        let magic: u64 = file.read_number()?;
        if magic != MAGIC {
            return Err(file.file_error(format_args!("begins with {magic:#x}, a problem file with {MAGIC:#x}")));
        }
        let (n, nnz): (u64, u64) = (file.read_number()?, file.read_number()?);
        let rows = n.saturating_add(1);
        file.expect_byte_size(HEADER, &[(rows, 8), (nnz, 12), (n, 48)])?;
        if n > i32::MAX as u64 {
            return Err(file.file_error(format_args!("has {n} rows, at most {} can be numbered", i32::MAX)));
        }
        // Both fit the address space, because the file holds them.
        let (n, nnz) = (n as usize, nnz as usize);
        let starts: Vec<i64> = file.read_numbers(n + 1)?;
        let columns: Vec<i32> = file.read_numbers(nnz)?;
        let values: Vec<f64> = file.read_numbers(nnz)?;
        let matrix = CompressedRows::new(starts, columns, values).map_err(|problem| file.file_error(problem))?;
        let (rhs, rest) = (file.read_triples(n)?, file.read_triples(n)?);
        for (what, rows) in [("right-hand side", &rhs), ("rest position", &rest)] {
            if let Some(i) = rows.iter().position(|row| !row.iter().all(|v| v.is_finite())) {
                return Err(file.file_error(format_args!("{what} {i} is {:?}, numbers must be finite", rows[i])));
            }
        }
        Ok(Self { matrix, rhs, rest })
    }

    /// Writes the file.
    pub fn write(&self, path: &Path) -> Result<(), LoadtestFailure> {
        let mut file = NumberWriter::create(path)?;
        file.write_numbers([MAGIC, self.matrix.rows() as u64, self.matrix.entries() as u64])?;
        file.write_numbers(self.matrix.starts().iter().copied())?;
        file.write_numbers(self.matrix.columns().iter().copied())?;
        file.write_numbers(self.matrix.values().iter().copied())?;
        file.write_numbers(self.rhs.iter().flatten().copied())?;
        file.write_numbers(self.rest.iter().flatten().copied())?;
        file.finish()
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
        // A row start out of order, a column out of range, a value that is no number.
        assert!(with(24 + 8, u64::MAX).contains("row 0"));
        assert!(with(24 + 40, 0x0000_0009_0000_0000).contains("column 9"));
        assert!(with(24 + 40 + 40, f64::NAN.to_bits()).contains("NaN"));
        assert!(with(whole.len() - 8, f64::INFINITY.to_bits()).contains("rest position 3"));
    }
}
