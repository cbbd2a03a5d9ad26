//! Several nodes with one store, in PostgreSQL and S3: each session is at one of them, whatever happens to nodes and database.

use crate::durable::path;
use crate::durable::place::StorePlace;
use crate::support::program::ServedProgram;
use crate::support::server::{Came, Socket, retried};
use pliant::wire::pb::{self, deform_request, deform_response};
use std::time::Duration;

mod database;
mod ownership;
mod sent_on;

/// How long nodes of tests keep their sessions without a word.
const LEASE: Duration = Duration::from_secs(1);

/// A node, started on a place with its name.
fn node(place: &StorePlace, name: &str) -> ServedProgram {
    node_at(place, name, place.database().map(|d| d.url.clone()))
}

/// As `node`, with further arguments, or others than it has.
fn node_with(place: &StorePlace, name: &str, more: &[&str]) -> ServedProgram {
    started(place, name, place.database().map(|d| d.url.clone()), more)
}

/// As `node`, with the database behind another address.
fn node_at(place: &StorePlace, name: &str, database: Option<String>) -> ServedProgram {
    started(place, name, database, &[])
}

fn started(place: &StorePlace, name: &str, database: Option<String>, more: &[&str]) -> ServedProgram {
    let mut arguments = vec!["--advertise", "http://127.0.0.1:0", "--node", name];
    for default in [["--lease", "1s"], ["--heartbeat", "200ms"], ["--drain-deadline", "5s"]] {
        if !more.contains(&default[0]) {
            arguments.extend(default);
        }
    }
    arguments.extend(more);
    let log = format!("log-{name}");
    place
        .start_logged(&log, database.as_deref(), &arguments)
        .expect("the node starts")
}

/// A client that goes nowhere on its own.
fn unmoved() -> reqwest::Client {
    let none = reqwest::redirect::Policy::none();
    let client = reqwest::Client::builder().no_proxy().redirect(none).build();
    client.expect("a client")
}

/// The status of a call that this node answers on its own, asked again for as long as it is unavailable or at another node.
async fn answered(server: &ServedProgram, path: &str) -> u16 {
    let client = unmoved();
    retried("an answer of this node", Duration::from_millis(20), async || {
        let asked = client.get(format!("{}{path}", server.url)).send().await;
        let status = asked.ok()?.status().as_u16();
        (![307, 503].contains(&status)).then_some(status)
    })
    .await
}

/// A stream on a session that this node has.
async fn stream(server: &ServedProgram, id: &str) -> Socket {
    server.socket(&path(id, "/stream")).await
}

/// Sends a pose, waits for its last frame and acknowledges it; an error where the stream ends instead.
async fn drag(socket: &mut Socket, pose: pb::Pose) -> Result<(), String> {
    let seq = pose.seq;
    socket.send(deform_request::Message::Pose(pose)).await;
    loop {
        match socket.next().await {
            Came::Response(response) => match response.message.expect("a message") {
                deform_response::Message::Frame(frame) if frame.r#final && frame.seq == seq => break,
                deform_response::Message::Error(error) => return Err(format!("{error:?}")),
                _ => {}
            },
            Came::Closed(why) => return Err(format!("closed: {why:?}")),
        }
    }
    socket.send(deform_request::Message::Ack(pb::Ack { seq })).await;
    Ok(())
}
