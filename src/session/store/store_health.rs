//! Whether a store takes writes. It does not after a failed write, until a small one works. Beside that the files are
//! checked from time to time, since a folder that was moved away still takes writes, which are then lost.

use super::session_store::StoreError;
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

/// Whether a store takes writes.
#[derive(Debug)]
pub(super) struct StoreHealth {
    /// Files and folders of the store, and which they are: device and number.
    places: Vec<(PathBuf, (u64, u64))>,
    /// What the last write failed for.
    problem: Mutex<Option<String>>,
}

fn number_of(path: &Path) -> io::Result<(u64, u64)> {
    let facts = std::fs::metadata(path)?;
    Ok((facts.dev(), facts.ino()))
}

impl StoreHealth {
    /// The health of a store that lies in these files and folders, all of which are there.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] for one that is not.
    pub fn of_places(paths: impl IntoIterator<Item = PathBuf>) -> Result<Self, StoreError> {
        let place = |path: PathBuf| match number_of(&path) {
            Ok(number) => Ok((path, number)),
            Err(error) => Err(StoreError::Unavailable(format!("{}: {error}", path.display()))),
        };
        Ok(Self {
            places: paths.into_iter().map(place).collect::<Result<_, _>>()?,
            problem: Mutex::default(),
        })
    }

    /// Whether files and folders are still those that were opened.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] for the first that is not.
    pub fn check_places(&self) -> Result<(), StoreError> {
        for (path, number) in &self.places {
            let shown = path.display();
            match number_of(path) {
                Ok(now) if now == *number => {}
                Ok(_) => {
                    let text = format!(
                        "{shown} is another one than was opened; put the first one back, or restart the server"
                    );
                    return Err(StoreError::Unavailable(text));
                }
                Err(error) => {
                    let text = format!("{shown} is not there any more ({error}); put it back, or restart the server");
                    return Err(StoreError::Unavailable(text));
                }
            }
        }
        Ok(())
    }

    /// Remembers that a write failed, and passes its result on.
    pub fn note<T>(&self, result: Result<T, StoreError>) -> Result<T, StoreError> {
        if let Err(StoreError::Unavailable(problem)) = &result {
            let before = self.problem().replace(problem.clone());
            if before.as_ref() != Some(problem) {
                tracing::error!("the store of sessions cannot be written: {problem}");
            }
        }
        result
    }

    /// Whether the last write worked.
    pub fn takes_writes(&self) -> bool {
        self.problem().is_none()
    }

    fn problem(&self) -> MutexGuard<'_, Option<String>> {
        self.problem.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Remembers that a write worked again.
    pub fn recover(&self) {
        if self.problem().take().is_some() {
            tracing::info!("the store of sessions can be written again");
        }
    }
}
