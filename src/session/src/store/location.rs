//! Where a store is, and its data folder: how it is created, locked, and read without leaving a trace.

use super::session_store::{NodeIdentity, StoreError};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use std::fs::{DirBuilder, File};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, OpenOptionsExt as _};
use std::path::{Path, PathBuf};

/// Where a store is.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct StoreLocation {
    /// The folder of what has no place of its own; made if it is missing.
    pub data_dir: Option<PathBuf>,
    /// The URL of the database, `postgres://USER:PASSWORD@HOST/DATABASE`; `None`: SQLite in the folder.
    pub database: Option<String>,
    /// The URL of the objects, `s3://BUCKET/PREFIX`; `None`: in the folder.
    pub objects: Option<String>,
    /// Which build and processor makes results; `None`: this one.
    pub build: Option<String>,
    /// Which of several nodes opens it; `None`: one process has it for itself.
    pub node: Option<NodeIdentity>,
}

impl StoreLocation {
    /// Everything in a folder.
    pub fn in_folder(folder: impl Into<PathBuf>) -> Self {
        Self {
            data_dir: Some(folder.into()),
            ..Self::default()
        }
    }

    /// The same, for a node that was to take a free port and got `port`.
    pub fn on_port(&self, port: u16) -> Self {
        let mut there = self.clone();
        if let Some(node) = &mut there.node {
            for shown in [&mut node.address, &mut node.name] {
                if let Some(host) = shown.strip_suffix(":0") {
                    *shown = format!("{host}:{port}");
                }
            }
        }
        there
    }
}

impl std::fmt::Display for StoreLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let folder = self.data_dir.as_ref().map(|d| d.display().to_string());
        // A URL may hold a password.
        let database = self.database.as_ref().map(|_| "PostgreSQL".to_owned());
        let places = [&database, &self.objects, &folder];
        let shown: Vec<&str> = places.into_iter().flatten().map(String::as_str).collect();
        f.write_str(&shown.join(", "))
    }
}

impl std::fmt::Debug for StoreLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        std::fmt::Display::fmt(self, f)
    }
}

/// The file of the database in a data folder.
pub(super) const DATABASE_FILE: &str = "sessions.sqlite";
/// The file that is locked beside the folder itself: all that earlier versions look at.
const LOCK_FILE: &str = "lock";

/// A hold on a data folder, for as long as it lives.
///
/// The lock is on the folder itself, which cannot be taken away from under a process as a file in it can; file systems that lock no
/// folders (NFS among them) still lock the file.
#[derive(Debug)]
pub(super) struct FolderHold {
    _folder: File,
    _file: Option<File>,
}

fn failed(path: &Path) -> impl Fn(io::Error) -> StoreError {
    move |e| StoreError::Unavailable(format!("{}: {e}", path.display()))
}

impl FolderHold {
    /// Takes a folder for this process alone; makes it where it is missing.
    ///
    /// # Errors
    /// [`StoreError::Refused`] where another process has it, [`StoreError::Unavailable`] where it cannot be had.
    pub fn alone(folder: &Path) -> Result<Self, StoreError> {
        let unavailable = failed(folder);
        if !folder.exists() {
            make_private_folder(folder).map_err(&unavailable)?;
            // The folder's own name has to be on disk too.
            if let Some(parent) = folder.parent().filter(|p| !p.as_os_str().is_empty()) {
                sync_folder(parent).map_err(&unavailable)?;
            }
        }
        let taken = || {
            StoreError::Refused(format!(
                "{} is in use by another process: a server that keeps its sessions there, or pliant store",
                folder.display()
            ))
        };
        let itself = File::open(folder).map_err(&unavailable)?;
        if !lock(&itself, FlockOperation::NonBlockingLockExclusive).unwrap_or(true) {
            return Err(taken());
        }
        let file = make_private_file(&folder.join(LOCK_FILE)).map_err(&unavailable)?;
        match lock(&file, FlockOperation::NonBlockingLockExclusive) {
            Ok(true) => Ok(Self {
                _folder: itself,
                _file: Some(file),
            }),
            Ok(false) => Err(taken()),
            Err(error) => Err(unavailable(error)),
        }
    }

    /// Keeps writers away from a folder while it is looked at, with any number of others who look; `None` where a process writes it.
    /// Nothing is made.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] where the folder cannot be opened.
    pub fn with_others(folder: &Path) -> Result<Option<Self>, StoreError> {
        let itself = File::open(folder).map_err(failed(folder))?;
        if !lock(&itself, FlockOperation::NonBlockingLockShared).unwrap_or(true) {
            return Ok(None);
        }
        // Backups have no such file.
        let file = File::open(folder.join(LOCK_FILE)).ok();
        if let Some(file) = &file
            && !lock(file, FlockOperation::NonBlockingLockShared).unwrap_or(true)
        {
            return Ok(None);
        }
        Ok(Some(Self {
            _folder: itself,
            _file: file,
        }))
    }
}

/// Whether the lock is ours; an error where the file system has no such locks.
fn lock(file: &File, how: FlockOperation) -> io::Result<bool> {
    match flock(file, how) {
        Ok(()) => Ok(true),
        Err(Errno::WOULDBLOCK) => Ok(false),
        Err(error) => Err(error.into()),
    }
}

/// The database file of a folder.
///
/// # Errors
/// [`StoreError::Refused`] where there is none, with what is missing, and where it may not be read.
pub(super) fn existing_database(folder: &Path) -> Result<PathBuf, StoreError> {
    let shown = folder.display();
    let unreadable = |path: &Path, e: io::Error| StoreError::Refused(format!("cannot read {}: {e}", path.display()));
    // A process that may not look into a folder cannot know what is in it.
    match std::fs::read_dir(folder) {
        Ok(_) => {}
        Err(e) if [io::ErrorKind::NotFound, io::ErrorKind::NotADirectory].contains(&e.kind()) => {
            return Err(StoreError::Refused(format!(
                "there is no store of sessions in {shown}: there is no such folder"
            )));
        }
        Err(e) => return Err(unreadable(folder, e)),
    }
    let file = folder.join(DATABASE_FILE);
    match File::open(&file) {
        Ok(_) => Ok(file),
        Err(e) if e.kind() != io::ErrorKind::NotFound => Err(unreadable(&file, e)),
        Err(_) if holds_objects(folder) => Err(objects_alone(folder)),
        Err(_) => Err(StoreError::Refused(format!(
            "there is no store of sessions in {shown}: there is no {DATABASE_FILE}"
        ))),
    }
}

/// Refuses a folder of objects whose database is missing: a new one would name none of them.
pub(super) fn refuse_objects_alone(folder: &Path) -> Result<(), StoreError> {
    match !folder.join(DATABASE_FILE).exists() && holds_objects(folder) {
        true => Err(objects_alone(folder)),
        false => Ok(()),
    }
}

fn objects_alone(folder: &Path) -> StoreError {
    StoreError::Refused(format!(
        "{} holds objects of sessions, but {DATABASE_FILE} is missing, which says whose they are; restore it from the backup that \
         they belong to, or name another folder",
        folder.display()
    ))
}

/// Whether anything lies on the shelves of a folder, or the mark of a store beside them.
fn holds_objects(folder: &Path) -> bool {
    let shelves = std::fs::read_dir(folder.join("objects"))
        .into_iter()
        .flatten()
        .flatten();
    let mut files = shelves.flat_map(|shelf| std::fs::read_dir(shelf.path()).into_iter().flatten());
    folder.join("store").exists() || files.next().is_some()
}

/// Makes a folder that only its owner can enter, where it is missing.
pub(super) fn make_private_folder(folder: &Path) -> io::Result<()> {
    DirBuilder::new().recursive(true).mode(0o700).create(folder)
}

/// Makes a file that only its owner can read, where it is missing.
pub(super) fn make_private_file(file: &Path) -> io::Result<File> {
    let mut options = File::options();
    options.create(true).truncate(false).write(true).mode(0o600).open(file)
}

/// A name is on disk only when the folder that holds it is.
pub(super) fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}
