//! Backups that take the place of what was there, and what is missing.

use super::{bar_session, path, seen, turn};
use crate::durable::place::StorePlace;
use std::fs;

#[tokio::test(flavor = "multi_thread")]
async fn a_backup_takes_the_place_of_what_was_there() {
    let place = StorePlace::folder().await.expect("a folder");
    let server = place.start(&[]);
    let id = bar_session(&server).await;
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
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    server.kill();
    let (objects, away) = (place.data().join("objects"), place.top().join("away"));
    fs::rename(&objects, &away).expect("moved");
    let refused = place.try_start(&[]).err().expect("refused");
    let last = refused.lines().last().unwrap_or_default();
    assert!(
        last.contains("objects is missing, where the models of the sessions lie"),
        "{refused}"
    );
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
