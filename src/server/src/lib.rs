//! The server: gRPC, gRPC-Web, HTTP and WebSocket on one port.
//!
//! This crate translates: authenticate, have `wire` read the request, call pliant-session with values, write its answer as a
//! message. No decision about deformation is taken here, and the three transports call the same functions.
//!
//! [`run`] takes its listener and its shutdown signal as arguments, so a test starts the real server on a free port.

#![cfg_attr(not(test), deny(clippy::disallowed_methods))]

pub mod auth;
pub mod config;
mod connection;
mod dispatch;
pub mod grpc;
mod http;
mod listen;
mod messages;
mod openapi;
mod redirect;
mod reload;
mod request_filter;
mod response_watchdog;
mod state;
mod stream_messages;
mod telemetry;
pub mod tls;
mod uploads;
mod websocket;

pub use config::{Error, ServerConfig};
pub use request_filter::{Hosts, Origins};
pub use telemetry::{TraceExport, logs_json, start_log};
pub use tls::{CertificateField, LARGEST_TLS_FILE, TlsConfig};

use pliant_session::Manager;
use std::future::Future;
use tokio::net::TcpListener;

/// Serves the sessions of `manager` on `listener` until `shutdown` resolves, then drains: new work is rejected, streams
/// are notified, calls may finish until [`ServerConfig::drain_deadline`], then all is dropped.
///
/// # Errors
/// When the services cannot be set up; nothing was served then.
///
/// # Cancel safety
/// Dropping it leaves connections running while no new ones are accepted; let `shutdown` resolve instead.
pub async fn run(
    listener: TcpListener,
    manager: Manager,
    config: ServerConfig,
    shutdown: impl Future<Output = ()>,
) -> Result<(), Error> {
    let address = listener.local_addr().map_err(|e| Error::Start(e.to_string()))?;
    config.check_address(address.ip()).map_err(Error::Start)?;
    let tls = config.tls.as_ref().map(tls::TlsAcceptor::open).transpose();
    let tls = tls.map_err(Error::Start)?;
    let state = state::ServerState::new(manager, config, tls).map_err(Error::Start)?;
    let dispatch = dispatch::Dispatch::new(&state).await.map_err(Error::Start)?;
    let watcher = tokio::spawn(reload::follow_files(state.clone()));
    listen::serve(listener, state, dispatch, shutdown).await;
    watcher.abort();
    Ok(())
}

/// Makes all threads of the process share one heap, where the C library would give each thread an arena of its own.
///
/// Memory that one thread has freed is not used by another then. Sessions move over the threads of a server, so its memory would grow
/// to what all arenas have needed at some time. With one arena it stays level (`loadtest soak`); large blocks are the operating
/// system's either way. Call it when the process starts.
#[allow(unsafe_code)]
pub fn use_one_heap() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        // SAFETY: sets a number that the allocator reads when a thread first asks for memory; it has no other effect.
        unsafe { libc::mallopt(libc::M_ARENA_MAX, 1) };
    }
}
