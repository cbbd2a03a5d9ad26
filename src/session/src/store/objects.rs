//! Large data, by content: an object's name is the SHA-256 of its bytes, so it is written once and never changes, and
//! what is read is compared with its name. The shapes of sessions are such objects.
//!
//! `object_store` writes local files without syncing. Here a file is written under another name, synced, renamed, and
//! its folder synced, so that it is whole on disk before a row names it.
//!
//! Objects that no session names, where several nodes share a store: the lock of one node does not cover what another
//! names.
//!
//! A node writes a row for an object before it names it, removes the row in the transaction that names it, and writes
//! one when it removes a name. An unused object whose row is an hour old is removed.

use super::bucket::open_bucket;
use super::location::{make_private_folder, sync_folder};
use super::session_store::StoreError;
use bytes::Bytes;
use futures::TryStreamExt as _;
use glam::DVec3;
use object_store::local::LocalFileSystem;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectStore, ObjectStoreExt as _, PutMode, PutOptions};
use sha2::{Digest as _, Sha256};
use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;
use std::{fs, io};
use tokio::sync::{RwLock, Semaphore};

/// Objects that are hashed or written at a time.
const BLOCKING: usize = 4;
/// The object of a bucket that says whose objects the others are.
const IDENTITY: &str = "store";
/// The object of a bucket that is written to see whether it takes any.
const TRIED: &str = "tried";

/// The objects of a store.
#[derive(Debug)]
pub(super) struct Objects {
    store: Arc<dyn ObjectStore>,
    /// Where they lie in a local folder: that is where they are written.
    folder: Option<Arc<ObjectFolder>>,
    /// How many may be hashed or written beside the tasks; `None` where the tasks do it themselves.
    blocking: Option<Semaphore>,
    /// Held for reading from before an object is written until the row that names it is; for writing while objects without a name are
    /// removed.
    pub naming: RwLock<()>,
}

impl Objects {
    /// The objects below a folder.
    pub fn in_folder(folder: &Path) -> Result<Self, StoreError> {
        Self::of_folder(ObjectFolder::open(folder)?)
    }

    /// The objects below a folder, to be read alone: nothing is made or removed.
    pub fn in_folder_to_read(folder: &Path) -> Result<Self, StoreError> {
        Self::of_folder(ObjectFolder::to_read(folder)?)
    }

    fn of_folder(folder: ObjectFolder) -> Result<Self, StoreError> {
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
            blocking: Some(Semaphore::new(BLOCKING)),
            naming: RwLock::new(()),
        }
    }

    /// Objects of a simulation: nothing runs beside its tasks.
    pub fn simulated(store: Arc<dyn ObjectStore>) -> Self {
        Self {
            blocking: None,
            ..Self::of(store, None)
        }
    }

    /// Refuses objects of another database: each removes what it does not name. Objects that know no database are marked.
    pub async fn belong_to(&self, identity: &str) -> Result<(), StoreError> {
        if !self.agree_with(identity).await? {
            self.write_mark(mark_of(identity)).await?;
        }
        Ok(())
    }

    /// Whether an object is there, whole or not.
    pub async fn has_object(&self, name: &str) -> Result<bool, StoreError> {
        match self.store.head(&object_path(name)?).await {
            Ok(_) => Ok(true),
            Err(object_store::Error::NotFound { .. }) => Ok(false),
            Err(error) => Err(unreachable_bucket(error)),
        }
    }

    /// Refuses objects of another database; whether they know this one.
    pub async fn agree_with(&self, identity: &str) -> Result<bool, StoreError> {
        match self.read_mark().await? {
            None => Ok(false),
            Some(there) if there == mark_of(identity) => Ok(true),
            Some(_) => Err(StoreError::Refused(
                "the objects belong to another database; a database needs a folder or prefix of its own".into(),
            )),
        }
    }

    /// Whether any database has objects here.
    pub async fn are_in_use(&self) -> Result<bool, StoreError> {
        Ok(self.read_mark().await?.is_some() || !self.names().await?.is_empty())
    }

    async fn read_mark(&self) -> Result<Option<Vec<u8>>, StoreError> {
        if let Some(folder) = self.folder.clone() {
            let reported = move || {
                let read = folder.read_identity();
                read.map_err(|e| StoreError::Unavailable(format!("cannot determine whose objects these are: {e}")))
            };
            return self.apart(reported).await;
        }
        match self.store.get(&ObjectPath::from(IDENTITY)).await {
            Ok(found) => Ok(Some(found.bytes().await.map_err(unreachable_bucket)?.to_vec())),
            Err(object_store::Error::NotFound { .. }) => Ok(None),
            Err(error) => Err(unreachable_bucket(error)),
        }
    }

    async fn write_mark(&self, mark: Vec<u8>) -> Result<(), StoreError> {
        if let Some(folder) = self.folder.clone() {
            let written = move || {
                let written = folder.write_identity(&mark);
                written.map_err(|e| StoreError::Unavailable(format!("the objects cannot be marked: {e}")))
            };
            return self.apart(written).await;
        }
        let create = PutOptions::from(PutMode::Create);
        let path = ObjectPath::from(IDENTITY);
        let put = self.store.put_opts(&path, mark.into(), create).await;
        put.map(drop).map_err(unreachable_bucket)
    }

    /// Writes something small, to see whether objects can be written.
    pub async fn try_writing(&self) -> Result<(), StoreError> {
        let refused = |e: &dyn std::fmt::Display| StoreError::Unavailable(format!("objects cannot be written: {e}"));
        if let Some(folder) = self.folder.clone() {
            return self.apart(move || folder.try_writing().map_err(|e| refused(&e))).await;
        }
        let put = self.store.put(&ObjectPath::from(TRIED), Vec::new().into()).await;
        put.map(drop).map_err(|e| refused(&e))
    }

    /// The name that an object has, or will have.
    pub async fn name(&self, bytes: Bytes) -> Result<String, StoreError> {
        self.apart(move || Ok(name_of(&bytes))).await
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
            // Written again where it is there: what was damaged is mended.
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

    /// The names of objects that are not among `used`, in order.
    pub async fn unused(&self, used: Vec<String>) -> Result<Vec<String>, StoreError> {
        let used: BTreeSet<String> = used.into_iter().collect();
        let mut unused = self.names().await?;
        unused.retain(|name| !used.contains(name));
        unused.sort();
        Ok(unused)
    }

    /// Removes an object; a missing one is not an error.
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
        let Some(blocking) = &self.blocking else { return work() };
        let ended = |_| StoreError::Unavailable("the store is going away".into());
        let _place = blocking.acquire().await.map_err(|_| ended(()))?;
        tokio::task::spawn_blocking(work).await.map_err(|_| ended(()))?
    }
}

fn mark_of(identity: &str) -> Vec<u8> {
    format!("pliant objects of the store {identity}\n").into_bytes()
}

fn unreachable_bucket(error: object_store::Error) -> StoreError {
    StoreError::Unavailable(format!("the objects cannot be reached: {error}"))
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

/// Bytes that are written to see whether there is room again: one block of a file system, since a commit may need no more.
const TRIED_BYTES: usize = 4096;

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
        file.write_all(&vec![0; TRIED_BYTES])?;
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

const MARK: &[u8; 4] = b"PLSH";
const VERSION: u32 = 1;
const HEAD: usize = 8;

/// Writes the positions of a shape.
pub(crate) fn write_shape(positions: &[DVec3]) -> Bytes {
    let mut bytes = Vec::with_capacity(HEAD + positions.len() * 24);
    bytes.extend_from_slice(MARK);
    bytes.extend_from_slice(&VERSION.to_le_bytes());
    for number in positions.iter().flat_map(|p| p.to_array()) {
        bytes.extend_from_slice(&number.to_le_bytes());
    }
    bytes.into()
}

/// Reads the positions of a shape.
pub(crate) fn read_shape(bytes: &[u8]) -> Result<Vec<DVec3>, StoreError> {
    let damaged = || StoreError::Damaged("a stored shape is not a shape".into());
    let (head, body) = bytes.split_at_checked(HEAD).ok_or_else(damaged)?;
    if &head[..4] != MARK || head[4..] != VERSION.to_le_bytes() || !body.len().is_multiple_of(24) {
        return Err(damaged());
    }
    let number = |b: &[u8]| b.try_into().map(f64::from_le_bytes).unwrap_or(f64::NAN);
    let vertex = |v: &[u8]| DVec3::new(number(&v[..8]), number(&v[8..16]), number(&v[16..]));
    Ok(body.chunks_exact(24).map(vertex).collect())
}

/// How long after it was announced an object may get its name.
pub(super) const NAMED_WITHIN: Duration = Duration::from_secs(1200);

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[tokio::test]
    async fn an_object_is_kept_under_its_content_and_damage_is_reported_and_mended() {
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

    #[test]
    fn a_shape_comes_back_to_the_bit_and_nothing_else_is_one() {
        let shape = [DVec3::new(0.1, -0.0, 1e-310), DVec3::new(f64::MAX, 1.0 / 3.0, 2.0)];
        let bytes = write_shape(&shape);
        let again = read_shape(&bytes).expect("a shape");
        assert!(
            shape
                .iter()
                .zip(&again)
                .all(|(a, b)| { a.to_array().map(f64::to_bits) == b.to_array().map(f64::to_bits) })
        );
        for wrong in [
            &bytes[..7],
            &bytes[..bytes.len() - 1],
            b"PLSH\x02\0\0\0",
            b"XXXX\x01\0\0\0",
            b"",
        ] {
            assert!(read_shape(wrong).is_err());
        }
    }
}
