//! `pliant store`: what operators do with kept sessions while no server holds them.

use super::{bar_session, path, turn};
use crate::durable::place::{StorePlace, in_every_store};
use crate::support::server::{AnsweredCall as _, bar_obj, http};
use serde_json::Value;
use std::fs;

in_every_store!(
    what_is_kept_is_checked_listed_exported_and_pruned,
    what_a_server_holds_is_looked_at_and_left_alone,
);

async fn what_is_kept_is_checked_listed_exported_and_pruned(place: StorePlace) {
    let server = place.start(&[]);
    let (id, other) = (bar_session(&server).await, server.open(bar_obj(7), "?ttl=1s").await);
    turn(&server, &id, 0.4).await;
    let url = format!("{}{}?format=obj", server.url, path(&id, "/model"));
    let model = http().get(url).answer().await;
    let model = model.bytes().await.expect("a body");
    server.kill();

    let listed = place.store(&["list"]);
    assert_eq!(listed.code, 0, "{}", listed.err);
    let lines: Vec<Vec<&str>> = listed.out.lines().map(|l| l.split('\t').collect()).collect();
    assert_eq!(
        (lines[0][0], lines[0][1], lines[0][4]),
        (&*id, "3", "default"),
        "{}",
        listed.out
    );
    assert_eq!((lines[1][0], lines.len()), (&*other, 2));

    let checked = place.store(&["check", "--replay", "--json"]);
    let told: Value = serde_json::from_str(&checked.out).expect("JSON");
    assert_eq!(
        (checked.code, &told["damaged"]),
        (0, &0.into()),
        "{told} {}",
        checked.err
    );
    assert_eq!(told["sessions"][0]["commits"], 3);

    let written = place.top().join("out.obj");
    let output = written.to_str().expect("UTF-8");
    let exported = place.store(&["export", &id, output]);
    assert_eq!(exported.code, 0, "{}", exported.err);
    assert_eq!(fs::read(&written).expect("written"), model, "as the server writes it");
    assert_eq!(
        place.store(&["export", &id, output]).code,
        2,
        "nothing is replaced without --force"
    );
    assert_eq!(place.store(&["export", "nobody", output, "--force"]).code, 2);

    // What the process left when it ended in the middle of a call, and a session that nobody used for long. That its time to live
    // would be over is no reason: only a server ends it.
    let shelves = place.objects()[0].ancestors().nth(2).expect("shelves").to_owned();
    fs::create_dir_all(shelves.join("00")).expect("a shelf");
    fs::write(shelves.join("00").join("0".repeat(64)), "left").expect("writable");
    place
        .tamper(&format!("UPDATE sessions SET used_ms = 0 WHERE id = '{other}'"))
        .await;
    let kept = place.store(&["prune", "--dry-run"]);
    assert!(
        kept.out.contains("0 sessions and 1 objects would be removed"),
        "{} {}",
        kept.out,
        kept.err
    );
    let planned = place.store(&["prune", "--unused-for", "1d", "--dry-run"]);
    assert!(
        planned.out.contains("1 sessions and 1 objects would be removed"),
        "{} {}",
        planned.out,
        planned.err
    );
    assert_eq!(place.store(&["list"]).out.lines().count(), 2);
    let pruned = place.store(&["prune", "--unused-for", "1d"]);
    assert!(
        pruned.out.contains("1 sessions and 1 objects removed"),
        "{} {}",
        pruned.out,
        pruned.err
    );
    assert!(pruned.out.contains(&other));
    assert_eq!(place.objects().len(), 1);
    let mine = ["prune", "--unused-for", "0s", "--tenant", "somebody"];
    assert!(place.store(&mine).out.contains("0 sessions"));

    // Damage is told, and the exit code is that of a check.
    let object = place.objects().pop().expect("the model");
    fs::write(&object, "damaged").expect("writable");
    let checked = place.store(&["check"]);
    assert_eq!(checked.code, 1, "{}", checked.out);
    assert!(checked.out.contains(&format!("damaged  {id}")), "{}", checked.out);
    assert_eq!(place.store(&["export", &id, output, "--force"]).code, 1);
    assert_eq!(fs::read(&written).expect("still there"), model);
    assert!(place.store(&["prune", "--unused-for", "0s"]).out.contains(&id));
    assert_eq!(place.store(&["list"]).out, "");
}

async fn what_a_server_holds_is_looked_at_and_left_alone(place: StorePlace) {
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    for command in ["check", "list"] {
        let told = place.store(&[command]);
        assert!(told.code == 0 && told.out.contains(&id), "{} {}", told.out, told.err);
    }
    let told = place.store(&["prune"]);
    let last = told.err.lines().last().unwrap_or_default();
    assert!(
        told.code == 2 && last.contains("in use by another process"),
        "{}",
        told.err
    );
    turn(&server, &id, 0.4).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_place_where_nothing_is_kept_is_not_made() {
    let Some(place) = StorePlace::folder().await else {
        return;
    };
    let told = place.store(&["list"]);
    assert_eq!((told.code, place.data().exists()), (2, false), "{}", told.err);
}
