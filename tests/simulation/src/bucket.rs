//! A bucket that is slow, loses answers and keeps half of an object.

use crate::faults::Faults;
use async_trait::async_trait;
use bytes::Bytes;
use futures::StreamExt as _;
use futures::stream::BoxStream;
use object_store::memory::InMemory;
use object_store::path::Path;
use object_store::{
    CopyOptions, Error, GetOptions, GetResult, ListResult, MultipartUpload, ObjectMeta, ObjectStore,
    ObjectStoreExt as _, PutMultipartOptions, PutOptions, PutPayload, PutResult, Result,
};
use std::fmt;
use std::sync::Arc;

/// Of a thousand new objects so many are torn: the first half is there, and their writer learns of an error.
const TORN: u64 = 20;

/// The bucket, as one node uses it.
#[derive(Debug, Clone)]
pub struct Bucket {
    /// What all nodes have.
    pub objects: Arc<InMemory>,
    /// What goes wrong.
    pub faults: Faults,
}

impl fmt::Display for Bucket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a simulated bucket")
    }
}

fn broken(what: &'static str) -> Error {
    Error::Generic {
        store: "simulation",
        source: what.into(),
    }
}

impl Bucket {
    /// Waits as long as a call takes; whether its answer gets lost.
    async fn reach(&self) -> Result<bool> {
        let fate = self.faults.fate();
        tokio::time::sleep(fate.before + fate.after).await;
        match fate.loses_question {
            true => Err(broken("the request was lost")),
            false => Ok(fate.loses_answer),
        }
    }
}

fn answered<T>(is_lost: bool, answer: T) -> Result<T> {
    match is_lost {
        true => Err(broken("the answer was lost")),
        false => Ok(answer),
    }
}

#[async_trait]
impl ObjectStore for Bucket {
    async fn put_opts(&self, location: &Path, payload: PutPayload, options: PutOptions) -> Result<PutResult> {
        let is_lost = self.reach().await?;
        // Buckets replace an object as a whole.
        let is_there = self.objects.head(location).await.is_ok();
        if !is_there && self.faults.happens(TORN) {
            let whole = Bytes::from(payload);
            self.objects
                .put(location, whole.slice(..whole.len() / 2).into())
                .await?;
            return Err(broken("the object was torn"));
        }
        let put = self.objects.put_opts(location, payload, options).await?;
        answered(is_lost, put)
    }

    async fn put_multipart_opts(&self, _: &Path, _: PutMultipartOptions) -> Result<Box<dyn MultipartUpload>> {
        Err(broken("no object is written in parts"))
    }

    async fn get_opts(&self, location: &Path, options: GetOptions) -> Result<GetResult> {
        let is_lost = self.reach().await?;
        let got = self.objects.get_opts(location, options).await?;
        answered(is_lost, got)
    }

    fn delete_stream(&self, locations: BoxStream<'static, Result<Path>>) -> BoxStream<'static, Result<Path>> {
        let bucket = self.clone();
        let delete = move |location: Result<Path>| {
            let bucket = bucket.clone();
            async move {
                let location = location?;
                let is_lost = bucket.reach().await?;
                bucket.objects.delete(&location).await?;
                answered(is_lost, location)
            }
        };
        locations.then(delete).boxed()
    }

    fn list(&self, prefix: Option<&Path>) -> BoxStream<'static, Result<ObjectMeta>> {
        self.objects.list(prefix)
    }

    async fn list_with_delimiter(&self, prefix: Option<&Path>) -> Result<ListResult> {
        self.objects.list_with_delimiter(prefix).await
    }

    async fn copy_opts(&self, _: &Path, _: &Path, _: CopyOptions) -> Result<()> {
        Err(broken("no object is copied"))
    }
}
