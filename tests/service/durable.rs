//! Sessions with a folder: nothing that was acknowledged is lost, whatever happens to the process, and nothing damaged is served.

pub use crate::support::place;
use crate::support::place::StorePlace;
use crate::support::program::ServedProgram;
pub use crate::support::server::path;
use crate::support::server::{AnsweredCall as _, bar_obj, ends, eventually, turn_json};
use serde_json::{Value, json};

mod away;
mod crash_points;
mod damage;
mod leaving;
mod memory;
mod restart;
mod store_commands;

/// A session on a bar, with its ends as handles.
pub async fn bar_session(server: &ServedProgram) -> String {
    let id = server.open(bar_obj(12), "").await;
    let handles = json!({"handles": ends()});
    server.done("PUT", &path(&id, "/handles"), Some(&handles)).await;
    id
}

/// A server on a place, and such a session.
pub async fn bar_at(place: &StorePlace, arguments: &[&str]) -> (ServedProgram, String) {
    let server = place.start(arguments);
    let id = bar_session(&server).await;
    (server, id)
}

/// Asserts that a call was refused with that status and code; the detail.
#[track_caller]
pub fn refused((status, reply): (u16, Value), expected: u16, code: &str) -> String {
    assert_eq!((status, &reply["code"]), (expected, &code.into()), "{reply}");
    reply["detail"].as_str().unwrap_or_default().to_owned()
}

/// Waits until a server has no session in memory.
pub async fn out_of_memory(server: &ServedProgram) {
    let empty = async || metric(server, "pliant_sessions ").await == 0.0;
    eventually("an empty memory", empty).await;
}

/// Turns the bar's top and commits that.
pub async fn turn(server: &ServedProgram, id: &str, angle: f64) -> Value {
    server.done("POST", &path(id, "/solve"), Some(&turn_json(angle))).await
}

/// All that a client can see of a session, but for times.
pub async fn seen(server: &ServedProgram, id: &str) -> (Value, Value, Vec<u8>) {
    let mut session = server.done("GET", &path(id, ""), None).await;
    let reply = session.as_object_mut().expect("an object");
    reply.remove("expiresAt");
    reply.remove("buildMs");
    (
        session,
        server.done("GET", &path(id, "/history"), None).await,
        server.positions(id).await,
    )
}

/// A figure of `/metrics`.
pub async fn metric(server: &ServedProgram, name: &str) -> f64 {
    let text = server.get("/metrics").answer().await.text().await.expect("a text");
    let line = text.lines().find(|line| line.starts_with(name));
    line.and_then(|l| l.rsplit(' ').next()?.parse().ok()).expect("a figure")
}
