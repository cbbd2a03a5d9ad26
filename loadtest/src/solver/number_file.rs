//! Files of numbers, little-endian.

use crate::failure::LoadtestFailure;
use std::fs::File;
use std::io::{BufReader, BufWriter, Read, Write};
use std::path::Path;

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
