//! A bucket of objects: S3, or whatever speaks as it does.

use super::bucket_client::BucketClient;
use super::session_store::StoreError;
use object_store::aws::{AmazonS3Builder, Checksum};
use object_store::path::Path as ObjectPath;
use object_store::prefix::PrefixStore;
use object_store::{BackoffConfig, ObjectStore, RetryConfig};
use std::sync::Arc;
use std::time::Duration;

/// How long a request is tried again: callers wait for it.
const RETRY: Duration = Duration::from_secs(8);
/// How often.
const RETRIES: usize = 3;

/// Opens `s3://BUCKET/PREFIX`. Who asks, where and how comes from the environment, as other programs of S3 read it:
/// `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`, `AWS_REGION`, `AWS_ENDPOINT`, `AWS_ALLOW_HTTP`.
pub(super) fn open_bucket(url: &str) -> Result<Arc<dyn ObjectStore>, StoreError> {
    let refused = || {
        let text = format!("\"{url}\" is not a place of objects; allowed is s3://BUCKET or s3://BUCKET/PREFIX");
        StoreError::Refused(text)
    };
    let place = url.strip_prefix("s3://").ok_or_else(refused)?;
    let (bucket, prefix) = place.split_once('/').unwrap_or((place, ""));
    let is_name = |b: u8| b.is_ascii_alphanumeric() || b == b'-' || b == b'.';
    if bucket.is_empty() || !bucket.bytes().all(is_name) {
        return Err(refused());
    }
    let prefix = ObjectPath::parse(prefix).map_err(|_| refused())?;
    let retry = RetryConfig {
        backoff: BackoffConfig::default(),
        max_retries: RETRIES,
        retry_timeout: RETRY,
    };
    let client = BucketClient::new().map_err(|e| StoreError::Refused(format!("{url}: {e}")))?;
    let opened = AmazonS3Builder::from_env()
        .with_bucket_name(bucket)
        .with_http_connector(client)
        .with_checksum_algorithm(Checksum::SHA256)
        .with_retry(retry)
        .build()
        .map_err(|e| StoreError::Refused(format!("{url}: {e}")))?;
    Ok(Arc::new(PrefixStore::new(opened, prefix)))
}
