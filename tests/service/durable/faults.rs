//! A store that cannot be written: what would change something is refused and changes nothing; everything else goes on.

use super::{bar_session, path, seen, turn};
use crate::support::program::ServedProgram;
use crate::support::server::{AnsweredCall as _, Came, Socket, bar_obj, eventually, turn_json, turned};
use pliant::wire::pb::{deform_request, deform_response};
use std::process::Command;

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
        let (status, told) = server
            .call_with_key(method, &path(&id, rest), body.as_ref(), Some("k"))
            .await;
        assert_eq!(
            (status, &told["code"]),
            (503, &"UNAVAILABLE".into()),
            "{method} {rest}: {told}"
        );
        let detail = told["detail"].as_str().unwrap_or_default();
        assert!(
            detail.contains("store") && detail.contains("nothing has changed"),
            "{detail}"
        );
        for secret in [&*folder.display().to_string(), "sqlite", "disk", "error", "object"] {
            assert!(!detail.contains(secret), "{detail}");
        }
    }
    // Whoever watches is told.
    let (status, told) = server.call("GET", "/readyz", None).await;
    assert!(
        status == 503
            && told["detail"]
                .to_string()
                .contains("store of sessions cannot be written"),
        "{told}"
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

    // There is room again, for commits and not for much more: whoever watches hears of it as soon as they work.
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
async fn a_folder_that_cannot_be_had_is_told_and_nothing_starts() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("data");
    std::fs::write(&file, "a file").expect("writable");
    let told = ServedProgram::try_start(&file, &[]).err().expect("refused");
    let last = told.lines().last().unwrap_or_default();
    assert!(
        last.contains("the store of sessions") && last.contains("data"),
        "{told}"
    );
}
