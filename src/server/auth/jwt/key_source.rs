//! Where an issuer's keys come from.

use super::jwt_config::KeySource;
use crate::server::https_client::https_connector;
use bytes::Bytes;
use http::{StatusCode, Uri};
use http_body_util::{BodyExt as _, Empty, Limited};
use hyper_util::client::legacy::Client;
use hyper_util::rt::TokioExecutor;
use std::path::Path;
use std::time::Duration;

/// Largest set of keys, bytes.
const LARGEST: usize = 1 << 20;

/// How long fetching it may take.
const PATIENCE: Duration = Duration::from_secs(5);

/// The text of a set of keys.
///
/// # Errors
/// The place, and why it cannot be had.
pub(super) async fn fetch_keys(source: &KeySource) -> Result<Bytes, String> {
    match source {
        KeySource::File(path) => {
            let path = path.clone();
            let read = tokio::task::spawn_blocking(move || read_keys(&path)).await;
            read.map_err(|e| e.to_string())?
        }
        KeySource::Url(url, ca) => {
            let told = |problem: String| format!("cannot fetch the keys at {url}: {problem}");
            let fetched = tokio::time::timeout(PATIENCE, fetch_url(url, ca.as_deref())).await;
            let in_time = fetched.unwrap_or_else(|_| Err(format!("no answer within {} s", PATIENCE.as_secs())));
            in_time.map_err(told)
        }
    }
}

/// The same of a file, at once.
///
/// # Errors
/// The file, and why it cannot be read.
pub(super) fn read_keys(path: &Path) -> Result<Bytes, String> {
    let told = |problem: String| format!("cannot read the keys in {}: {problem}", path.display());
    let facts = std::fs::metadata(path).map_err(|e| told(e.to_string()))?;
    if !facts.is_file() || facts.len() > LARGEST as u64 {
        return Err(told("a regular file of at most 1 MiB is needed".into()));
    }
    let bytes = std::fs::read(path).map_err(|e| told(e.to_string()))?;
    Ok(bytes.into())
}

/// Follows no redirections: the address that was configured is the one that is trusted.
async fn fetch_url(url: &str, ca: Option<&Path>) -> Result<Bytes, String> {
    let uri: Uri = url.parse().map_err(|_| "it is not an address".to_owned())?;
    let client = Client::builder(TokioExecutor::new()).build::<_, Empty<Bytes>>(https_connector(ca)?);
    let answer = client.get(uri).await.map_err(|e| error_chain(&e))?;
    if answer.status() != StatusCode::OK {
        return Err(format!("it answers {}", answer.status()));
    }
    let body = Limited::new(answer.into_body(), LARGEST).collect().await;
    let body = body.map_err(|e| format!("the answer is longer than 1 MiB, or broke off: {e}"))?;
    Ok(body.to_bytes())
}

fn error_chain(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut next = error.source();
    while let Some(cause) = next {
        text += &format!(": {cause}");
        next = cause.source();
    }
    text
}
