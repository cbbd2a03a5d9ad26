//! A database or a bucket that goes away and comes back, and connections that break off after every single message of a commit.

use super::{bar_at, bar_session, out_of_memory, path, refused, seen, turn};
use crate::durable::place::StorePlace;
use crate::support::bucket::TestBucket;
use crate::support::postgres::PostgresProxy;
use crate::support::postgres::PostgresServer;
use crate::support::process::needed;
use crate::support::program::ServedProgram;
use crate::support::server::{AnsweredCall as _, Came, Socket, bar_obj, eventually, http, turn_json, turned, within};
use pliant::wire::pb::{deform_request, deform_response};
use serde_json::{Value, json};
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::process::Command;

/// Drags the bar's top once; the frame has to come.
async fn drag(server: &ServedProgram, id: &str) {
    let mut socket = server.socket(&path(id, "/stream")).await;
    socket.send(deform_request::Message::Pose(turned(1, 0.8, false))).await;
    loop {
        match socket.next().await {
            Came::Response(response) => match response.message.expect("a message") {
                deform_response::Message::Frame(frame) if frame.r#final => return,
                deform_response::Message::Error(error) => panic!("{error:?}"),
                _ => {}
            },
            Came::Closed(why) => panic!("the stream ended: {why:?}"),
        }
    }
}

async fn create(server: &ServedProgram) -> u16 {
    let url = format!("{}/v1/sessions", server.url);
    let created = http().post(url).body(bar_obj(7)).send();
    within("an answer", created).await.expect("an answer").status().as_u16()
}

fn assert_unavailable(answer: (u16, Value)) {
    let detail = refused(answer, 503, "UNAVAILABLE");
    assert!(
        detail.contains("store") && detail.contains("nothing has changed"),
        "{detail}"
    );
}

/// A place in PostgreSQL, and a proxy between it and a server, with its address.
async fn behind_proxy() -> Option<(StorePlace, PostgresProxy, String)> {
    let place = StorePlace::postgres().await?;
    let database = place.database().expect("a database");
    let proxy = PostgresProxy::serve(database);
    let url = database.through(proxy.socket());
    Some((place, proxy, url))
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_goes_away_and_comes_back() {
    let database = needed!(PostgresServer::start());
    let place = StorePlace::in_database(database.database().await).await;
    let (server, id) = bar_at(&place, &[]).await;
    turn(&server, &id, 0.4).await;
    for angle in [0.1, 0.2] {
        let before = seen(&server, &id).await;
        database.crash();
        let soft = json!({"stiffness": 2.0});
        assert_unavailable(server.call("POST", &path(&id, "/solve"), Some(&turn_json(0.9))).await);
        assert_unavailable(server.call("PATCH", &path(&id, "/handles/top"), Some(&soft)).await);
        assert_unavailable(server.call("POST", &path(&id, "/undo"), None).await);
        assert_unavailable(server.call("DELETE", &path(&id, ""), None).await);
        assert_eq!(create(&server).await, 503);
        assert_eq!(
            seen(&server, &id).await,
            before,
            "reading goes on, and nothing has changed"
        );
        drag(&server, &id).await;
        database.go_on();
        turn(&server, &id, angle).await;
    }
    let after = seen(&server, &id).await;
    server.kill();
    assert_eq!(seen(&place.start(&[]), &id).await, after);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_bucket_goes_away_and_comes_back() {
    let place = needed!(StorePlace::remote().await);
    let bucket = place.bucket().expect("a bucket");
    let (server, id) = bar_at(&place, &[]).await;
    bucket.set_down(true);
    assert_eq!(create(&server).await, 503);
    // What needs no object goes on.
    turn(&server, &id, 0.4).await;
    drag(&server, &id).await;
    let before = seen(&server, &id).await;
    server.kill();
    place.refuses_to_start(&[], &["objects"]);
    bucket.set_down(false);
    let server = place.start(&[]);
    assert_eq!(seen(&server, &id).await, before);
    assert_eq!(create(&server).await, 201);
}

#[tokio::test(flavor = "multi_thread")]
async fn objects_of_another_database_are_refused() {
    let (Some(one), Some(other)) = (StorePlace::remote().await, StorePlace::postgres().await) else {
        return;
    };
    bar_session(&one.start(&[])).await;
    let url = &other.database().expect("a database").url;
    let reply = one.start_at(Some(url), &[]).err().expect("refused");
    let last = reply.lines().last().unwrap_or_default();
    assert!(last.contains("belong to another database"), "{reply}");
    assert_eq!(one.objects().len(), 1);
}

/// A prefix that was mistyped is another place than the one that the sessions' objects were written to.
#[tokio::test(flavor = "multi_thread")]
async fn a_place_that_lacks_the_objects_of_the_database_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let (data, bucket) = (folder.path().join("data"), TestBucket::serve().await);
    let start = |prefix: &str| {
        let arguments = ["--data-dir", data.to_str().expect("UTF-8"), "--objects", prefix];
        let variables = bucket.variables();
        let variables: Vec<(&str, &str)> = variables.iter().map(|(name, value)| (*name, value.as_str())).collect();
        ServedProgram::start_anywhere(folder.path().join("log"), &arguments, &variables)
    };
    let server = start(bucket.url()).expect("it starts");
    // Without sessions any place may be marked.
    server.stop().await;
    let server = start(bucket.url()).expect("it starts");
    let id = bar_session(&server).await;
    let before = seen(&server, &id).await;
    server.stop().await;
    let reply = start("s3://models/of/plaint").err().expect("refused");
    let last = reply.lines().last().unwrap_or_default();
    for word in ["sessions.sqlite", "s3://models/of/plaint", "the mark of that database"] {
        assert!(last.contains(word), "{word} in {reply}");
    }
    let mistyped = bucket.files().with_file_name("plaint");
    assert!(!mistyped.exists(), "nothing was marked");
    // A backup may lack the mark: what is there is marked again.
    std::fs::remove_file(bucket.files().join("store")).expect("the mark");
    assert_eq!(seen(&start(bucket.url()).expect("it starts"), &id).await, before);
    assert!(bucket.files().join("store").exists());
}

#[tokio::test(flavor = "multi_thread")]
async fn a_connection_that_breaks_off_after_any_message_leaves_nothing_half_done() {
    let (place, proxy, url) = needed!(behind_proxy().await);
    let server = place.start_at(Some(&url), &[]).expect("the server starts");
    let id = bar_session(&server).await;
    let (mut refused, mut messages) = (0, 0);
    loop {
        messages += 1;
        let before = seen(&server, &id).await;
        proxy.cut_after(messages, None);
        let angle = turn_json(f64::from(messages) * 0.01);
        let (status, reply) = server.call("POST", &path(&id, "/solve"), Some(&angle)).await;
        let was_cut = !proxy.take_back();
        let now = seen(&server, &id).await;
        if status == 200 {
            assert_ne!(now, before, "after {messages}");
        } else {
            assert_unavailable((status, reply));
            assert_eq!(now, before, "after {messages}");
            refused += 1;
        }
        drag(&server, &id).await;
        if !was_cut {
            break;
        }
    }
    println!("{messages} messages, {refused} commits refused");
    assert!(messages > 4 && refused > 4, "{messages} messages, {refused} refused");
    // What was refused and may have been written all the same is gone with the next commit.
    turn(&server, &id, 0.5).await;
    let after = seen(&server, &id).await;
    server.kill();
    assert_eq!(seen(&place.start(&[]), &id).await, after);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_process_that_ends_after_any_message_leaves_the_state_before_or_after() {
    let (place, proxy, url) = needed!(behind_proxy().await);
    let mut server = place.start_at(Some(&url), &[]).expect("the server starts");
    let id = bar_session(&server).await;
    turn(&server, &id, 0.3).await;
    let (mut lost, mut kept, mut messages) = (0, 0, 0);
    loop {
        messages += 1;
        let before = seen(&server, &id).await;
        proxy.cut_after(messages, Some(server.id()));
        let angle = turn_json(f64::from(messages) * 0.01);
        let answered = server.try_call("POST", &path(&id, "/solve"), Some(&angle)).await;
        if proxy.take_back() {
            assert_eq!(answered, Some(200), "nothing was cut");
            break;
        }
        server.kill();
        server = place.start_at(Some(&url), &[]).expect("the server starts");
        let now = seen(&server, &id).await;
        if now == before {
            assert_ne!(answered, Some(200), "it was acknowledged");
            lost += 1;
        } else {
            // One commit more, and all of it.
            let commits = |seen: &(Value, Value, Vec<u8>)| seen.1["commits"].as_array().map_or(0, Vec::len);
            assert_eq!(commits(&now), commits(&before) + 1);
            kept += 1;
        }
        eventually("a server that writes", async || {
            server.call("POST", &path(&id, "/undo"), None).await.0 == 200
        })
        .await;
        server.done("POST", &path(&id, "/redo"), None).await;
    }
    println!("{messages} messages, {lost} commits never were, {kept} are there");
    assert!(lost > 4 && kept > 0, "{lost} lost, {kept} kept");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_that_does_not_answer_holds_no_one_up_but_the_first_who_changes_something() {
    let (place, proxy, url) = needed!(behind_proxy().await);
    let server = place.start_at(Some(&url), &[]).expect("the server starts");
    let id = bar_session(&server).await;
    let before = seen(&server, &id).await;
    proxy.set_silent(true);
    for _ in 0..3 {
        assert_unavailable(server.call("POST", &path(&id, "/solve"), Some(&turn_json(0.9))).await);
        assert_eq!(
            seen(&server, &id).await,
            before,
            "reading goes on, and nothing has changed"
        );
        drag(&server, &id).await;
    }
    proxy.set_silent(false);
    eventually("a server that writes", async || {
        server.call("POST", &path(&id, "/solve"), Some(&turn_json(0.2))).await.0 == 200
    })
    .await;
    let after = seen(&server, &id).await;
    server.kill();
    assert_eq!(seen(&place.start(&[]), &id).await, after);
}

async fn ready(server: &ServedProgram) -> (u16, Value) {
    server.call("GET", "/readyz", None).await
}

/// What would change something is refused with words that any client may read.
async fn refuses_changes(server: &ServedProgram, id: &str, place: &StorePlace) {
    let soft = serde_json::json!({"stiffness": 2.0});
    for (method, rest, body) in [
        ("POST", "/solve", Some(turn_json(0.9))),
        ("POST", "/undo", None),
        ("PATCH", "/handles/top", Some(soft)),
        ("DELETE", "", None),
    ] {
        let (status, reply) = server.call(method, &path(id, rest), body.as_ref()).await;
        let reported_text = reply.to_string();
        assert_eq!(
            (status, &reply["code"]),
            (503, &"UNAVAILABLE".into()),
            "{method} {rest}: {reply}"
        );
        let folder = place.top().display().to_string();
        for secret in [&*folder, "sqlite", "os error", "data"] {
            assert!(!reported_text.contains(secret), "{reply}");
        }
    }
    let created = server.post("/v1/sessions").body(bar_obj(7)).answer().await;
    assert_eq!(created.status(), 503);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_that_was_moved_away_takes_no_changes_until_it_is_back() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    turn(&server, &id, 0.4).await;
    let before = seen(&server, &id).await;
    assert_eq!(ready(&server).await.0, 200);
    let away = place.top().join("away");
    for replaced in [false, true] {
        fs::rename(place.data(), &away).expect("moved");
        if replaced {
            fs::create_dir(place.data()).expect("another folder");
        }
        eventually("not ready", async || ready(&server).await.0 == 503).await;
        refuses_changes(&server, &id, &place).await;
        let text = ready(&server).await.1["detail"].to_string();
        assert!(text.contains("cannot be written"), "{text}");
        assert!(
            server.log().contains(&place.data().display().to_string()),
            "the log tells which"
        );
        if replaced {
            assert_eq!(
                fs::read_dir(place.data()).expect("a folder").count(),
                0,
                "nothing is written there"
            );
            fs::remove_dir(place.data()).expect("empty");
        }
        fs::rename(&away, place.data()).expect("moved back");
        eventually("ready", async || ready(&server).await.0 == 200).await;
        assert_eq!(seen(&server, &id).await, before);
    }
    turn(&server, &id, 0.9).await;
    let after = seen(&server, &id).await;
    server.kill();
    assert_eq!(seen(&place.start(&[]), &id).await, after);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_left_memory_is_not_damaged_because_its_folder_is_away() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &["--idle", "200ms"]).await;
    turn(&server, &id, 0.4).await;
    let before = seen(&server, &id).await;
    out_of_memory(&server).await;
    let away = place.top().join("away");
    fs::rename(place.data(), &away).expect("moved");
    for (method, rest) in [("GET", "/positions"), ("GET", ""), ("POST", "/undo")] {
        refused(server.call(method, &path(&id, rest), None).await, 503, "UNAVAILABLE");
    }
    assert_eq!(ready(&server).await.0, 503);
    fs::rename(&away, place.data()).expect("moved back");
    assert_eq!(seen(&server, &id).await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_stays_with_its_server_when_the_lock_file_is_gone() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    fs::remove_file(place.data().join("lock")).expect("a lock file");
    place.refuses_to_start(&[], &["in use by another process"]);
    assert_eq!(place.store(&["prune"]).code, 2);
    turn(&server, &id, 0.4).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_is_kept_is_for_its_owner_alone() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    for k in 0..17 {
        turn(&server, &id, f64::from(k) * 0.05).await;
    }
    let mut waiting = vec![place.data()];
    let mut files = 0;
    while let Some(path) = waiting.pop() {
        let Ok(facts) = fs::metadata(&path) else { continue };
        let mode = facts.permissions().mode() & 0o777;
        let private = if facts.is_dir() { 0o700 } else { 0o600 };
        assert_eq!(mode, private, "{} {mode:o}", path.display());
        files += 1;
        if facts.is_dir() {
            waiting.extend(fs::read_dir(&path).expect("readable").flatten().map(|e| e.path()));
        }
    }
    assert!(files > 8, "{files}");
}

/// Sets the most bytes that a file of the program may have: as a full disk, writing fails. False where the machine cannot.
fn limit_files(server: &ServedProgram, most: &str) -> bool {
    let asked = Command::new("prlimit")
        .args(["--pid", &server.id().to_string(), &format!("--fsize={most}:unlimited")])
        .status();
    let done = asked.is_ok_and(|status| status.success());
    if !done {
        println!("SKIPPED: there is no prlimit, so no disk can be full");
    }
    done
}

#[tokio::test(flavor = "multi_thread")]
async fn a_full_disk_refuses_changes_and_nothing_else() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path().join("data");
    let server = ServedProgram::start(&folder, &[]);
    let id = bar_session(&server).await;
    turn(&server, &id, 0.4).await;
    let before = seen(&server, &id).await;
    if !limit_files(&server, "1") {
        return;
    }
    let cut = serde_json::json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 2.01}}});
    let soft = serde_json::json!({"stiffness": 2.0});
    for (method, rest, body) in [
        ("POST", "/solve", Some(turn_json(0.9))),
        ("POST", "/undo", None),
        ("POST", "/edits", Some(cut)),
        ("PATCH", "/handles/top", Some(soft)),
        ("DELETE", "", None),
    ] {
        let answer = server
            .call_with_key(method, &path(&id, rest), body.as_ref(), Some("k"))
            .await;
        let detail = refused(answer, 503, "UNAVAILABLE");
        assert!(
            detail.contains("store") && detail.contains("nothing has changed"),
            "{detail}"
        );
        for secret in [&*folder.display().to_string(), "sqlite", "disk", "error", "object"] {
            assert!(!detail.contains(secret), "{detail}");
        }
    }
    // `/readyz` reports it.
    let (status, reply) = server.call("GET", "/readyz", None).await;
    assert!(
        status == 503
            && reply["detail"]
                .to_string()
                .contains("store of sessions cannot be written"),
        "{reply}"
    );
    let created = server.post("/v1/sessions").body(bar_obj(7)).answer().await;
    assert_eq!(created.status(), 503);
    assert_eq!(
        seen(&server, &id).await,
        before,
        "reading goes on, and nothing has changed"
    );
    let listed = server.done("GET", "/v1/sessions", None).await;
    assert_eq!(listed["sessions"].as_array().map(Vec::len), Some(1));

    // Dragging goes on; a pose that is to be committed is refused.
    let mut socket = server.socket(&path(&id, "/stream")).await;
    socket.send(deform_request::Message::Pose(turned(1, 0.8, false))).await;
    let drag = frame_or_failure(&mut socket).await;
    assert!(matches!(drag, deform_response::Message::Frame(_)), "{drag:?}");
    socket.send(deform_request::Message::Pose(turned(2, 0.8, true))).await;
    let commit = frame_or_failure(&mut socket).await;
    assert!(matches!(commit, deform_response::Message::Error(_)), "{commit:?}");
    drop(socket);
    assert_eq!(seen(&server, &id).await, before);

    // There is room again, for commits and not for much more: `/readyz` says so as soon as they work.
    assert!(limit_files(&server, "1000000"));
    eventually("ready for commits", async || {
        server.call("GET", "/readyz", None).await.0 == 200
    })
    .await;
    turn(&server, &id, 0.5).await;
    assert!(limit_files(&server, "unlimited"));
    eventually("ready again", async || {
        server.call("GET", "/readyz", None).await.0 == 200
    })
    .await;
    turn(&server, &id, 0.9).await;
    let after = seen(&server, &id).await;
    server.kill();
    let server = ServedProgram::start(&folder, &[]);
    assert_eq!(seen(&server, &id).await, after);
}

async fn frame_or_failure(socket: &mut Socket) -> deform_response::Message {
    loop {
        match socket.next().await {
            Came::Response(response) => match response.message.expect("a message") {
                deform_response::Message::Frame(frame) if !frame.r#final => {}
                message => return message,
            },
            Came::Closed(why) => panic!("the stream ended: {why:?}"),
        }
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_folder_that_cannot_be_had_is_reported_and_nothing_starts() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("data");
    std::fs::write(&file, "a file").expect("writable");
    let reply = ServedProgram::try_start(&file, &[]).err().expect("refused");
    let last = reply.lines().last().unwrap_or_default();
    assert!(
        last.contains("the store of sessions") && last.contains("data"),
        "{reply}"
    );
}
