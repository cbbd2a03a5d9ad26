//! A bucket of S3 that tests serve themselves, from a folder.

use hyper_util::rt::{TokioExecutor, TokioIo};
use hyper_util::server::conn::auto::Builder;
use s3s::auth::SimpleAuth;
use s3s::service::S3ServiceBuilder;
use s3s_fs::FileSystem;
use std::fs;
use std::net::SocketAddr;
use std::path::PathBuf;
use tempfile::TempDir;
use tokio::net::TcpListener;
use tokio::sync::watch;

const KEY: &str = "a-key-of-tests";
const SECRET: &str = "a-secret-of-tests";

/// A served bucket, named `models`.
pub struct TestBucket {
    folder: TempDir,
    address: SocketAddr,
    is_down: watch::Sender<bool>,
}

impl TestBucket {
    /// Serves an empty bucket for as long as the test runs.
    pub async fn serve() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        fs::create_dir(folder.path().join("models")).expect("a bucket");
        let files = FileSystem::new(folder.path()).expect("a file system");
        let mut builder = S3ServiceBuilder::new(files);
        builder.set_auth(SimpleAuth::from_single(KEY, SECRET));
        let service = builder.build().into_shared();
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a port");
        let address = listener.local_addr().expect("an address");
        let (is_down, down) = watch::channel(false);
        tokio::spawn(async move {
            while let Ok((socket, _)) = listener.accept().await {
                let (service, mut down) = (service.clone(), down.clone());
                tokio::spawn(async move {
                    let served = Builder::new(TokioExecutor::new());
                    tokio::select! {
                        // A bucket that is down answers nothing, however fast it could.
                        biased;
                        _ = down.wait_for(|is_down| *is_down) => {}
                        _ = served.serve_connection(TokioIo::new(socket), service) => {}
                    }
                });
            }
        });
        Self {
            folder,
            address,
            is_down,
        }
    }

    /// Whether connections are closed, those that are open too.
    pub fn set_down(&self, is_down: bool) {
        self.is_down.send_replace(is_down);
    }

    /// Where the objects are, as the server is given it.
    pub fn url(&self) -> &'static str {
        "s3://models/of/pliant"
    }

    /// The files of the objects.
    pub fn files(&self) -> PathBuf {
        self.folder.path().join("models/of/pliant")
    }

    /// Who asks, and where the bucket is served.
    pub fn variables(&self) -> Vec<(&'static str, String)> {
        vec![
            ("AWS_ACCESS_KEY_ID", KEY.into()),
            ("AWS_SECRET_ACCESS_KEY", SECRET.into()),
            ("AWS_REGION", "us-east-1".into()),
            ("AWS_ENDPOINT", format!("http://{}", self.address)),
            ("AWS_ALLOW_HTTP", "true".into()),
            ("NO_PROXY", "127.0.0.1".into()),
        ]
    }
}
