//! A database or a bucket that goes away and comes back, and connections that break off after every single message of a commit.

use super::{bar_session, path, seen, turn};
use crate::durable::place::StorePlace;
use crate::support::bucket::TestBucket;
use crate::support::postgres::PostgresServer;
use crate::support::postgres_proxy::PostgresProxy;
use crate::support::program::ServedProgram;
use crate::support::server::{Came, bar_obj, eventually, http, turn_json, turned, within};
use pliant::wire::pb::{deform_request, deform_response};
use serde_json::{Value, json};

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

fn assert_unavailable((status, told): (u16, Value)) {
    assert_eq!((status, &told["code"]), (503, &"UNAVAILABLE".into()), "{told}");
    let detail = told["detail"].as_str().unwrap_or_default();
    assert!(
        detail.contains("store") && detail.contains("nothing has changed"),
        "{detail}"
    );
}

#[tokio::test(flavor = "multi_thread")]
async fn a_database_goes_away_and_comes_back() {
    let Some(database) = PostgresServer::start() else {
        return;
    };
    let place = StorePlace::in_database(database.database().await).await;
    let server = place.start(&[]);
    let id = bar_session(&server).await;
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
    let Some(place) = StorePlace::remote().await else {
        return;
    };
    let bucket = place.bucket().expect("a bucket");
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    bucket.set_down(true);
    assert_eq!(create(&server).await, 503);
    // What needs no object goes on.
    turn(&server, &id, 0.4).await;
    drag(&server, &id).await;
    let before = seen(&server, &id).await;
    server.kill();
    let told = place.try_start(&[]).err().expect("refused");
    assert!(told.lines().last().is_some_and(|l| l.contains("objects")), "{told}");
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
    let told = one.start_at(Some(url), &[]).err().expect("refused");
    let last = told.lines().last().unwrap_or_default();
    assert!(last.contains("belong to another database"), "{told}");
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
    let told = start("s3://models/of/plaint").err().expect("refused");
    let last = told.lines().last().unwrap_or_default();
    for word in ["sessions.sqlite", "s3://models/of/plaint", "the mark of that database"] {
        assert!(last.contains(word), "{word} in {told}");
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
    let Some(place) = StorePlace::postgres().await else {
        return;
    };
    let proxy = PostgresProxy::serve(place.database().expect("a database"));
    let url = place.database().expect("a database").through(proxy.socket());
    let server = place.start_at(Some(&url), &[]).expect("the server starts");
    let id = bar_session(&server).await;
    let (mut refused, mut messages) = (0, 0);
    loop {
        messages += 1;
        let before = seen(&server, &id).await;
        proxy.cut_after(messages, None);
        let angle = turn_json(f64::from(messages) * 0.01);
        let (status, told) = server.call("POST", &path(&id, "/solve"), Some(&angle)).await;
        let was_cut = !proxy.take_back();
        let now = seen(&server, &id).await;
        if status == 200 {
            assert_ne!(now, before, "after {messages}");
        } else {
            assert_unavailable((status, told));
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
    let Some(place) = StorePlace::postgres().await else {
        return;
    };
    let proxy = PostgresProxy::serve(place.database().expect("a database"));
    let url = place.database().expect("a database").through(proxy.socket());
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
async fn a_database_that_does_not_answer_holds_nobody_up_but_the_first_who_changes_something() {
    let Some(place) = StorePlace::postgres().await else {
        return;
    };
    let proxy = PostgresProxy::serve(place.database().expect("a database"));
    let url = place.database().expect("a database").through(proxy.socket());
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
