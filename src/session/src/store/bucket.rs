//! Objects in a bucket of S3, or of a service with the same interface. Requests use the same HTTP and TLS as the rest of
//! the program, and each has a time limit.

use super::session_store::StoreError;
use bytes::Bytes;
use futures::future::BoxFuture;
use http_body_util::{BodyExt as _, Limited};
use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use object_store::aws::{AmazonS3Builder, Checksum};
use object_store::client::{
    HttpClient, HttpConnector as MakesClients, HttpError, HttpErrorKind, HttpRequest, HttpRequestBody, HttpResponse,
    HttpResponseBody, HttpService,
};
use object_store::path::Path as ObjectPath;
use object_store::prefix::PrefixStore;
use object_store::{BackoffConfig, ClientOptions, ObjectStore, RetryConfig};
use std::error::Error;
use std::sync::Arc;
use std::time::Duration;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

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

/// How long a connection may take to come about.
const CONNECT: Duration = Duration::from_secs(5);
/// How long one request may take, an object's bytes included.
const REQUEST: Duration = Duration::from_secs(120);
/// Bytes of the largest answer: more than any upload has.
const LARGEST: usize = 16 << 30;

/// Calls a bucket. Certificates are those of the operating system's authorities, or of `SSL_CERT_FILE`.
#[derive(Debug, Clone)]
pub(super) struct BucketClient(Client<HttpsConnector<HttpConnector>, HttpRequestBody>);

impl BucketClient {
    /// Makes a client; nothing is sent yet.
    pub fn new() -> Result<Self, String> {
        let mut roots = RootCertStore::empty();
        // A machine without any can still speak HTTP.
        roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
        let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .map_err(|e| e.to_string())?
            .with_root_certificates(roots)
            .with_no_client_auth();
        let mut connector = HttpConnector::new();
        connector.enforce_http(false);
        connector.set_connect_timeout(Some(CONNECT));
        let connector = HttpsConnectorBuilder::new()
            .with_tls_config(config)
            .https_or_http()
            .enable_http1()
            .wrap_connector(connector);
        Ok(Self(Client::builder(TokioExecutor::new()).build(connector)))
    }

    /// Sends a request and reads all of the answer.
    async fn send(&self, request: HttpRequest) -> Result<HttpResponse, HttpError> {
        let answer = self.0.request(request).await.map_err(|error| {
            let kind = match error.is_connect() {
                true => HttpErrorKind::Connect,
                false => kind_of(&error),
            };
            HttpError::new(kind, error)
        })?;
        let (head, body) = answer.into_parts();
        let body = Limited::new(body, LARGEST).collect().await;
        let body: Bytes = body
            .map_err(|error| HttpError::new_boxed(kind_of(&*error), error))?
            .to_bytes();
        Ok(HttpResponse::from_parts(head, HttpResponseBody::from(body)))
    }
}

/// What kind of failure it is: what broke off may be tried again.
fn kind_of(error: &(dyn Error + 'static)) -> HttpErrorKind {
    let mut source = Some(error);
    while let Some(error) = source {
        if let Some(error) = error.downcast_ref::<hyper::Error>()
            && (error.is_closed() || error.is_incomplete_message() || error.is_body_write_aborted())
        {
            return HttpErrorKind::Request;
        }
        if error.downcast_ref::<std::io::Error>().is_some() {
            return HttpErrorKind::Interrupted;
        }
        source = error.source();
    }
    HttpErrorKind::Unknown
}

impl HttpService for BucketClient {
    fn call<'a, 'b>(&'a self, request: HttpRequest) -> BoxFuture<'b, Result<HttpResponse, HttpError>>
    where
        'a: 'b,
        Self: 'b,
    {
        Box::pin(async move {
            match tokio::time::timeout(REQUEST, self.send(request)).await {
                Ok(answer) => answer,
                Err(late) => Err(HttpError::new(HttpErrorKind::Timeout, late)),
            }
        })
    }
}

impl MakesClients for BucketClient {
    fn connect(&self, _: &ClientOptions) -> object_store::Result<HttpClient> {
        Ok(HttpClient::new(self.clone()))
    }
}
