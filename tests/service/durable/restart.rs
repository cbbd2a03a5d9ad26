//! A server that is started again goes on where the one before was.

use super::{bar_at, bar_session, metric, path, seen, turn};
use crate::durable::place::{StorePlace, in_every_store};
use crate::support::program::ServedProgram;
use crate::support::server::{bar_obj, http, turn_json};
use serde_json::{Value, json};
use std::fs;
use std::sync::{Arc, Mutex};
use std::time::Duration;

fn cut() -> Value {
    json!({"cut": {"plane": {"normal": [0, 1, 1], "offset": 2.01}, "keep": "BOTH", "fill": true}})
}

/// The digests that undo leads to, one after the other, from now on.
async fn digests_back(server: &ServedProgram, id: &str) -> Vec<(Value, Vec<u8>)> {
    let mut found = Vec::new();
    while server.call("POST", &path(id, "/undo"), None).await.0 == 200 {
        let history = server.done("GET", &path(id, "/history"), None).await;
        found.push((history["current"].clone(), server.positions(id).await));
    }
    found
}

in_every_store!(
    everything_is_as_it_was_after_a_crash,
    a_key_is_answered_again_after_a_crash_and_nothing_is_done_twice,
    a_session_that_was_deleted_or_has_expired_does_not_come_back,
    two_servers_do_not_share_a_store,
);

async fn everything_is_as_it_was_after_a_crash(place: StorePlace) {
    let (server, id) = bar_at(&place, &[]).await;
    turn(&server, &id, 0.4).await;
    turn(&server, &id, 0.8).await;
    server.done("POST", &path(&id, "/edits"), Some(&cut())).await;
    let wrap = json!({"wrap": {"model": base64(&bar_obj(7)), "inPlace": true, "landmarks": [{"ownVertex": 0, "targetVertex": 0}]}});
    server.done("POST", &path(&id, "/edits"), Some(&wrap)).await;
    let merge = json!({"merge": {"model": base64(&bar_obj(6)), "how": "LOOSE",
        "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,0,1]}});
    server.done("POST", &path(&id, "/edits"), Some(&merge)).await;
    turn(&server, &id, 0.3).await;
    let rigid = json!({"rigid": true});
    server.done("PATCH", &path(&id, "/handles/top"), Some(&rigid)).await;
    turn(&server, &id, -0.5).await;
    server.done("POST", &path(&id, "/undo"), None).await;
    server.done("POST", &path(&id, "/undo"), None).await;
    server.done("POST", &path(&id, "/redo"), None).await;
    let before = seen(&server, &id).await;
    server.kill();

    let server = place.start(&[]);
    let listed = server.done("GET", "/v1/sessions", None).await;
    assert_eq!(listed["sessions"][0]["revision"], before.0["revision"]);
    assert_eq!(listed["sessions"][0]["handles"], before.0["handles"]);
    assert_eq!(metric(&server, "pliant_sessions ").await, 0.0, "listing opens nothing");
    let after = seen(&server, &id).await;
    assert_eq!(after.0, before.0);
    assert_eq!(after.1, before.1);
    assert!(after.2 == before.2, "the vertices are the same to the bit");

    // The way back is the same on a server that was never stopped, bit for bit, and so is the way on.
    let redone = server.done("POST", &path(&id, "/redo"), None).await;
    let back = digests_back(&server, &id).await;
    assert_eq!(back.len(), 9, "{redone}");
    server.kill();
    let again = place.start(&[]);
    let history = again.done("GET", &path(&id, "/history"), None).await;
    assert_eq!(history["commits"], before.1["commits"], "undone, not gone");
    for _ in 0..9 {
        again.done("POST", &path(&id, "/redo"), None).await;
    }
    assert_eq!(
        again.call("POST", &path(&id, "/redo"), None).await.0,
        409,
        "nothing is left"
    );
    let same = digests_back(&again, &id).await;
    assert_eq!(same.len(), back.len());
    assert!(same.iter().map(|s| &s.1).eq(back.iter().map(|b| &b.1)));
    again.done("POST", &path(&id, "/redo"), None).await;
    turn(&again, &id, 0.2).await;
}

async fn a_key_is_answered_again_after_a_crash_and_nothing_is_done_twice(place: StorePlace) {
    let (server, id) = bar_at(&place, &[]).await;
    let calls = [
        ("POST", "/solve", Some(turn_json(0.7)), "pose"),
        ("PATCH", "/handles/top", Some(json!({"stiffness": 3.0})), "handle"),
        ("POST", "/edits", Some(cut()), "edit"),
        ("POST", "/undo", None, "undo"),
        ("POST", "/solve", Some(turn_json(0.1)), "another pose"),
    ];
    let calls = calls.map(|(method, rest, body, key)| (method, rest, body, key.replace(' ', "-")));
    let mut answers = Vec::new();
    for (method, rest, body, key) in &calls {
        let (status, answer) = server
            .call_with_key(method, &path(&id, rest), body.as_ref(), Some(key))
            .await;
        assert_eq!(status, 200, "{key}: {answer}");
        answers.push(answer);
    }
    let before = seen(&server, &id).await;
    server.kill();

    let server = place.start(&[]);
    for ((method, rest, body, key), was) in calls.iter().zip(&answers) {
        let (status, now) = server
            .call_with_key(method, &path(&id, rest), body.as_ref(), Some(key))
            .await;
        assert_eq!(status, 200, "{key}: {now}\n{}", server.log());
        assert_eq!(without_times(&now), without_times(was), "{key}");
    }
    assert_eq!(seen(&server, &id).await, before, "nothing was done again");
    let (status, refused) = server
        .call_with_key("POST", &path(&id, "/solve"), Some(&turn_json(0.9)), Some("pose"))
        .await;
    assert_eq!(status, 422, "another request: {refused}");
}

async fn a_session_that_was_deleted_or_has_expired_does_not_come_back(place: StorePlace) {
    let server = place.start(&[]);
    let deleted = bar_session(&server).await;
    let kept = bar_session(&server).await;
    let expiring = server.open(bar_obj(8), "?ttl=1s").await;
    server.done("DELETE", &path(&deleted, ""), None).await;
    server.kill();
    let server = place.start(&[]);
    crate::support::server::eventually("the expiry", async || {
        let listed = server.done("GET", "/v1/sessions", None).await;
        listed["sessions"]
            .as_array()
            .is_some_and(|l| l.len() == 1 && l[0]["id"] == kept.as_str())
    })
    .await;
    for gone in [&deleted, &expiring] {
        assert_eq!(server.call("GET", &path(gone, ""), None).await.0, 404);
    }
    server.done("DELETE", &path(&kept, ""), None).await;
    assert_eq!(server.call("GET", &path(&kept, ""), None).await.0, 404);
    assert_eq!(
        place.objects(),
        Vec::<std::path::PathBuf>::new(),
        "nobody uses an object any more"
    );
}

async fn two_servers_do_not_share_a_store(place: StorePlace) {
    let _server = place.start(&[]);
    place.refuses_to_start(&[], &["in use by another process"]);
}

/// An answer without what reports how long it took, or when it is over.
fn without_times(value: &Value) -> Value {
    match value {
        Value::Object(fields) => {
            let kept = fields
                .iter()
                .filter(|(name, _)| !matches!(name.as_str(), "ms" | "buildMs" | "solveMs" | "queueMs" | "expiresAt"));
            kept.map(|(name, value)| (name.clone(), without_times(value))).collect()
        }
        Value::Array(list) => list.iter().map(without_times).collect(),
        other => other.clone(),
    }
}

fn base64(text: &str) -> String {
    use base64::Engine as _;
    base64::engine::general_purpose::STANDARD.encode(text)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_takes_the_place_of_what_was_there() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    turn(&server, &id, 0.2).await;
    let before = seen(&server, &id).await;
    let backup = place.top().join("backup.sqlite");
    place.tamper(&format!("VACUUM INTO '{}'", backup.display())).await;
    for k in 1..20 {
        turn(&server, &id, f64::from(k) * 0.03).await;
    }
    let after = seen(&server, &id).await;
    server.stop().await;
    // Nothing of later is left that would be put into the file.
    for log in ["-wal", "-shm", "-journal"] {
        let log = place.data().join(format!("sessions.sqlite{log}"));
        assert!(!log.exists(), "{}", log.display());
    }
    let newest = fs::read(place.data().join("sessions.sqlite")).expect("a file");
    fs::copy(&backup, place.data().join("sessions.sqlite")).expect("restored");
    // What the backup lacks is reported, until the note of it is removed as the page says.
    let check = place.store(&["check", "--replay"]);
    assert_eq!(check.code, 1, "{}", check.out);
    assert!(check.out.contains("lacks the newest"), "{}", check.out);
    fs::remove_file(place.data().join("sessions.newest")).expect("a note");
    assert_eq!(place.store(&["check", "--replay"]).code, 0);
    let server = place.start(&[]);
    assert_eq!(seen(&server, &id).await, before);
    server.stop().await;
    // The file alone was whole.
    fs::write(place.data().join("sessions.sqlite"), newest).expect("put back");
    assert_eq!(seen(&place.start(&[]), &id).await, after);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_without_its_objects_is_refused() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    server.kill();
    let (objects, away) = (place.data().join("objects"), place.top().join("away"));
    fs::rename(&objects, &away).expect("moved");
    place.refuses_to_start(&[], &["objects is missing, where the models of the sessions lie"]);
    assert!(!objects.exists(), "nothing was made in its place");
    fs::rename(&away, &objects).expect("moved back");
    seen(&place.start(&[]), &id).await;
}

/// Handles need memory too, and idle sessions make room for it.
#[tokio::test(flavor = "multi_thread")]
async fn idle_sessions_make_room_for_the_handles_of_another() {
    let place = StorePlace::folder().await.expect("a folder");
    let server = place.start(&["--memory-bytes", "40MiB"]);
    let mut ids = Vec::new();
    for _ in 0..2 {
        let opened = server.done("POST", "/v1/sessions?sample=creature", None).await;
        ids.push(opened["id"].as_str().expect("an id").to_owned());
    }
    let held =
        |id: &str, x: f64| serde_json::json!({"id": id, "region": {"sphere": {"center": [x, 0.6, 0], "radius": 0.3}}});
    let handles = serde_json::json!({"handles": [held("a", -0.5), held("b", 0.5)]});
    for id in ids.iter().chain(&ids) {
        server.done("PUT", &path(id, "/handles"), Some(&handles)).await;
    }
}

/// Numbers that depend on their seed alone.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self, below: u64) -> u64 {
        self.0 = self
            .0
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) % below
    }
}

/// What a writer knows: what was acknowledged, and what was asked for and not answered.
#[derive(Debug, Default, Clone)]
struct Known {
    /// The history after the newest acknowledged commit.
    history: Value,
    /// Whether a call is under way.
    asked: bool,
    /// Whether that call was acknowledged, and only what it led to is not known.
    answered: bool,
    acknowledged: u64,
}

fn random_call(numbers: &mut Numbers, edits: &mut u32) -> (&'static str, &'static str, Option<Value>) {
    match numbers.next(10) {
        0..5 => (
            "POST",
            "/solve",
            Some(turn_json(numbers.next(200) as f64 / 100.0 - 1.0)),
        ),
        5 => (
            "PATCH",
            "/handles/top",
            Some(json!({"stiffness": 1.0 + numbers.next(9) as f64})),
        ),
        6 => ("PATCH", "/handles/base", Some(json!({"rigid": numbers.next(2) == 0}))),
        7 => ("POST", "/undo", None),
        8 => ("POST", "/redo", None),
        _ if *edits < 3 => {
            *edits += 1;
            let offset = 1.2 + numbers.next(150) as f64 / 100.0;
            let plane = json!({"normal": [0.1, 0.2, 1], "offset": offset});
            ("POST", "/edits", Some(json!({"cut": {"plane": plane, "fill": true}})))
        }
        _ => ("POST", "/undo", None),
    }
}

/// Commits until the server is gone.
async fn write(url: String, id: String, seed: u64, known: Arc<Mutex<Known>>) {
    let (mut numbers, mut edits, client) = (Numbers(seed), 0, http());
    loop {
        let (method, rest, body) = random_call(&mut numbers, &mut edits);
        let mut request = client.request(method.parse().expect("a method"), format!("{url}{}", path(&id, rest)));
        if let Some(body) = body {
            request = request.json(&body);
        }
        known.lock().expect("no panic").asked = true;
        let Ok(answer) = request.send().await else { return };
        let status = answer.status().as_u16();
        // All of it: an answer that breaks off acknowledges nothing.
        let Ok(_) = answer.bytes().await else { return };
        assert!(matches!(status, 200 | 409 | 422), "{method} {rest}: {status}");
        let history = async {
            let answer = client
                .get(format!("{url}{}", path(&id, "/history")))
                .send()
                .await
                .ok()?;
            answer.json::<Value>().await.ok()
        };
        let Some(history) = history.await else {
            // The call was acknowledged, but what the history was then is not known.
            let mut known = known.lock().expect("no panic");
            known.acknowledged += u64::from(status == 200);
            known.answered = status == 200;
            return;
        };
        let mut known = known.lock().expect("no panic");
        known.acknowledged += u64::from(status == 200);
        known.history = history;
        known.asked = false;
    }
}

fn rounds() -> u64 {
    let asked = std::env::var("PLIANT_CRASHES").ok();
    asked.map_or(4, |text| text.parse().expect("PLIANT_CRASHES is a number"))
}

/// The commits as (revision, digest), and the current one.
fn commits(history: &Value) -> (Vec<(u64, String)>, u64) {
    let list = history["commits"].as_array().expect("commits");
    let commit = |c: &Value| {
        let revision = c["revision"]
            .as_str()
            .map_or_else(|| c["revision"].as_u64(), |t| t.parse().ok());
        (
            revision.expect("a number"),
            c["digest"].as_str().expect("a digest").to_owned(),
        )
    };
    let current = &history["current"];
    let current = current.as_str().map_or_else(|| current.as_u64(), |t| t.parse().ok());
    (list.iter().map(commit).collect(), current.expect("a number"))
}

in_every_store!(every_acknowledged_commit_outlives_a_crash_at_any_moment,);

async fn every_acknowledged_commit_outlives_a_crash_at_any_moment(place: StorePlace) {
    let mut server = place.start(&["--history", "1000", "--ttl", "1h"]);
    let (mut acknowledged, mut open) = (0, 0);
    let mut ids = [bar_session(&server).await, bar_session(&server).await];
    let mut numbers = Numbers(20_061);
    for round in 0..rounds() {
        // Logs stay short enough to be followed quickly, and old ones are tried too.
        if round % 10 == 9 {
            ids[(round / 10 % 2) as usize] = bar_session(&server).await;
        }
        let mut writers = Vec::new();
        for (k, id) in ids.iter().enumerate() {
            let history = server.done("GET", &path(id, "/history"), None).await;
            let known = Arc::new(Mutex::new(Known {
                history,
                ..Known::default()
            }));
            let seed = round * 2 + k as u64;
            let task = tokio::spawn(write(server.url.clone(), id.clone(), seed, Arc::clone(&known)));
            writers.push((id.clone(), task, known));
        }
        tokio::time::sleep(Duration::from_millis(20 + numbers.next(600))).await;
        server.kill();
        for (_, task, _) in &mut writers {
            task.await.expect("no call was answered wrongly");
        }
        server = place.start(&["--history", "1000", "--ttl", "1h"]);
        for (id, _, known) in writers {
            let known = known.lock().expect("no panic").clone();
            let now = server.done("GET", &path(&id, "/history"), None).await;
            let ((was, at), (list, current)) = (commits(&known.history), commits(&now));
            acknowledged += known.acknowledged;
            open += u64::from(known.asked);
            if !known.asked {
                assert_eq!((list, current), (was, at), "round {round}: nothing was under way");
                continue;
            }
            // One call may have happened or not: one commit more, in place of what was undone, or one step.
            let same = list.iter().zip(&was).take_while(|(a, b)| a == b).count();
            let is_before = list == was && current == at && !known.answered;
            let is_step = list == was && current != at;
            let is_after = list.len() == same + 1 && was.iter().take(same).next_back().is_some_and(|c| c.0 == at);
            assert!(
                is_before || is_step || is_after,
                "round {round}: {was:?} at {at} became {list:?} at {current}\n{}",
                server.log()
            );
        }
    }
    println!(
        "{} rounds, {acknowledged} commits acknowledged, {open} calls cut off",
        rounds()
    );
    assert!(acknowledged > 0);
}
