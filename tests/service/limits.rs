//! The tables of `deploy/docs/limits.md` are the program's: every key with its default, every limit without a key, every
//! range of a request; and `/v1/limits` reports them by the names that the page gives.

use crate::support::book;

use crate::support::server::*;
use clap::{Args as _, FromArgMatches as _};
use pliant::server::config::{ConfigKeys, ServeSettings};
use pliant::session::{self, MIN_TTL};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::time::Duration;

fn page() -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/docs/limits.md");
    std::fs::read_to_string(path).expect("the page")
}

#[test]
fn keys_and_defaults_are_those_of_the_program() {
    let rows = book::table(&page(), "| key | default |");
    let reply: BTreeSet<&str> = rows.iter().map(|row| row[0].as_str()).collect();
    let keys = ConfigKeys::names();
    assert_eq!(
        reply,
        keys.iter().map(String::as_str).collect(),
        "every key of the configuration, and no other"
    );
    // "none" stands for an empty list.
    let given = rows.iter().filter(|row| row[1] != "none");
    let flags = given.map(|row| format!("--{}={}", row[0].replace('_', "-"), row[1]));
    let command = ConfigKeys::augment_args(clap::Command::new("serve").no_binary_name(true));
    let flags = ConfigKeys::from_arg_matches(&command.get_matches_from(flags)).expect("flags");
    let reply = ServeSettings::load(None, &flags).expect("the page's defaults are values that the program takes");
    let defaults = ServeSettings::load(None, &ConfigKeys::default()).expect("the defaults");
    assert_eq!(reply.listen, defaults.listen);
    assert_eq!(reply.server, defaults.server);
    assert_eq!(reply.session, defaults.session);
    assert_eq!(
        (reply.log, reply.log_format, reply.sample),
        (defaults.log, defaults.log_format, defaults.sample)
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_reports_them_by_these_names() {
    let server = Server::start().await;
    let answer = server.get("/v1/limits").answer().await;
    let answer: BTreeMap<String, Value> = answer.json().await.expect("JSON");
    let rows = book::table(&page(), "| key | default |");
    let named: BTreeMap<&str, &str> = rows.iter().map(|row| (row[2].as_str(), row[1].as_str())).collect();
    for (name, value) in &answer {
        if name == "partBytes" {
            assert!(page().contains("`partBytes`"));
            continue;
        }
        let reply = named
            .get(name.as_str())
            .unwrap_or_else(|| panic!("{name} is told and not on the page"));
        let seen = match value {
            Value::String(text) => text.parse().expect("a number"),
            number => number.as_f64().expect("a number"),
        };
        assert_eq!(seen, number(reply), "{name}");
    }
    for row in rows.iter().filter(|row| row[2] != "-") {
        assert!(answer.contains_key(&row[2]), "{} is not told", row[2]);
    }
}

/// Bytes, seconds or a count.
fn number(text: &str) -> f64 {
    let units = [
        ("GiB", (1u64 << 30) as f64),
        ("MiB", (1u64 << 20) as f64),
        ("24h", 86_400.0),
    ];
    for (unit, factor) in units {
        if let Some(count) = text.strip_suffix(unit) {
            return factor * count.parse().unwrap_or(1.0);
        }
    }
    text.parse().expect("a number")
}

#[test]
fn limits_without_a_key_are_those_of_the_program() {
    // Taken apart whole, so that a new limit does not compile until it is on the page.
    let session::SessionConfig {
        upload_bytes: _,
        vertices: _,
        triangles,
        sessions: _,
        memory_bytes: _,
        high_water,
        handles: _,
        message_bytes: _,
        window: _,
        part_bytes,
        default_ttl: _,
        max_ttl: _,
        idle: _,
        history: _,
        snapshot_bytes,
        solve: _,
        build,
        streams: _,
        animations: _,
        clip_bytes: _,
        clip_joints: _,
        animation_frames: _,
        animation_vertices: _,
        stream_commits,
        session_queue,
        compute_threads: _,
        compute_slots: _,
        compute_queue,
        compute_wait,
        idempotency_age,
        idempotency_keys,
        quotas: _,
        apart: _,
        drain: _,
    } = session::SessionConfig::default();
    assert_eq!(
        triangles,
        2 * session::SessionConfig::default().vertices,
        "twice as many triangles are allowed"
    );
    let wanted = [
        ("data of one frame part (partBytes)", size(part_bytes as u64)),
        ("old shapes that one session keeps", size(snapshot_bytes)),
        ("building a session or its handles", time(build)),
        ("points that ride along in one job passenger", (1 << 24).to_string()),
        (
            "nodes that one inspection lists",
            pliant::batch::MOST_NODES_LISTED.to_string(),
        ),
        ("commits waiting on one stream", stream_commits.to_string()),
        ("calls waiting on one session", session_queue.to_string()),
        ("pieces of work waiting for a compute slot", compute_queue.to_string()),
        (
            "slots for builds, edits and animations that are there for other tenants while one tenant has all",
            session::SLOTS_FOR_ANOTHER_TENANT.to_string(),
        ),
        ("waiting for a compute slot", time(compute_wait)),
        ("answers to idempotency keys, kept for", time(idempotency_age)),
        ("idempotency keys of one caller", idempotency_keys.to_string()),
        (
            "share of memory_bytes from which /readyz says 503",
            high_water.to_string(),
        ),
        (
            "triangles of a remeshed region, or of one that subdivide with auto divides",
            pliant::edit::MOST_TRIANGLES.to_string(),
        ),
        (
            "points of a curve that cuts or is inserted",
            pliant::edit::MOST_POINTS.to_string(),
        ),
        (
            "points of a tube that a region is",
            pliant::engine::MOST_TUBE_POINTS.to_string(),
        ),
        (
            "pairs of faces around one point, at all points of a model that is edited",
            pliant::edit::MOST_FACE_PAIRS.to_string(),
        ),
        (
            "rows of one clip",
            pliant::motion::bvh::ClipLimits::default().frames.to_string(),
        ),
        (
            "numbers in all rows of one clip",
            pliant::motion::bvh::ClipLimits::default().numbers.to_string(),
        ),
        ("shortest time to live that a session may name", time(MIN_TTL)),
        (
            "tenants whose use is counted at a time",
            session::MOST_TENANTS.to_string(),
        ),
        ("tokens of one file", pliant::server::config::MOST_TOKENS.to_string()),
        ("one token", size(pliant::server::auth::LONGEST_TOKEN as u64)),
        (
            "one file of certificates or keys",
            size(pliant::server::LARGEST_TLS_FILE),
        ),
    ];
    let reply: Vec<(String, String)> = book::table(&page(), "| limit | value |")
        .into_iter()
        .map(|row| (row[0].clone(), row[1].clone()))
        .collect();
    let wanted: Vec<(String, String)> = wanted
        .into_iter()
        .map(|(name, value)| (name.to_owned(), value))
        .collect();
    assert_eq!(reply, wanted);
}

fn size(bytes: u64) -> String {
    match bytes {
        b if b >= 1 << 30 => format!("{} GiB", b >> 30),
        b if b >= 1 << 20 => format!("{} MiB", b >> 20),
        b => format!("{} KiB", b >> 10),
    }
}

fn time(span: Duration) -> String {
    match span.as_secs() {
        s if s >= 60 => format!("{} min", s / 60),
        s => format!("{s} s"),
    }
}

/// Each range of a request is tried at its end and one beyond it.
#[tokio::test(flavor = "multi_thread")]
async fn ranges_of_requests_are_kept() {
    let (server, id) = Server::start_with_bar().await;
    let create = |label: usize| {
        let url = server.url(&format!("/v1/sessions?label={}", "x".repeat(label)));
        http().post(url).body(bar_obj(4))
    };
    let list = |size: u32| server.get(&format!("/v1/sessions?pageSize={size}"));
    let solve = |options: Value| {
        let url = server.url(&format!("/v1/sessions/{id}/solve"));
        http().post(url).json(&json!({"options": options}))
    };
    let chains = |names: usize| {
        let list = vec!["%22hips%22"; names].join(",");
        let url = format!("/v1/sessions?sample=figure&options=%7B%22rigidChains%22:[{list}]%7D");
        server.post(&url)
    };
    let stiff = |regions: usize| {
        let handles = json!({
            "handles": [{"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": -0.5}}}],
            "stiff": {"regions": vec![json!({"component": {"index": 0}}); regions]},
        });
        server.put(&format!("/v1/sessions/{id}/handles")).json(&handles)
    };
    let rows = book::table(&page(), "| field | allowed |");
    let fields: Vec<&str> = rows.iter().map(|row| row[0].as_str()).collect();
    let tried = [
        ("label of a session", create(256), create(257)),
        ("rigidChains of a session or job", chains(1024), chains(1025)),
        ("stiff of handles or a job", stiff(256), stiff(257)),
        ("pageSize of a list", list(1000), list(1001)),
        (
            "refine of a solve",
            solve(json!({"refine": 0})),
            solve(json!({"refine": 1001})),
        ),
        (
            "fromRevision of a solve",
            solve(json!({"fromRevision": "3"})),
            solve(json!({"fromRevision": "1000"})),
        ),
    ];
    // Passengers are counted where a model of so many primitives is at hand.
    let known = ["passengers of a session or job", "window of a stream"];
    let (untried, ranges): (Vec<&str>, Vec<&str>) = fields.iter().partition(|field| known.contains(field));
    assert_eq!(ranges, tried.each_ref().map(|(name, _, _)| *name));
    assert_eq!(untried, known);
    for (name, within_it, beyond) in tried {
        let good = within_it.answer().await;
        assert!(good.status().is_success(), "{name}: {}", good.status());
        let bad = beyond.answer().await;
        assert_eq!(bad.status(), 422, "{name}");
    }
    for (window, refused) in [(8, false), (9, true)] {
        let mut socket = server.stream_socket(&id).await;
        let options = pliant::wire::pb::Options {
            window,
            ..Default::default()
        };
        socket
            .send(pliant::wire::pb::deform_request::Message::Options(options))
            .await;
        socket
            .send(pliant::wire::pb::deform_request::Message::Pose(turned(1, 0.1, false)))
            .await;
        let reply = match socket.next().await {
            Came::Response(response) => format!("{response:?}").contains("window"),
            Came::Closed(_) => true,
        };
        assert_eq!(reply, refused, "window {window}");
    }
}
