//! Files that commands read: models with their companions, jobs and texts.

use super::terminal::CliFailure;
use crate::asset::{FileSet, Format, Limits, Model, missing_companions};
use clap::Args;
use std::collections::BTreeSet;
use std::fmt::Display;
use std::fs::{self, File, OpenOptions};
use std::io::{self, Read as _};
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Largest file that the command line reads, and most bytes of all files that a model or a job names.
pub(super) const LARGEST: u64 = 4 << 30;

/// The folders of `--allow`, beside those that a command reads anyway.
#[derive(Debug, Clone, Default, Args)]
pub(super) struct AllowedFolders {
    /// Folder that jobs may read files from, too; repeatable
    #[arg(long = "allow", value_name = "FOLDER")]
    pub folders: Vec<PathBuf>,
}

/// Why a file is not read.
#[derive(Debug, thiserror::Error)]
pub(super) enum UnreadFile {
    /// Nothing is there, or no way leads to it.
    #[error("cannot read {}: {error}", path.display())]
    Absent { path: PathBuf, error: io::Error },
    /// It is there, and reading it fails.
    #[error("cannot read {}: {error}", path.display())]
    Unreadable { path: PathBuf, error: io::Error },
    #[error("{} is a folder, a file is needed", .0.display())]
    Folder(PathBuf),
    /// A pipe, a socket or a device: reading it may never end.
    #[error("{} is not a regular file, a file is needed", .0.display())]
    Irregular(PathBuf),
    #[error("{} has {bytes} bytes or more, at most {most} are allowed", path.display())]
    TooLarge { path: PathBuf, bytes: u64, most: u64 },
    #[error("\"{name}\" is {}, which does not lie in {allowed}; --allow FOLDER adds a folder", path.display())]
    Outside {
        name: String,
        path: PathBuf,
        allowed: String,
    },
}

impl From<UnreadFile> for CliFailure {
    fn from(e: UnreadFile) -> Self {
        Self::Input(e.to_string())
    }
}

/// The folder that a file lies in.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent()
        .filter(|folder| !folder.as_os_str().is_empty())
        .unwrap_or(Path::new("."))
}

/// Reads a whole file of a path that someone typed.
pub(super) fn read_file(path: &Path) -> Result<Vec<u8>, CliFailure> {
    Ok(read_regular_file(path, LARGEST)?)
}

/// Reads a whole regular file of at most so many bytes.
pub(super) fn read_regular_file(path: &Path, most: u64) -> Result<Vec<u8>, UnreadFile> {
    let file = open_regular_file(path, OpenOptions::new().read(true))?;
    read_opened(file, path, most)
}

/// Reads a file that has been opened.
fn read_opened(file: File, path: &Path, most: u64) -> Result<Vec<u8>, UnreadFile> {
    let unreadable = |error| UnreadFile::Unreadable {
        path: path.to_owned(),
        error,
    };
    let too_large = |bytes| UnreadFile::TooLarge {
        path: path.to_owned(),
        bytes,
        most,
    };
    let length = file.metadata().map_err(unreadable)?.len();
    if length > most {
        return Err(too_large(length));
    }
    let mut bytes = Vec::new();
    let reserved = bytes.try_reserve_exact(length as usize);
    reserved.map_err(|_| unreadable(io::ErrorKind::OutOfMemory.into()))?;
    // A file may grow, and some, such as those of /proc, are longer than they say.
    file.take(most.saturating_add(1))
        .read_to_end(&mut bytes)
        .map_err(unreadable)?;
    match bytes.len() as u64 > most {
        true => Err(too_large(bytes.len() as u64)),
        false => Ok(bytes),
    }
}

/// Opens a regular file. A pipe without a writer would otherwise be waited for here.
pub(super) fn open_regular_file(path: &Path, how: &mut OpenOptions) -> Result<File, UnreadFile> {
    #[cfg(unix)]
    {
        use rustix::fs::OFlags;
        use std::os::unix::fs::OpenOptionsExt as _;
        how.custom_flags((OFlags::NONBLOCK | OFlags::NOCTTY).bits() as i32);
    }
    let irregular = |facts: &fs::Metadata| match facts.is_dir() {
        true => UnreadFile::Folder(path.to_owned()),
        false => UnreadFile::Irregular(path.to_owned()),
    };
    let opened = how
        .open(path)
        .and_then(|file| file.metadata().map(|facts| (file, facts)));
    match opened {
        // Asked of what is open: another file may lie at the path by now.
        Ok((file, facts)) if facts.is_file() => Ok(file),
        Ok((_, facts)) => Err(irregular(&facts)),
        Err(error) => match fs::metadata(path) {
            // Sockets cannot be opened at all, and folders not everywhere.
            Ok(facts) if !facts.is_file() => Err(irregular(&facts)),
            _ => Err(UnreadFile::Unreadable {
                path: path.to_owned(),
                error,
            }),
        },
    }
}

/// Named files are those that a document names: they are read from the folders that it may name files of.
#[derive(Debug, Clone)]
pub(super) struct NamedFiles {
    /// Where relative names begin.
    folder: PathBuf,
    /// The folders that files may lie in, without links.
    allowed: Vec<PathBuf>,
    /// What was opened, without links; shared with what [`NamedFiles::beginning_in`] makes.
    opened: Arc<Mutex<BTreeSet<PathBuf>>>,
}

impl NamedFiles {
    /// Allows what lies in the document's folder and in further ones.
    pub(super) fn new(folder: &Path, more: &AllowedFolders) -> Result<Self, CliFailure> {
        let unreadable = |e: io::Error| CliFailure::Input(format!("cannot read {}: {e}", folder.display()));
        let mut allowed = vec![folder.canonicalize().map_err(unreadable)?];
        for more in &more.folders {
            let refuse = || CliFailure::Input(format!("--allow is {}, which is not a folder", more.display()));
            let real = more.canonicalize().ok().filter(|real| real.is_dir());
            allowed.push(real.ok_or_else(refuse)?);
        }
        Ok(Self {
            folder: folder.to_owned(),
            allowed,
            opened: Arc::default(),
        })
    }

    /// The same folders, with relative names that begin in another one.
    pub(super) fn beginning_in(&self, folder: &Path) -> Self {
        Self {
            folder: folder.to_owned(),
            allowed: self.allowed.clone(),
            opened: Arc::clone(&self.opened),
        }
    }

    /// Every file that was opened so far, without links.
    pub(super) fn opened(&self) -> BTreeSet<PathBuf> {
        self.opened.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Reads a file of at most so many bytes.
    pub(super) fn read_named(&self, name: &str, most: u64) -> Result<Vec<u8>, UnreadFile> {
        let file = self.open_named(name, most)?;
        read_opened(file, &self.folder.join(name), most)
    }

    /// Opens a file of at most so many bytes.
    pub(super) fn open_named(&self, name: &str, most: u64) -> Result<File, UnreadFile> {
        let path = self.folder.join(name);
        let real = match path.canonicalize() {
            Ok(real) => real,
            Err(error) => return Err(UnreadFile::Absent { path, error }),
        };
        if !self.allowed.iter().any(|folder| real.starts_with(folder)) {
            let allowed: Vec<String> = self.allowed.iter().map(|f| f.display().to_string()).collect();
            return Err(UnreadFile::Outside {
                name: name.to_owned(),
                path: real,
                allowed: allowed.join(" or "),
            });
        }
        let file = open_regular_file(&real, OpenOptions::new().read(true)).map_err(|e| match e {
            // Reported under the name that was given.
            UnreadFile::Folder(_) => UnreadFile::Folder(path.clone()),
            UnreadFile::Irregular(_) => UnreadFile::Irregular(path.clone()),
            other => other,
        })?;
        match file.metadata() {
            Ok(facts) if facts.len() > most => Err(UnreadFile::TooLarge {
                path,
                bytes: facts.len(),
                most,
            }),
            Ok(_) => {
                self.opened.lock().unwrap_or_else(PoisonError::into_inner).insert(real);
                Ok(file)
            }
            Err(error) => Err(UnreadFile::Unreadable { path, error }),
        }
    }
}

/// Most files that a model may name.
const MOST_COMPANIONS: usize = 10_000;

/// Whether a file is motion capture and no model.
pub(super) fn is_bvh(file: &[u8]) -> bool {
    let text = file.strip_prefix(b"\xef\xbb\xbf").unwrap_or(file);
    text.trim_ascii_start().starts_with(b"HIERARCHY")
}

/// Reads a model and the files beside it that it names: buffers and images. Nothing outside the model's folder is opened.
pub(super) fn read_model(path: &Path) -> Result<FileSet, CliFailure> {
    let main = read_file(path)?;
    if is_bvh(&main) {
        let place = path.display();
        let problem =
            format!("it is a BVH clip, not a model; `pliant animate MODEL --bvh {place}` plays it on a model");
        return Err(CliFailure::Input(format!("{place}: {problem}")));
    }
    with_companions(path, main)
}

/// Reads a model with the files that it names.
pub(super) fn open_model(path: &Path) -> Result<Model, CliFailure> {
    Model::read(read_model(path)?, None, &Limits::default()).map_err(|e| in_file(path, e))
}

/// Reads the files beside a model that it names.
pub(super) fn with_companions(path: &Path, main: Vec<u8>) -> Result<FileSet, CliFailure> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut set = FileSet::single(name, main);
    let beside = NamedFiles::new(folder_of(path), &AllowedFolders::default())?;
    let mut asked = BTreeSet::new();
    let mut total = set.total_bytes();
    loop {
        let named: Vec<String> = missing_companions(&set)
            .into_iter()
            .filter(|name| !asked.contains(name))
            .collect();
        if named.is_empty() {
            return Ok(set);
        }
        if asked.len() + named.len() > MOST_COMPANIONS {
            let problem = format!("names more than {MOST_COMPANIONS} files");
            return Err(CliFailure::Input(format!("{} {problem}", path.display())));
        }
        for name in named {
            if stays_inside(&name) {
                match beside.read_named(&name, LARGEST) {
                    Ok(bytes) => {
                        total = total.saturating_add(bytes.len() as u64);
                        set.companions.insert(name.clone(), bytes.into());
                    }
                    // A missing companion is the reader's to report: it knows whether the file is needed.
                    Err(UnreadFile::Absent { .. } | UnreadFile::Outside { .. } | UnreadFile::Folder(_)) => {}
                    Err(e) => return Err(CliFailure::from(e).in_place(path.display())),
                }
                if total > LARGEST {
                    let problem = format!("has more than {LARGEST} bytes with the files that it names");
                    return Err(CliFailure::Input(format!("{} {problem}", path.display())));
                }
            }
            asked.insert(name);
        }
    }
}

/// Whether a URI is a relative path of plain names.
pub(super) fn stays_inside(uri: &str) -> bool {
    !uri.contains(['\\', ':', '\0']) && Path::new(uri).components().all(|c| matches!(c, Component::Normal(_)))
}

/// Determines the format of an output path.
pub(super) fn output_format(path: &Path) -> Result<Format, CliFailure> {
    let format = Format::from_file_name(&path.to_string_lossy()).ok_or_else(|| {
        let problem = format!("its extension must be one of {}", Format::name_list("and"));
        CliFailure::Input(format!("cannot determine the format of {}: {problem}", path.display()))
    })?;
    match format.refusal_to_write() {
        Some(problem) => Err(CliFailure::unwritable(path, problem)),
        None => Ok(format),
    }
}

/// A failure of what a file says, with its path.
pub(super) fn in_file(path: &Path, e: impl Display) -> CliFailure {
    CliFailure::Input(format!("{}: {e}", path.display()))
}
