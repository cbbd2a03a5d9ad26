//! The weighted graph that the solver works on.

use crate::error::Error;
use crate::threads::{Parallelism, piece_count, piece_rows};

/// A symmetric weighted graph in compressed rows.
///
/// Row `i` lists the neighbours `neighbours[offsets[i]..offsets[i + 1]]`, strictly ascending, without `i` itself. For
/// every entry `(i, j)` there is an entry `(j, i)` of the same weight. [`WeightedGraph::check`] verifies all of this;
/// [`Hierarchy::build`](super::Hierarchy::build) checks what memory safety needs and trusts the symmetry.
///
/// ```
/// use pliant_solver::WeightedGraph;
///
/// // A triangle.
/// let graph = WeightedGraph { offsets: &[0, 2, 4, 6], neighbours: &[1, 2, 0, 2, 0, 1], weights: None, positions: None };
/// assert_eq!(graph.vertices(), 3);
/// assert!(graph.check().is_ok());
/// let broken = WeightedGraph { neighbours: &[1, 2, 2, 0, 0, 1], ..graph };
/// assert!(broken.check().unwrap_err().to_string().contains("row 1"));
/// ```
#[derive(Debug, Clone, Copy)]
pub struct WeightedGraph<'a> {
    /// Where each row begins, `vertices + 1` entries, first 0.
    pub offsets: &'a [u32],
    /// Neighbours of all rows, one after the other.
    pub neighbours: &'a [u32],
    /// One positive weight per entry of `neighbours`; `None` means that every weight is 1.
    pub weights: Option<&'a [f32]>,
    /// One position per vertex, any unit. They guide ordering and coarsening, never the equations.
    pub positions: Option<&'a [[f64; 3]]>,
}

impl WeightedGraph<'_> {
    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// Checks array lengths, row order and ranges, weights (finite, positive) and positions (finite).
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first row that breaks a rule.
    pub(crate) fn check_rows(&self, threads: Parallelism) -> Result<(), Error> {
        let invalid = |text: String| Err(Error::Invalid(text));
        let n = self.vertices();
        if self.offsets.is_empty() || self.offsets[0] != 0 {
            return invalid("graph offsets must begin with 0".into());
        }
        if n >= u32::MAX as usize {
            return invalid(format!(
                "the graph has {n} vertices, at most {} are allowed",
                u32::MAX - 1
            ));
        }
        if self.offsets[n] as usize != self.neighbours.len() {
            let (last, len) = (self.offsets[n], self.neighbours.len());
            return invalid(format!("graph offsets end at {last} but there are {len} neighbours"));
        }
        const PIECE: usize = 4096;
        let sound = |k| self.are_sound(piece_rows(k, n, PIECE));
        let sound = threads
            .for_rows(n)
            .map(0..piece_count(n, PIECE), || (), |(), k| sound(k));
        if let Some(k) = sound.iter().position(|s| !s) {
            let i = piece_rows(k, n, PIECE).find(|&i| !self.are_sound(i..i + 1));
            return Err(self.fault(i.unwrap_or(0)));
        }
        if let Some(weights) = self.weights {
            if weights.len() != self.neighbours.len() {
                let (w, e) = (weights.len(), self.neighbours.len());
                return invalid(format!("the graph has {w} weights for {e} neighbours"));
            }
            if let Some(k) = weights.iter().position(|w| !(w.is_finite() && *w > 0.0)) {
                return invalid(format!(
                    "weight {k} of the graph is {}, weights must be positive",
                    weights[k]
                ));
            }
        }
        if let Some(positions) = self.positions {
            if positions.len() != n {
                return invalid(format!("the graph has {} positions for {n} vertices", positions.len()));
            }
            if let Some(i) = positions.iter().position(|p| !p.iter().all(|c| c.is_finite())) {
                return invalid(format!(
                    "position {i} of the graph is {:?}, coordinates must be finite",
                    positions[i]
                ));
            }
        }
        Ok(())
    }

    /// The same of a part: lengths, and the rows of `vertices`, which are below the number of vertices. Other rows are not
    /// read.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first row that breaks a rule.
    pub(crate) fn check_some(&self, vertices: &[u32]) -> Result<(), Error> {
        let n = self.vertices();
        let ends = (
            self.offsets.first().copied(),
            self.offsets.get(n).map(|&end| end as usize),
        );
        if n >= u32::MAX as usize || ends != (Some(0), Some(self.neighbours.len())) {
            return self.check_rows(Parallelism::single_threaded());
        }
        let fits = |len: Option<usize>, want: usize| len.is_none_or(|len| len == want);
        if !fits(self.weights.map(<[f32]>::len), self.neighbours.len()) || !fits(self.positions.map(<[_]>::len), n) {
            return self.check_rows(Parallelism::single_threaded());
        }
        for i in vertices.iter().map(|&v| v as usize) {
            if !self.are_sound(i..i + 1) {
                return Err(self.fault(i));
            }
            let row = self.offsets[i] as usize..self.offsets[i + 1] as usize;
            if let Some(w) = self
                .weights
                .and_then(|w| w[row].iter().find(|w| !(w.is_finite() && **w > 0.0)))
            {
                return Err(Error::Invalid(format!(
                    "row {i} of the graph has the weight {w}, weights must be positive"
                )));
            }
            if let Some(p) = self
                .positions
                .map(|p| p[i])
                .filter(|p| !p.iter().all(|c| c.is_finite()))
            {
                return Err(Error::Invalid(format!(
                    "position {i} of the graph is {p:?}, coordinates must be finite"
                )));
            }
        }
        Ok(())
    }

    /// True if all of these rows lie in `neighbours`, ascend strictly, stay below the number of vertices and do not
    /// hold themselves.
    fn are_sound(&self, rows: std::ops::Range<usize>) -> bool {
        let n = self.vertices() as u32;
        let offsets = &self.offsets[rows.start..rows.end + 1];
        if offsets.windows(2).any(|w| w[0] > w[1]) {
            return false;
        }
        let Some(all) = self.neighbours.get(offsets[0] as usize..offsets[rows.len()] as usize) else {
            return false;
        };
        // Descents of the whole list, less those where one row ends and the next begins: one pass without branches.
        let descents: u32 = all.iter().zip(all.iter().skip(1)).map(|(a, b)| u32::from(a >= b)).sum();
        let (mut between, mut sound) = (0, true);
        for (i, w) in rows.zip(offsets.windows(2)) {
            let (begin, end) = ((w[0] - offsets[0]) as usize, (w[1] - offsets[0]) as usize);
            let row = &all[begin..end];
            if let (Some(&last), true) = (row.last(), sound) {
                sound &= last < n;
                between += all.get(end).map_or(0, |next| u32::from(last >= *next));
            }
            sound &= !holds(row, i as u32);
        }
        sound && descents == between
    }

    /// Says what is wrong with row `i`.
    fn fault(&self, i: usize) -> Error {
        let n = self.vertices();
        let (begin, end) = (self.offsets[i] as usize, self.offsets[i + 1] as usize);
        let Some(row) = self.neighbours.get(begin..end) else {
            return Error::Invalid(format!(
                "row {i} of the graph spans {begin}..{end}, offsets must not decrease"
            ));
        };
        let descends = |k: &usize| *k > 0 && row[*k - 1] >= row[*k];
        let wrong = |k: &usize| descends(k) || row[*k] as usize >= n || row[*k] as usize == i;
        let j = (0..row.len()).find(wrong).map_or(0, |k| row[k]);
        Error::Invalid(format!(
            "row {i} of the graph holds neighbour {j}: neighbours must ascend strictly, be below {n} and not be the \
             vertex itself"
        ))
    }

    /// Checks everything that the type promises, the symmetry of rows and weights included. Linear time.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first place that breaks a rule.
    pub fn check(&self) -> Result<(), Error> {
        self.check_rows(Parallelism::single_threaded())?;
        // Rows ascend and are read in order, so the transpose of a symmetric graph appears in its own order.
        let mut cursor: Vec<u32> = self.offsets[..self.vertices()].to_vec();
        for i in 0..self.vertices() {
            for k in self.offsets[i] as usize..self.offsets[i + 1] as usize {
                let j = self.neighbours[k] as usize;
                let back = cursor[j] as usize;
                if back >= self.offsets[j + 1] as usize || self.neighbours[back] as usize != i {
                    return Err(Error::Invalid(format!(
                        "edge {i}-{j} of the graph has no matching entry in row {j}"
                    )));
                }
                if self.weights.is_some_and(|w| w[k].to_bits() != w[back].to_bits()) {
                    return Err(Error::Invalid(format!(
                        "edge {i}-{j} of the graph has two different weights"
                    )));
                }
                cursor[j] += 1;
            }
        }
        Ok(())
    }
}

/// Whether `row` holds `i`. Most rows have eight to sixteen neighbours: the first eight and the last eight are all of them, and how
/// long the row is need not be guessed.
#[inline(always)]
fn holds(row: &[u32], i: u32) -> bool {
    let any = |run: &[u32]| run.iter().fold(false, |any, &j| any | (j == i));
    match (row.first_chunk::<8>(), row.last_chunk::<8>()) {
        (Some(first), Some(last)) if row.len() <= 16 => any(first) | any(last),
        _ => any(row),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PATH: WeightedGraph<'static> = WeightedGraph {
        offsets: &[0, 1, 3, 4],
        neighbours: &[1, 0, 2, 1],
        weights: None,
        positions: None,
    };

    fn text(graph: WeightedGraph<'_>) -> String {
        graph.check().unwrap_err().to_string()
    }

    #[test]
    fn a_symmetric_graph_passes() {
        assert_eq!(PATH.check(), Ok(()));
        assert_eq!(
            WeightedGraph {
                offsets: &[0],
                neighbours: &[],
                ..PATH
            }
            .check(),
            Ok(())
        );
    }

    #[test]
    fn broken_rows_are_named() {
        assert!(text(WeightedGraph { offsets: &[], ..PATH }).contains("begin with 0"));
        assert!(
            text(WeightedGraph {
                offsets: &[0, 1, 3, 5],
                ..PATH
            })
            .contains("end at 5")
        );
        assert!(
            text(WeightedGraph {
                offsets: &[0, 3, 1, 4],
                ..PATH
            })
            .contains("row 0")
        );
        assert!(
            text(WeightedGraph {
                offsets: &[0, 9, 3, 4],
                ..PATH
            })
            .contains("row 0")
        );
        assert!(
            text(WeightedGraph {
                neighbours: &[1, 0, 3, 1],
                ..PATH
            })
            .contains("neighbour 3")
        );
        assert!(
            text(WeightedGraph {
                neighbours: &[1, 2, 0, 1],
                ..PATH
            })
            .contains("row 1")
        );
        assert!(
            text(WeightedGraph {
                neighbours: &[0, 0, 2, 1],
                ..PATH
            })
            .contains("row 0")
        );
        assert!(
            text(WeightedGraph {
                neighbours: &[2, 0, 2, 1],
                ..PATH
            })
            .contains("no matching entry")
        );
    }

    #[test]
    fn a_vertex_in_a_row_of_its_own_is_found_wherever_it_stands() {
        for length in [1, 7, 8, 9, 15, 16, 17, 40] {
            for i in 0..length {
                // Row i holds all vertices, the others none.
                let offsets: Vec<u32> = (0..=length).map(|v| if v > i { length } else { 0 }).collect();
                let neighbours: Vec<u32> = (0..length).collect();
                let graph = WeightedGraph {
                    offsets: &offsets,
                    neighbours: &neighbours,
                    ..PATH
                };
                let seen = text(graph);
                assert!(
                    seen.contains(&format!("row {i} of the graph holds neighbour {i}")),
                    "{seen}"
                );
            }
        }
    }

    #[test]
    fn bad_weights_and_positions_are_named() {
        assert!(
            text(WeightedGraph {
                weights: Some(&[1.0; 3]),
                ..PATH
            })
            .contains("3 weights for 4")
        );
        assert!(
            text(WeightedGraph {
                weights: Some(&[1.0, 1.0, 0.0, 1.0]),
                ..PATH
            })
            .contains("weight 2")
        );
        assert!(
            text(WeightedGraph {
                weights: Some(&[1.0, 1.0, 2.0, 1.0]),
                ..PATH
            })
            .contains("two different weights")
        );
        assert!(
            text(WeightedGraph {
                positions: Some(&[[0.0; 3]; 2]),
                ..PATH
            })
            .contains("2 positions")
        );
        let nan = [[0.0; 3], [0.0, f64::NAN, 0.0], [0.0; 3]];
        assert!(
            text(WeightedGraph {
                positions: Some(&nan),
                ..PATH
            })
            .contains("position 1")
        );
    }
}
