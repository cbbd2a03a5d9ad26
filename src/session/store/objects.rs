//! What is large, by content: an object's name is the SHA-256 of its bytes, so it is written once and never changes, and what is read
//! can be compared with its name.

use super::session_store::StoreError;
use bytes::Bytes;
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectStore, ObjectStoreExt as _};
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::fs::{self, File};
use std::io::{self, Write as _};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use tokio::sync::{RwLock, Semaphore};

/// Objects that are hashed or written at a time.
const BLOCKING: usize = 4;

/// The objects of a store.
#[derive(Debug)]
pub(super) struct Objects {
    store: Arc<dyn ObjectStore>,
    folder: Arc<ObjectFolder>,
    blocking: Semaphore,
    /// Held for reading from before an object is written until the row that names it is; for writing while objects without a name are
    /// removed.
    pub naming: RwLock<()>,
}

/// A local folder of objects. `object_store` writes without syncing; here a file is written beside, synced, renamed, and its folder
/// synced, so that it is whole on disk before anything names it.
#[derive(Debug)]
struct ObjectFolder {
    objects: PathBuf,
    unfinished: PathBuf,
}

impl Objects {
    /// The objects below a folder.
    pub fn in_folder(folder: &Path) -> Result<Self, StoreError> {
        let objects = folder.join("objects");
        let unfinished = folder.join("unfinished");
        let failed = |path: &Path, e: io::Error| StoreError::Unavailable(format!("{}: {e}", path.display()));
        // What a crash left there has no name yet.
        if unfinished.exists() {
            fs::remove_dir_all(&unfinished).map_err(|e| failed(&unfinished, e))?;
        }
        for made in [&objects, &unfinished] {
            fs::create_dir_all(made).map_err(|e| failed(made, e))?;
        }
        sync_folder(folder).map_err(|e| failed(folder, e))?;
        let store = LocalFileSystem::new_with_prefix(&objects)
            .map_err(|e| StoreError::Unavailable(format!("{}: {e}", objects.display())))?;
        Ok(Self {
            store: Arc::new(store),
            folder: Arc::new(ObjectFolder { objects, unfinished }),
            blocking: Semaphore::new(BLOCKING),
            naming: RwLock::new(()),
        })
    }

    /// Writes an object and returns its name.
    pub async fn put(&self, bytes: Bytes) -> Result<String, StoreError> {
        let folder = Arc::clone(&self.folder);
        self.apart(move || {
            let name = name_of(&bytes);
            folder
                .write(&name, &bytes)
                .map_err(|e| StoreError::Unavailable(format!("an object cannot be written: {e}")))?;
            Ok(name)
        })
        .await
    }

    /// Reads an object and compares it with its name.
    pub async fn get(&self, name: String) -> Result<Bytes, StoreError> {
        let path = object_path(&name)?;
        let read = match self.store.get(&path).await {
            Ok(found) => found.bytes().await,
            Err(error) => Err(error),
        };
        let bytes = read.map_err(|error| match error {
            object_store::Error::NotFound { .. } => StoreError::Damaged(format!("object {name} is missing")),
            error => StoreError::Unavailable(format!("object {name} cannot be read: {error}")),
        })?;
        self.apart(move || match name_of(&bytes) == name {
            true => Ok(bytes),
            false => Err(StoreError::Damaged(format!("object {name} is not what was written"))),
        })
        .await
    }

    /// Bytes of an object.
    pub async fn size(&self, name: &str) -> Result<u64, StoreError> {
        let found = self.store.head(&object_path(name)?).await;
        found
            .map(|facts| facts.size)
            .map_err(|error| StoreError::Unavailable(format!("object {name} cannot be seen: {error}")))
    }

    /// Removes an object; one that is gone already is no error.
    pub async fn remove(&self, name: &str) -> Result<(), StoreError> {
        match self.store.delete(&object_path(name)?).await {
            Ok(()) | Err(object_store::Error::NotFound { .. }) => Ok(()),
            Err(error) => Err(StoreError::Unavailable(format!(
                "object {name} cannot be removed: {error}"
            ))),
        }
    }

    /// Runs work that takes a while, or waits for a disk, beside the tasks.
    async fn apart<T: Send + 'static>(
        &self,
        work: impl FnOnce() -> Result<T, StoreError> + Send + 'static,
    ) -> Result<T, StoreError> {
        let ended = |_| StoreError::Unavailable("the store is going away".into());
        let _place = self.blocking.acquire().await.map_err(|_| ended(()))?;
        tokio::task::spawn_blocking(work).await.map_err(|_| ended(()))?
    }
}

impl ObjectFolder {
    fn write(&self, name: &str, bytes: &[u8]) -> io::Result<()> {
        let shelf = self.objects.join(&name[..2]);
        let path = shelf.join(name);
        // What is there and whole is not written again; what was damaged is mended.
        if fs::read(&path).is_ok_and(|there| there == bytes) {
            return sync_folder(&shelf);
        }
        if !shelf.exists() {
            fs::create_dir_all(&shelf)?;
            sync_folder(&self.objects)?;
        }
        let mut file = tempfile::NamedTempFile::new_in(&self.unfinished)?;
        file.write_all(bytes)?;
        file.as_file().sync_all()?;
        file.persist(&path).map_err(|e| e.error)?;
        sync_folder(&shelf)
    }
}

/// A name is on disk only when the folder that holds it is.
fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

/// SHA-256, lower-case hexadecimal.
fn name_of(bytes: &[u8]) -> String {
    let mut name = String::with_capacity(64);
    for byte in Sha256::digest(bytes) {
        let _ = write!(name, "{byte:02x}");
    }
    name
}

/// Where an object lies. A name comes from a row; only what can be one leads to a file.
fn object_path(name: &str) -> Result<ObjectPath, StoreError> {
    let is_name = name.len() == 64 && name.bytes().all(|b| b.is_ascii_digit() || (b'a'..=b'f').contains(&b));
    if !is_name {
        return Err(StoreError::Damaged("a row names an object that cannot be".into()));
    }
    Ok(ObjectPath::from(format!("{}/{name}", &name[..2])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn an_object_is_kept_under_its_content_and_damage_is_told_and_mended() {
        let folder = tempfile::tempdir().expect("a folder");
        let objects = Objects::in_folder(folder.path()).expect("made");
        let bytes = Bytes::from_static(b"what is kept");
        let name = objects.put(bytes.clone()).await.expect("written");
        assert_eq!(objects.put(bytes.clone()).await.as_ref(), Ok(&name));
        assert_eq!(objects.get(name.clone()).await, Ok(bytes.clone()));
        let path = folder.path().join("objects").join(&name[..2]).join(&name);
        for wrong in [&b"what is kepT"[..], b"what", b""] {
            fs::write(&path, wrong).expect("writable");
            assert!(matches!(objects.get(name.clone()).await, Err(StoreError::Damaged(_))));
        }
        objects.put(bytes.clone()).await.expect("written again");
        assert_eq!(objects.get(name.clone()).await, Ok(bytes));
        objects.remove(&name).await.expect("removed");
        objects.remove(&name).await.expect("gone already");
        assert!(matches!(objects.get(name).await, Err(StoreError::Damaged(_))));
        for no_name in ["", "../../etc/passwd", &"g".repeat(64)] {
            assert!(matches!(objects.get(no_name.into()).await, Err(StoreError::Damaged(_))));
        }
        let left = fs::read_dir(folder.path().join("unfinished"))
            .expect("a folder")
            .count();
        assert_eq!(left, 0);
    }
}
