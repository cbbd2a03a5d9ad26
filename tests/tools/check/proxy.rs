//! A server between `pliant check` and the real one that damages positions on their way.

use crate::support::server::http;
use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::response::Response;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::net::TcpListener;

/// What is done to the coordinates of a vertex buffer.
type Damage = Arc<dyn Fn(&mut [f32]) + Send + Sync>;

/// Runs until it is dropped.
pub struct Proxy {
    pub address: SocketAddr,
    task: tokio::task::JoinHandle<()>,
}

impl Proxy {
    /// Stands before the server at `behind`; `damage` changes the coordinates of every vertex buffer.
    pub async fn start(behind: SocketAddr, damage: impl Fn(&mut [f32]) + Send + Sync + 'static) -> Self {
        let damage: Damage = Arc::new(damage);
        let pass = move |request: Request| pass(behind, Arc::clone(&damage), request);
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("an address");
        let router = Router::new().fallback(pass);
        let task = tokio::spawn(async move {
            axum::serve(listener, router).await.expect("it serves");
        });
        Self { address, task }
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn pass(behind: SocketAddr, damage: Damage, request: Request) -> Response {
    let (parts, body) = request.into_parts();
    let body = axum::body::to_bytes(body, 1 << 26).await.expect("a body");
    let path = parts.uri.path_and_query().map_or("/", |p| p.as_str());
    let mut call = http()
        .request(parts.method.clone(), format!("http://{behind}{path}"))
        .body(body);
    for name in ["content-type", "accept"] {
        if let Some(value) = parts.headers.get(name) {
            call = call.header(name, value);
        }
    }
    let answer = call.send().await.expect("an answer");
    let status = answer.status();
    let headers = answer.headers().clone();
    let mut bytes = answer.bytes().await.expect("a body").to_vec();
    if parts.uri.path().ends_with("/positions") {
        let mut floats = crate::support::server::floats(&bytes);
        damage(&mut floats);
        bytes = floats.iter().flat_map(|f| f.to_le_bytes()).collect();
    }
    let mut response = Response::new(Body::from(Bytes::from(bytes)));
    *response.status_mut() = status;
    for (name, value) in &headers {
        if name != "content-length" && name != "transfer-encoding" && name != "content-encoding" {
            response.headers_mut().append(name.clone(), value.clone());
        }
    }
    response
}
