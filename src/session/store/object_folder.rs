//! A local folder of objects. `object_store` writes without syncing; here a file is written beside, synced, renamed, and its folder
//! synced, so that it is whole on disk before anything names it.

use super::private_files::{make_private_folder, sync_folder};
use super::session_store::StoreError;
use std::fs;
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};

/// Bytes that are written to see whether there is room again: one block of a file system, since a commit may need no more.
const TRIED: usize = 4096;

/// A local folder of objects.
#[derive(Debug)]
pub(super) struct ObjectFolder {
    /// Where objects lie, on shelves named by the first two letters of theirs.
    pub objects: PathBuf,
    unfinished: PathBuf,
    /// Which store this is, beside the objects.
    identity: PathBuf,
}

impl ObjectFolder {
    /// The objects below a folder, made if it is missing.
    pub fn open(folder: &Path) -> Result<Self, StoreError> {
        let objects = folder.join("objects");
        let unfinished = folder.join("unfinished");
        let failed = |path: &Path, e: io::Error| StoreError::Unavailable(format!("{}: {e}", path.display()));
        // What a crash left there has no name yet.
        if unfinished.exists() {
            fs::remove_dir_all(&unfinished).map_err(|e| failed(&unfinished, e))?;
        }
        for made in [&objects, &unfinished] {
            make_private_folder(made).map_err(|e| failed(made, e))?;
        }
        sync_folder(folder).map_err(|e| failed(folder, e))?;
        Ok(Self::at(folder))
    }

    /// The objects below a folder, to be read alone: nothing is made or removed.
    pub fn to_read(folder: &Path) -> Result<Self, StoreError> {
        let found = Self::at(folder);
        match found.objects.is_dir() {
            true => Ok(found),
            false => Err(StoreError::Refused(format!(
                "{} is missing, where the models of the sessions lie; restore it from the backup of the database",
                found.objects.display()
            ))),
        }
    }

    fn at(folder: &Path) -> Self {
        Self {
            objects: folder.join("objects"),
            unfinished: folder.join("unfinished"),
            identity: folder.join("store"),
        }
    }

    /// Writes an object; it is on disk when this returns.
    pub fn write(&self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let shelf = self.objects.join(&name[..2]);
        let path = shelf.join(name);
        // What is there and whole is not written again; what was damaged is mended.
        if fs::read(&path).is_ok_and(|there| there == bytes) {
            return sync_folder(&shelf);
        }
        if !shelf.exists() {
            make_private_folder(&shelf)?;
            sync_folder(&self.objects)?;
        }
        self.write_beside(bytes, &path)?;
        sync_folder(&shelf)
    }

    /// The identity that stands beside the objects, where there is one.
    pub fn read_identity(&self) -> io::Result<Option<Vec<u8>>> {
        match fs::read(&self.identity) {
            Ok(there) => Ok(Some(there)),
            Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Puts an identity beside the objects.
    pub fn write_identity(&self, identity: &[u8]) -> io::Result<()> {
        self.write_beside(identity, &self.identity)?;
        self.identity.parent().map_or(Ok(()), sync_folder)
    }

    /// Writes a small file, and removes it.
    pub fn try_writing(&self) -> io::Result<()> {
        let mut file = tempfile::NamedTempFile::new_in(&self.unfinished)?;
        file.write_all(&vec![0; TRIED])?;
        file.as_file().sync_all()
    }

    fn write_beside(&self, bytes: &[u8], path: &Path) -> io::Result<()> {
        let mut file = tempfile::NamedTempFile::new_in(&self.unfinished)?;
        file.write_all(bytes)?;
        file.as_file().sync_all()?;
        let (_, beside) = file.keep().map_err(|e| e.error)?;
        fs::rename(beside, path)
    }
}
