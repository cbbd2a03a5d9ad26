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
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
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
        let mut file = NumberReader::open(path)?;
        let (magic, version): (u64, u64) = (file.read_number()?, file.read_number()?);
        if (magic, version) != (MAGIC, VERSION) {
            let problem = format!("is not a companion of version {VERSION}; export the system again");
            return Err(file.file_error(problem));
        }
        let (n, e, flags): (u64, u64, u64) = (file.read_number()?, file.read_number()?, file.read_number()?);
        let diagonal: f64 = file.read_number()?;
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
            offsets: file.read_numbers(n + 1)?,
            neighbours: file.read_numbers(e)?,
            weights: if weighted { Some(file.read_numbers(e)?) } else { None },
            fixed: file.read_numbers::<u8>(n)?.into_iter().map(|b| b != 0).collect(),
            stiffness: if soft { Some(file.read_numbers(n)?) } else { None },
            frames: file.read_numbers::<f32>(n * 9)?.as_chunks().0.to_vec(),
            rest: file.read_triples(n)?,
            poses: [PoseSystem::read(&mut file, n)?, PoseSystem::read(&mut file, n)?],
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
        let mut file = NumberWriter::create(path)?;
        let flags =
            if self.weights.is_some() { WEIGHTS } else { 0 } | if self.stiffness.is_some() { STIFFNESS } else { 0 };
        let (n, e) = (self.rest.len() as u64, self.neighbours.len() as u64);
        file.write_numbers([MAGIC, VERSION, n, e, flags])?;
        file.write_numbers([self.diagonal])?;
        file.write_numbers(self.offsets.iter().copied())?;
        file.write_numbers(self.neighbours.iter().copied())?;
        file.write_numbers(self.weights.iter().flatten().copied())?;
        file.write_numbers(self.fixed.iter().map(|f| u8::from(*f)))?;
        file.write_numbers(self.stiffness.iter().flatten().copied())?;
        file.write_numbers(self.frames.iter().flatten().copied())?;
        file.write_numbers(self.rest.iter().flatten().copied())?;
        for pose in &self.poses {
            file.write_numbers(pose.rhs.iter().flatten().copied())?;
            file.write_numbers(pose.given.iter().flatten().copied())?;
        }
        file.finish()
    }
}

impl PoseSystem {
    fn read(file: &mut NumberReader, nodes: usize) -> Result<Self, LoadtestFailure> {
        Ok(Self {
            rhs: file.read_triples(nodes)?,
            given: file.read_triples(nodes)?,
        })
    }
}

/// Bytes that are read or written at a time.
const BLOCK: usize = 1 << 20;

/// A file number is a number with a fixed little-endian form.
pub(super) trait FileNumber: Copy + Default {
    /// Bytes that it takes.
    const BYTES: usize;
    /// From exactly [`FileNumber::BYTES`] bytes; shorter runs read as zero.
    fn from_bytes(bytes: &[u8]) -> Self;
    /// Appends its bytes.
    fn append_to(self, out: &mut Vec<u8>);
}

macro_rules! file_number {
    ($($t:ty),*) => {$(
        impl FileNumber for $t {
            const BYTES: usize = size_of::<$t>();

            fn from_bytes(bytes: &[u8]) -> Self {
                bytes.first_chunk().map_or_else(Self::default, |b| Self::from_le_bytes(*b))
            }

            fn append_to(self, out: &mut Vec<u8>) {
                out.extend_from_slice(&self.to_le_bytes());
            }
        }
    )*};
}
file_number!(u8, u32, i32, u64, i64, f32, f64);

/// Reads a file of number runs whose total length was checked against the file's before anything is allocated.
pub(super) struct NumberReader {
    file: BufReader<File>,
    name: String,
    bytes: u64,
}

impl NumberReader {
    /// Opens `path`.
    pub fn open(path: &Path) -> Result<Self, LoadtestFailure> {
        let name = path.display().to_string();
        let refuse = |e: std::io::Error| LoadtestFailure::Usage(format!("cannot read {name}: {e}"));
        let file = File::open(path).map_err(refuse)?;
        let bytes = file.metadata().map_err(refuse)?.len();
        Ok(Self {
            file: BufReader::with_capacity(BLOCK, file),
            name,
            bytes,
        })
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
        match total {
            Some(total) if total == self.bytes => Ok(()),
            Some(total) => Err(self.file_error(format_args!("has {} bytes, its header promises {total}", self.bytes))),
            None => Err(self.file_error("its header promises more bytes than any file has")),
        }
    }

    /// The next number.
    pub fn read_number<T: FileNumber>(&mut self) -> Result<T, LoadtestFailure> {
        let mut bytes = [0; 8];
        let bytes = &mut bytes[..T::BYTES];
        let read = self.file.read_exact(bytes);
        read.map_err(|e| self.file_error(e))?;
        Ok(T::from_bytes(bytes))
    }

    /// The next `count` numbers; `expect_byte_size` has made sure that the file holds them.
    pub fn read_numbers<T: FileNumber>(&mut self, count: usize) -> Result<Vec<T>, LoadtestFailure> {
        let mut numbers = Vec::with_capacity(count);
        let mut block = vec![0; BLOCK.min(count.saturating_mul(T::BYTES))];
        let mut left = count;
        while left > 0 {
            let now = left.min(BLOCK / T::BYTES);
            let bytes = &mut block[..now * T::BYTES];
            let read = self.file.read_exact(bytes);
            read.map_err(|e| self.file_error(e))?;
            numbers.extend(bytes.chunks_exact(T::BYTES).map(T::from_bytes));
            left -= now;
        }
        Ok(numbers)
    }

    /// The next `count` triples.
    pub fn read_triples(&mut self, count: usize) -> Result<Vec<[f64; 3]>, LoadtestFailure> {
        Ok(self.read_numbers::<f64>(count * 3)?.as_chunks().0.to_vec())
    }
}

/// Writes number runs to a file that appears under its name when it is whole.
pub(super) struct NumberWriter {
    file: BufWriter<File>,
    part: std::path::PathBuf,
    path: std::path::PathBuf,
    block: Vec<u8>,
}

impl NumberWriter {
    /// Begins `path`.
    pub fn create(path: &Path) -> Result<Self, LoadtestFailure> {
        let mut name = path.file_name().unwrap_or_default().to_os_string();
        name.push(format!(".{}.part", std::process::id()));
        let part = path.with_file_name(name);
        let file =
            File::create(&part).map_err(|e| LoadtestFailure::Usage(format!("cannot write {}: {e}", part.display())))?;
        Ok(Self {
            file: BufWriter::new(file),
            part,
            path: path.to_owned(),
            block: Vec::with_capacity(BLOCK + 8),
        })
    }

    /// Appends numbers.
    pub fn write_numbers<T: FileNumber>(
        &mut self,
        numbers: impl IntoIterator<Item = T>,
    ) -> Result<(), LoadtestFailure> {
        for number in numbers {
            number.append_to(&mut self.block);
            if self.block.len() >= BLOCK {
                self.flush()?;
            }
        }
        self.flush()
    }

    /// Ends the file and gives it its name.
    pub fn finish(mut self) -> Result<(), LoadtestFailure> {
        let done = self.file.flush().and_then(|()| std::fs::rename(&self.part, &self.path));
        done.map_err(|e| LoadtestFailure::Usage(format!("cannot write {}: {e}", self.path.display())))
    }

    fn flush(&mut self) -> Result<(), LoadtestFailure> {
        let written = self.file.write_all(&self.block);
        self.block.clear();
        written.map_err(|e| LoadtestFailure::Usage(format!("cannot write {}: {e}", self.part.display())))
    }
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
