//! What is large, by content: an object's name is the SHA-256 of its bytes, so it is written once and never changes, and what is read
//! can be compared with its name.

use super::bucket::open_bucket;
use super::object_folder::ObjectFolder;
use super::session_store::StoreError;
use bytes::Bytes;
use futures::TryStreamExt as _;
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectStore, ObjectStoreExt as _, PutMode, PutOptions};
use sha2::{Digest as _, Sha256};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;
use tokio::sync::{RwLock, Semaphore};

/// Objects that are hashed or written at a time.
const BLOCKING: usize = 4;
/// The object of a bucket that says whose objects the others are.
const IDENTITY: &str = "store";

/// The objects of a store.
#[derive(Debug)]
pub(super) struct Objects {
    store: Arc<dyn ObjectStore>,
    /// Where they lie in a local folder: that is where they are written.
    folder: Option<Arc<ObjectFolder>>,
    blocking: Semaphore,
    /// Held for reading from before an object is written until the row that names it is; for writing while objects without a name are
    /// removed.
    pub naming: RwLock<()>,
}

impl Objects {
    /// The objects below a folder.
    pub fn in_folder(folder: &Path) -> Result<Self, StoreError> {
        let folder = ObjectFolder::open(folder)?;
        let store = LocalFileSystem::new_with_prefix(&folder.objects)
            .map_err(|e| StoreError::Unavailable(format!("{}: {e}", folder.objects.display())))?;
        Ok(Self::of(Arc::new(store), Some(folder)))
    }

    /// The objects of a bucket, `s3://BUCKET/PREFIX`.
    pub fn in_bucket(url: &str) -> Result<Self, StoreError> {
        Ok(Self::of(open_bucket(url)?, None))
    }

    fn of(store: Arc<dyn ObjectStore>, folder: Option<ObjectFolder>) -> Self {
        Self {
            store,
            folder: folder.map(Arc::new),
            blocking: Semaphore::new(BLOCKING),
            naming: RwLock::new(()),
        }
    }

    /// Refuses objects of another database: each removes what it does not name.
    pub async fn belong_to(&self, identity: &str) -> Result<(), StoreError> {
        let identity = format!("pliant objects of the store {identity}\n").into_bytes();
        let there = match &self.folder {
            Some(folder) => {
                let (folder, identity) = (Arc::clone(folder), identity.clone());
                let told = move || {
                    folder
                        .identity(&identity)
                        .map_err(|e| StoreError::Unavailable(format!("whose objects these are cannot be told: {e}")))
                };
                self.apart(told).await?
            }
            None => self.identity_in_bucket(&identity).await?,
        };
        match there == identity {
            true => Ok(()),
            false => Err(StoreError::Refused(
                "the objects belong to another database; a database needs a folder or prefix of its own".into(),
            )),
        }
    }

    async fn identity_in_bucket(&self, identity: &[u8]) -> Result<Vec<u8>, StoreError> {
        let path = ObjectPath::from(IDENTITY);
        let failed = |e: object_store::Error| StoreError::Unavailable(format!("the objects cannot be reached: {e}"));
        match self.store.get(&path).await {
            Ok(found) => return Ok(found.bytes().await.map_err(failed)?.to_vec()),
            Err(object_store::Error::NotFound { .. }) => {}
            Err(error) => return Err(failed(error)),
        }
        let create = PutOptions::from(PutMode::Create);
        let put = self.store.put_opts(&path, identity.to_vec().into(), create).await;
        put.map_err(failed)?;
        Ok(identity.to_vec())
    }

    /// Writes an object and returns its name.
    pub async fn put(&self, bytes: Bytes) -> Result<String, StoreError> {
        let (folder, given) = (self.folder.clone(), bytes.clone());
        let name = self.apart(move || {
            let name = name_of(&given);
            if let Some(folder) = folder {
                folder
                    .write(&name, &given)
                    .map_err(|e| StoreError::Unavailable(format!("an object cannot be written: {e}")))?;
            }
            Ok(name)
        });
        let name = name.await?;
        if self.folder.is_none() {
            // Written anew where it is there: what was damaged is mended.
            let put = self.store.put(&object_path(&name)?, bytes.into()).await;
            put.map_err(|e| StoreError::Unavailable(format!("an object cannot be written: {e}")))?;
        }
        Ok(name)
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

    /// The names of all objects.
    pub async fn names(&self) -> Result<Vec<String>, StoreError> {
        let found: Vec<_> = self
            .store
            .list(None)
            .try_collect()
            .await
            .map_err(|error| StoreError::Unavailable(format!("the objects cannot be listed: {error}")))?;
        let names = found.iter().filter_map(|facts| facts.location.filename());
        Ok(names
            .filter(|name| object_path(name).is_ok())
            .map(str::to_owned)
            .collect())
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
    use std::fs;

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
        assert_eq!(objects.belong_to("this").await, Ok(()));
        assert_eq!(objects.belong_to("this").await, Ok(()));
        assert!(matches!(objects.belong_to("that").await, Err(StoreError::Refused(_))));
    }
}
