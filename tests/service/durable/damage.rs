//! What is damaged is told and never served; other sessions do not suffer.

use super::{bar_session, path, seen, turn};
use crate::durable::place::{StorePlace, in_every_store};
use std::fs;

in_every_store!(
    damaged_rows_are_told_and_nothing_of_them_is_served,
    damaged_objects_are_told_and_a_damaged_shape_is_solved_again,
    what_a_later_version_wrote_is_refused,
);

async fn damaged_rows_are_told_and_nothing_of_them_is_served(place: StorePlace) {
    let server = place.start(&[]);
    let mut ids = Vec::new();
    for _ in 0..6 {
        let id = bar_session(&server).await;
        turn(&server, &id, 0.4).await;
        ids.push(id);
    }
    let healthy = seen(&server, &ids[5]).await;
    server.kill();
    for (id, change) in ids.iter().zip([
        "UPDATE commits SET payload = checksum WHERE sequence = 1 AND session",
        "DELETE FROM commits WHERE sequence = 1 AND session",
        "DELETE FROM commits WHERE sequence = 2 AND session",
        "UPDATE commits SET revision = 7 WHERE sequence = 2 AND session",
        "UPDATE sessions SET model = checksum WHERE id",
    ]) {
        place.tamper(&format!("{change} = '{id}'")).await;
    }
    let server = place.start(&[]);
    for id in &ids[..5] {
        for (method, rest) in [("GET", ""), ("GET", "/positions"), ("GET", "/model"), ("POST", "/undo")] {
            let (status, told) = server.call(method, &path(id, rest), None).await;
            assert_eq!(
                (status, &told["code"]),
                (500, &"DATA_LOSS".into()),
                "{method} {rest}: {told}"
            );
        }
    }
    assert_eq!(
        seen(&server, &ids[5]).await,
        healthy,
        "another session is not concerned"
    );
    turn(&server, &ids[5], 0.1).await;
    let listed = server.done("GET", "/v1/sessions?pageSize=1000", None).await;
    let listed = listed["sessions"].to_string();
    assert!(listed.contains(&ids[5]));
    // Whoever has a damaged session can get rid of it.
    server.done("DELETE", &path(&ids[0], ""), None).await;
    assert_eq!(server.call("GET", &path(&ids[0], ""), None).await.0, 404);
}

async fn damaged_objects_are_told_and_a_damaged_shape_is_solved_again(place: StorePlace) {
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    let model = place.objects();
    assert_eq!(model.len(), 1, "the model");
    // So many that the shape is kept.
    for k in 0..17 {
        turn(&server, &id, f64::from(k) * 0.05).await;
    }
    crate::support::server::eventually("a kept shape", async || place.count("snapshots").await == 1).await;
    let before = seen(&server, &id).await;
    server.kill();

    let shape = place.objects().into_iter().find(|o| *o != model[0]).expect("a shape");
    let whole = fs::read(&shape).expect("readable");
    for damage in [&whole[..whole.len() - 5], b"", &vec![7; whole.len()]] {
        fs::write(&shape, damage).expect("writable");
        let server = place.start(&[]);
        assert_eq!(seen(&server, &id).await, before);
        assert!(server.log().contains("a kept shape is not used"), "{}", server.log());
        server.kill();
    }
    fs::write(&shape, whole).expect("writable");
    let server = place.start(&[]);
    assert_eq!(seen(&server, &id).await, before);
    assert!(!server.log().contains("not used"), "{}", server.log());
    server.kill();

    let whole = fs::read(&model[0]).expect("readable");
    for damage in [Some(&whole[..whole.len() / 2]), Some(b""), None] {
        match damage {
            Some(bytes) => fs::write(&model[0], bytes).expect("writable"),
            None => fs::remove_file(&model[0]).expect("there"),
        }
        let server = place.start(&[]);
        let (status, told) = server.call("GET", &path(&id, ""), None).await;
        assert_eq!((status, &told["code"]), (500, &"DATA_LOSS".into()), "{told}");
        // A new session on the same model mends the object.
        let other = server.open(String::from_utf8(whole.clone()).expect("OBJ"), "").await;
        assert_eq!(seen(&server, &id).await, before);
        server.done("DELETE", &path(&other, ""), None).await;
        server.kill();
    }
}

async fn what_a_later_version_wrote_is_refused(place: StorePlace) {
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    server.kill();
    place.tamper("UPDATE commits SET format = 99 WHERE sequence = 1").await;
    let server = place.start(&[]);
    let (status, told) = server.call("GET", &path(&id, ""), None).await;
    assert_eq!(status, 409, "{told}");
    assert!(
        told["detail"].as_str().is_some_and(|d| d.contains("format 99")),
        "{told}"
    );
    server.kill();
    place.tamper("UPDATE pliant_schema SET version = 99").await;
    let told = place.try_start(&[]).err().expect("refused");
    assert!(told.lines().last().is_some_and(|l| l.contains("version 99")), "{told}");
}
