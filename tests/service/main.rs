//! The service as its clients meet it: sessions, gRPC, HTTP, WebSockets, limits, hostile input, ends.

mod animations;
mod drain;
mod durable;
mod grpc;
mod hostile;
mod hostile_calls;
mod http;
mod limits;
mod nodes;
#[cfg(target_os = "linux")]
mod parsers_apart;
mod security;
mod session;
mod stream;
#[path = "../support/mod.rs"]
mod support;
mod traces;
mod troubleshooting;
