//! The server: gRPC, gRPC-Web, HTTP and WebSocket on one port.
//!
//! This floor translates: authorise, have `wire` read the request, call the session floor with values, write its answer as a
//! message. No decision about deformation is taken here, and the three transports call the same functions.
//!
//! [`run`] takes its listener and its wish to stop as arguments, so a test starts the real thing on a free port.

mod animation_frames;
pub mod auth;
pub mod config;
mod connection_facts;
mod connection_slot;
mod dispatch;
mod error;
mod format_name;
pub mod grpc;
mod heap;
mod hosts;
mod http;
pub mod https_client;
mod lingering;
mod listen;
mod messages;
mod openapi;
mod origin;
mod own_certificate;
mod parts_to_send;
mod peers;
mod redirect;
mod reload;
pub mod sample;
mod socket;
mod state;
mod stream_ends;
mod telemetry;
mod tls;
mod unread;
mod upload_pace;
mod uploads;
mod visitors;

pub use config::ServerConfig;
pub use error::Error;
pub use heap::use_one_heap;
pub use hosts::Hosts;
pub use origin::Origins;
pub use telemetry::{TraceExport, logs_json, start_log};
pub use tls::{CertificateField, LARGEST_TLS_FILE, TlsConfig};

use crate::session::Manager;
use std::future::Future;
use tokio::net::TcpListener;

/// Serves the sessions of `manager` on `listener` until `shutdown` resolves, then drains: new work is rejected, streams
/// are notified, calls may finish until [`ServerConfig::drain_deadline`], then all is dropped.
///
/// # Errors
/// When the services cannot be put together; nothing was served then.
///
/// # Cancel safety
/// Dropping it leaves connections running without anyone who accepts new ones; let `shutdown` resolve instead.
pub async fn run(
    listener: TcpListener,
    manager: Manager,
    config: ServerConfig,
    shutdown: impl Future<Output = ()>,
) -> Result<(), Error> {
    let address = listener.local_addr().map_err(|e| Error::Start(e.to_string()))?;
    config.check_address(address.ip()).map_err(Error::Start)?;
    let tls = config.tls.as_ref().map(tls::TlsDoor::open).transpose();
    let tls = tls.map_err(Error::Start)?;
    let state = state::State::new(manager, config, tls).map_err(Error::Start)?;
    let dispatch = dispatch::Dispatch::new(&state).await.map_err(Error::Start)?;
    let watcher = tokio::spawn(reload::follow_files(state.clone()));
    let served = listen::serve(listener, state, dispatch, shutdown).await;
    watcher.abort();
    served
}
