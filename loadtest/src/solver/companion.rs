//! The file beside a problem file, with what the matrix lacks: the graph with its given nodes, the frames, and a second
//! pose one step on.
//!
//! Little-endian, in this order: magic u64, version u64, nodes n u64, entries e u64, flags u64 (1: weights, 2: stiffness),
//! diagonal f64; row starts u32 × (n + 1), neighbours u32 × e, weights f32 × e (with flag 1), given u8 × n,
//! stiffness f64 × n (with flag 2), frames f32 × 9 n by column, rest positions f64 × 3 n; then for each of two poses
//! right-hand sides f64 × 3 n and given positions f64 × 3 n. Rows of the problem file are the nodes that are not given,
//! in rising order. All lengths are in one unit, in which `diagonal` is that of the model's bounding box.

use crate::failure::LoadtestFailure;
use pliant::solver::WeightedGraph;
use std::fs;
use std::path::{Path, PathBuf};

/// First eight bytes: "PLIANTAX".
const MAGIC: u64 = u64::from_le_bytes(*b"PLIANTAX");
/// The version that is written and read.
const VERSION: u64 = 1;
/// Bytes before the row starts.
const HEADER: u64 = 48;
/// Flag: edges have weights.
const WEIGHTS: u64 = 1;
/// Flag: nodes have a stiffness.
const STIFFNESS: u64 = 2;

/// A pose system is the input of one pose, node by node.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct PoseSystem {
    /// Right-hand side, before given neighbours are moved into it.
    pub rhs: Vec<[f64; 3]>,
    /// Given positions, and rest positions of other nodes.
    pub given: Vec<[f64; 3]>,
}

/// A companion file holds a whole second-pass system over all nodes of a graph, for two poses.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct CompanionFile {
    /// Length of the model's bounding box diagonal.
    pub diagonal: f64,
    /// Where each row of `neighbours` begins, and the end.
    pub offsets: Vec<u32>,
    /// Neighbours of all rows.
    pub neighbours: Vec<u32>,
    /// Weights of the edges; `None` when all are 1.
    pub weights: Option<Vec<f32>>,
    /// By node: whether its position is given.
    pub fixed: Vec<bool>,
    /// By node: extra diagonal of soft handles.
    pub stiffness: Option<Vec<f64>>,
    /// By node: the linear map of the first pose.
    pub frames: Vec<[f32; 9]>,
    /// By node: its rest position.
    pub rest: Vec<[f64; 3]>,
    /// The pose of the problem file, and one a step on.
    pub poses: [PoseSystem; 2],
}

impl CompanionFile {
    /// The name of the file beside a problem file.
    pub fn path_beside(problem: &Path) -> PathBuf {
        problem.with_extension("aux")
    }

    /// The graph as the solver takes it.
    pub fn graph(&self) -> WeightedGraph<'_> {
        WeightedGraph {
            offsets: &self.offsets,
            neighbours: &self.neighbours,
            weights: self.weights.as_deref(),
            positions: Some(&self.rest),
        }
    }

    /// Reads a file and checks lengths, the graph, and that numbers are finite.
    pub fn read(path: &Path) -> Result<Self, LoadtestFailure> {
        let mut file = NumberFile::read(path)?;
        if file.header()? != [MAGIC, VERSION] {
            let problem = format!("is not a companion of version {VERSION}; export the system again");
            return Err(file.file_error(problem));
        }
        let [n, e, flags, diagonal] = file.header()?;
        let diagonal = f64::from_bits(diagonal);
        if flags > (WEIGHTS | STIFFNESS) || !(diagonal > 0.0 && diagonal.is_finite()) {
            return Err(file.file_error(format_args!("has flags {flags} and the diagonal {diagonal}")));
        }
        let (weighted, soft) = (flags & WEIGHTS != 0, flags & STIFFNESS != 0);
        let rows = n.saturating_add(1);
        let runs = [
            (rows, 4),
            (e, 4 + 4 * usize::from(weighted)),
            (n, 1 + 8 * usize::from(soft)),
            (n, 36 + 24),
            (n, 4 * 24),
        ];
        file.expect_byte_size(HEADER, &runs)?;
        // Both fit the address space, because the file holds them.
        let (n, e) = (n as usize, e as usize);
        let companion = Self {
            diagonal,
            offsets: file.numbers(n + 1, u32::from_le_bytes)?,
            neighbours: file.numbers(e, u32::from_le_bytes)?,
            weights: (weighted.then(|| file.numbers(e, f32::from_le_bytes))).transpose()?,
            fixed: file.numbers(n, |[given]| given != 0)?,
            stiffness: (soft.then(|| file.numbers(n, f64::from_le_bytes))).transpose()?,
            frames: file.numbers(n * 9, f32::from_le_bytes)?.as_chunks().0.to_vec(),
            rest: file.triples(n)?,
            poses: [file.pose(n)?, file.pose(n)?],
        };
        companion.graph().check().map_err(|e| file.file_error(e))?;
        let triples = companion.poses.iter().flat_map(|p| p.rhs.iter().chain(&p.given));
        let finite = triples.chain(&companion.rest).flatten().all(|v| v.is_finite())
            && companion.frames.iter().flatten().all(|v| v.is_finite());
        if !finite {
            return Err(file.file_error("numbers must be finite"));
        }
        Ok(companion)
    }

    /// Writes the file.
    pub fn write(&self, path: &Path) -> Result<(), LoadtestFailure> {
        let flags =
            if self.weights.is_some() { WEIGHTS } else { 0 } | if self.stiffness.is_some() { STIFFNESS } else { 0 };
        let (n, e) = (self.rest.len() as u64, self.neighbours.len() as u64);
        let header = [MAGIC, VERSION, n, e, flags, self.diagonal.to_bits()];
        let mut bytes: Vec<u8> = header.into_iter().flat_map(u64::to_le_bytes).collect();
        bytes.extend(self.offsets.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(self.neighbours.iter().flat_map(|v| v.to_le_bytes()));
        bytes.extend(self.weights.iter().flatten().flat_map(|v| v.to_le_bytes()));
        bytes.extend(self.fixed.iter().map(|f| u8::from(*f)));
        bytes.extend(self.stiffness.iter().flatten().flat_map(|v| v.to_le_bytes()));
        bytes.extend(self.frames.iter().flatten().flat_map(|v| v.to_le_bytes()));
        bytes.extend(f64_bytes(&self.rest));
        for pose in &self.poses {
            bytes.extend(f64_bytes(&pose.rhs).chain(f64_bytes(&pose.given)));
        }
        write_whole(path, &bytes)
    }
}

/// A file of little-endian numbers that was read whole, so that nothing longer than it is allocated.
pub(super) struct NumberFile {
    bytes: Vec<u8>,
    at: usize,
    name: String,
}

impl NumberFile {
    /// Reads `path`.
    pub fn read(path: &Path) -> Result<Self, LoadtestFailure> {
        let name = path.display().to_string();
        let bytes = fs::read(path).map_err(|e| LoadtestFailure::Usage(format!("cannot read {name}: {e}")))?;
        Ok(Self { bytes, at: 0, name })
    }

    /// What is wrong with the file.
    pub fn file_error(&self, problem: impl std::fmt::Display) -> LoadtestFailure {
        LoadtestFailure::Usage(format!("{}: {problem}", self.name))
    }

    /// Refuses the file unless it has exactly the bytes of `header` and of runs of (count, bytes each).
    pub fn expect_byte_size(&self, header: u64, runs: &[(u64, usize)]) -> Result<(), LoadtestFailure> {
        let total = runs.iter().try_fold(header, |sum, &(count, each)| {
            count.checked_mul(each as u64).and_then(|b| sum.checked_add(b))
        });
        let seen = self.bytes.len();
        match total {
            Some(total) if total == seen as u64 => Ok(()),
            Some(total) => Err(self.file_error(format_args!("has {seen} bytes, its header promises {total}"))),
            None => Err(self.file_error("its header promises more bytes than any file has")),
        }
    }

    /// The next `count` numbers, each read by `from` of its bytes.
    pub fn numbers<T, const BYTES: usize>(
        &mut self,
        count: usize,
        from: fn([u8; BYTES]) -> T,
    ) -> Result<Vec<T>, LoadtestFailure> {
        let end = count.saturating_mul(BYTES).saturating_add(self.at);
        let Some(run) = self.bytes.get(self.at..end) else {
            return Err(self.file_error("ends too early"));
        };
        self.at = end;
        Ok(run.as_chunks().0.iter().map(|bytes| from(*bytes)).collect())
    }

    /// The next few whole numbers.
    pub fn header<const COUNT: usize>(&mut self) -> Result<[u64; COUNT], LoadtestFailure> {
        let mut header = [0; COUNT];
        header.copy_from_slice(&self.numbers(COUNT, u64::from_le_bytes)?);
        Ok(header)
    }

    /// The next `count` triples.
    pub fn triples(&mut self, count: usize) -> Result<Vec<[f64; 3]>, LoadtestFailure> {
        Ok(self.numbers(count * 3, f64::from_le_bytes)?.as_chunks().0.to_vec())
    }

    /// The input of a pose.
    fn pose(&mut self, nodes: usize) -> Result<PoseSystem, LoadtestFailure> {
        Ok(PoseSystem {
            rhs: self.triples(nodes)?,
            given: self.triples(nodes)?,
        })
    }
}

/// The bytes of numbers.
pub(super) fn f64_bytes(rows: &[[f64; 3]]) -> impl Iterator<Item = u8> + '_ {
    rows.iter().flatten().flat_map(|number| number.to_le_bytes())
}

/// Writes a file that appears under its name when it is whole.
pub(super) fn write_whole(path: &Path, bytes: &[u8]) -> Result<(), LoadtestFailure> {
    let mut name = path.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    let part = path.with_file_name(name);
    let written = fs::write(&part, bytes).and_then(|()| fs::rename(&part, path));
    written.map_err(|e| LoadtestFailure::Usage(format!("cannot write {}: {e}", path.display())))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pose(lift: f64) -> PoseSystem {
        PoseSystem {
            rhs: vec![[0.0, -1.0, lift]; 3],
            given: vec![[lift, 0.0, 1.0]; 3],
        }
    }

    fn companion(weights: Option<Vec<f32>>, stiffness: Option<Vec<f64>>) -> CompanionFile {
        CompanionFile {
            diagonal: 1.5,
            offsets: vec![0, 1, 3, 4],
            neighbours: vec![1, 0, 2, 1],
            weights,
            fixed: vec![true, false, false],
            stiffness,
            frames: vec![[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]; 3],
            rest: vec![[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0]],
            poses: [pose(0.25), pose(0.5)],
        }
    }

    #[test]
    fn a_companion_survives_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = CompanionFile::path_beside(&folder.path().join("x.bin"));
        for weights in [None, Some(vec![2.0; 4])] {
            for stiffness in [None, Some(vec![0.0, 0.5, 0.0])] {
                let companion = companion(weights.clone(), stiffness);
                companion.write(&path).unwrap();
                assert_eq!(CompanionFile::read(&path).unwrap(), companion);
            }
        }
    }

    #[test]
    fn broken_files_are_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("bad.aux");
        companion(None, None).write(&path).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let with = |at: usize, value: u64| {
            let mut bytes = whole.clone();
            bytes[at..at + 8].copy_from_slice(&value.to_le_bytes());
            std::fs::write(&path, bytes).unwrap();
            match CompanionFile::read(&path) {
                Err(LoadtestFailure::Usage(text)) => text,
                other => panic!("byte {at} = {value}: {other:?}"),
            }
        };
        assert!(with(0, 1).contains("is not a companion"));
        assert!(with(8, 2).contains("is not a companion"));
        for huge in [5, 1 << 50, u64::MAX] {
            assert!(with(16, huge).contains("promises"));
            assert!(with(24, huge).contains("promises"));
        }
        assert!(with(32, 3).contains("promises"), "flags whose runs are not there");
        assert!(with(32, 4).contains("flags"));
        assert!(with(40, f64::NAN.to_bits()).contains("diagonal"));
        // Neighbour 7 of the first row.
        assert!(with(48 + 16, 7).contains("row 0"));
        assert!(with(whole.len() - 8, f64::NAN.to_bits()).contains("finite"));
    }
}
