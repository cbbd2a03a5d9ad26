//! A sparse symmetric matrix in compressed rows, in double precision, as the peers hold it.

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

    /// Where each row begins, and the end.
    pub fn starts(&self) -> &[i64] {
        &self.starts
    }

    /// Column of each entry.
    pub fn columns(&self) -> &[i32] {
        &self.columns
    }

    /// Value of each entry.
    pub fn values(&self) -> &[f64] {
        &self.values
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
            // Rounding of the sum is no stiffness.
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
mod tests {
    use super::super::problem::tests::chain_problem;
    use super::*;

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
