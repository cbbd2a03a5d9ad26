//! `pliant store`: what operators do with kept sessions while no server holds them.

use super::{bar_at, bar_session, path, seen, turn};
use crate::durable::place::{StorePlace, in_every_store};
use crate::support::process::NoOne;
use crate::support::process::needed;
use crate::support::server::{AnsweredCall as _, bar_obj, http, turn_json};
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::PermissionsExt as _;
use std::path::Path;

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
    let reply: Value = serde_json::from_str(&checked.out).expect("JSON");
    assert_eq!(
        (checked.code, &reply["damaged"]),
        (0, &0.into()),
        "{reply} {}",
        checked.err
    );
    assert_eq!(reply["sessions"][0]["commits"], 3);

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

    // What the process left when it ended in the middle of a call, and a session that no one used for long. That its time to live
    // would be over is not a reason: only a server ends it.
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

    // Damage is reported, and the exit code is that of a check.
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
    let (server, id) = bar_at(&place, &[]).await;
    for command in ["check", "list"] {
        let reply = place.store(&[command]);
        assert!(
            reply.code == 0 && reply.out.contains(&id),
            "{} {}",
            reply.out,
            reply.err
        );
    }
    let reply = place.store(&["prune"]);
    let last = reply.err.lines().last().unwrap_or_default();
    assert!(
        reply.code == 2 && last.contains("in use by another process"),
        "{}",
        reply.err
    );
    turn(&server, &id, 0.4).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_place_where_nothing_is_kept_is_not_made() {
    let place = needed!(StorePlace::folder().await);
    let reply = place.store(&["list"]);
    assert_eq!((reply.code, place.data().exists()), (2, false), "{}", reply.err);
}

/// All files below a folder with their bytes, folders with none.
fn contents(folder: &Path) -> BTreeMap<String, Option<Vec<u8>>> {
    let mut found = BTreeMap::new();
    for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        let name = path.display().to_string();
        if path.is_dir() {
            found.insert(name, None);
            found.extend(contents(&path));
        } else {
            found.insert(name, fs::read(&path).ok());
        }
    }
    found
}

/// Checks, lists and exports; nothing may change.
fn look(place: &StorePlace, id: &str) {
    let before = contents(&place.data());
    let checked = place.store(&["check", "--replay", "--json"]);
    let reply: Value = serde_json::from_str(&checked.out).unwrap_or_default();
    assert_eq!(
        (checked.code, &reply["damaged"], &reply["sessions"][0]["commits"]),
        (0, &0.into(), &4.into()),
        "{reply} {}",
        checked.err
    );
    let listed = place.store(&["list"]);
    assert!(listed.code == 0 && listed.out.starts_with(id), "{}", listed.err);
    let output = place.top().join("out.obj");
    let exported = place.store(&["export", id, output.to_str().expect("UTF-8"), "--force"]);
    assert_eq!(exported.code, 0, "{}", exported.err);
    let data = place.data();
    let audit = std::process::Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(["audit", "--data-dir", data.to_str().expect("UTF-8")])
        .output()
        .expect("the program runs");
    assert!(audit.status.success() && audit.stdout.len() > 100);
    let (mut before, mut after) = (before, contents(&data));
    // Readers beside a server note in its index how far they read.
    for files in [&mut before, &mut after] {
        files.retain(|name, _| !name.ends_with("-shm"));
    }
    assert!(before == after, "{:?} {:?}", before.keys(), after.keys());
}

#[tokio::test(flavor = "multi_thread")]
async fn looking_changes_nothing_beside_a_server_after_a_crash_and_in_a_backup() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    turn(&server, &id, 0.2).await;
    turn(&server, &id, 0.4).await;
    look(&place, &id);
    server.kill();
    // The log that the crash left holds commits.
    assert!(
        place
            .data()
            .join("sessions.sqlite-wal")
            .metadata()
            .is_ok_and(|f| f.len() > 0)
    );
    look(&place, &id);
    let server = place.start(&[]);
    let before = seen(&server, &id).await;
    server.stop().await;
    look(&place, &id);
    // Who opens the database and closes it puts the log into it.
    place.count("sessions").await;
    assert!(!place.data().join("sessions.sqlite-wal").exists());
    look(&place, &id);
    // A backup has no lock file, and may be where no one can write.
    fs::remove_file(place.data().join("lock")).expect("a lock file");
    let readable = |mode| fs::set_permissions(place.data(), fs::Permissions::from_mode(mode)).expect("permissions");
    readable(0o500);
    look(&place, &id);
    readable(0o700);
    assert!(!place.data().join("lock").exists());
    assert_eq!(seen(&place.start(&[]), &id).await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn what_a_server_writes_meanwhile_is_no_damage() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    let writing = async {
        for k in 0..60 {
            server
                .done("POST", &path(&id, "/solve"), Some(&turn_json(f64::from(k) * 0.01)))
                .await;
        }
    };
    let looking = tokio::task::block_in_place(|| {
        std::thread::scope(|scope| {
            let looks = scope.spawn(|| (0..5).map(|_| place.store(&["check"])).collect::<Vec<_>>());
            tokio::runtime::Handle::current().block_on(writing);
            looks.join().expect("no panic")
        })
    });
    for checked in looking {
        assert_eq!(checked.code, 0, "{} {}", checked.out, checked.err);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn where_there_is_no_store_none_is_made() {
    let place = StorePlace::folder().await.expect("a folder");
    for makes_folder in [false, true] {
        if makes_folder {
            fs::create_dir(place.data()).expect("a folder");
        }
        for command in ["check", "list", "prune"] {
            let reply = place.store(&[command]);
            let last = reply.err.lines().last().unwrap_or_default();
            assert!(
                last.contains("there is no store of sessions in"),
                "{command}: {}",
                reply.err
            );
            assert_eq!((reply.code, &*reply.out), (2, ""), "{command}");
        }
        assert_eq!(place.data().exists(), makes_folder);
        assert!(contents(&place.data()).is_empty());
    }
    // A database of something else is not a store either.
    let place = needed!(StorePlace::postgres().await);
    fs::create_dir(place.data()).expect("a folder");
    fs::create_dir(place.data().join("objects")).expect("a folder");
    for command in ["check", "list", "prune"] {
        let reply = place.store(&[command]);
        assert!(reply.err.contains("there is no store of sessions in"), "{}", reply.err);
        assert_eq!(reply.code, 2);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_store_that_may_not_be_read_is_not_reported_to_be_missing() {
    let place = StorePlace::folder().await.expect("a folder");
    let server = place.start(&[]);
    bar_session(&server).await;
    server.stop().await;
    let no_one = needed!(NoOne::new());
    let data = place.data();
    let mode = |of: &Path, mode| fs::set_permissions(of, fs::Permissions::from_mode(mode)).expect("changed");
    let refused = |command: &[&str], unread: &Path| {
        let reply = no_one.program().args(command).arg("--data-dir").arg(&data).output();
        let reply = reply.expect("it runs");
        let err = String::from_utf8_lossy(&reply.stderr).to_lowercase();
        let last = err.lines().last().unwrap_or_default();
        let unread = format!("{}: permission denied", unread.display()).to_lowercase();
        assert!(last.contains(&unread), "{command:?}: {err}");
        assert_eq!(reply.status.code(), Some(2), "{command:?}");
    };
    mode(place.top(), 0o755);
    for (folder_mode, file_mode, unread) in [
        (0o000, 0o644, data.clone()),
        (0o755, 0o000, data.join("sessions.sqlite")),
    ] {
        mode(&data.join("sessions.sqlite"), file_mode);
        mode(&data, folder_mode);
        for command in [&["store", "check"][..], &["store", "list"], &["audit"]] {
            refused(command, &unread);
        }
        mode(&data, 0o700);
        mode(&data.join("sessions.sqlite"), 0o600);
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn objects_without_their_database_are_left_alone() {
    let place = StorePlace::folder().await.expect("a folder");
    let (server, id) = bar_at(&place, &[]).await;
    server.stop().await;
    let database = place.data().join("sessions.sqlite");
    let kept = fs::read(&database).expect("a database");
    for gone in ["sessions.sqlite", "store"] {
        fs::remove_file(place.data().join(gone)).expect("there");
        let before = contents(&place.data());
        let orders: [&[&str]; 4] = [&["check"], &["list"], &["prune", "--dry-run"], &["prune"]];
        for order in orders {
            let reply = place.store(order);
            let last = reply.err.lines().last().unwrap_or_default();
            assert!(
                last.contains("sessions.sqlite is missing") && last.contains("restore"),
                "{order:?}: {}",
                reply.err
            );
            assert_eq!(reply.code, 2, "{order:?}");
        }
        place.refuses_to_start(&[], &["sessions.sqlite is missing"]);
        assert_eq!(place.objects().len(), 1);
        let mut after = contents(&place.data());
        after.retain(|name, _| !name.ends_with("/lock"));
        assert!(after.keys().all(|name| before.contains_key(name)), "{:?}", after.keys());
    }
    fs::write(&database, kept).expect("restored");
    assert_eq!(place.store(&["check"]).code, 0);
    place.start(&[]).done("GET", &path(&id, ""), None).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn the_page_names_the_version_of_the_tables() {
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/docs/durability.md");
    let page = fs::read_to_string(page).expect("the page");
    let reply = page.split_once("tables a version (`").expect("the version").1;
    let reply: u64 = reply.split('`').next().and_then(|n| n.parse().ok()).expect("a number");
    let place = StorePlace::folder().await.expect("a folder");
    place.start(&[]).stop().await;
    // Fails where no row has this version.
    place
        .tamper(&format!(
            "UPDATE pliant_schema SET version = {reply} WHERE version = {reply}"
        ))
        .await;
}

#[tokio::test(flavor = "multi_thread")]
async fn what_an_older_version_wrote_is_read_without_being_changed() {
    let sample = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/service/durable/first_version");
    let reply: Value = serde_json::from_slice(&fs::read(sample.join("session.json")).expect("readable")).expect("JSON");
    let place = StorePlace::folder().await.expect("a folder");
    let copied = std::process::Command::new("cp")
        .arg("-r")
        .arg(sample.join("data"))
        .arg(place.data())
        .status();
    assert!(copied.expect("cp runs").success());
    let before = contents(&place.data());
    let checked = place.store(&["check"]);
    assert_eq!(checked.code, 0, "{} {}", checked.out, checked.err);
    assert!(
        place
            .store(&["list"])
            .out
            .starts_with(reply["session"]["id"].as_str().expect("an id"))
    );
    assert!(contents(&place.data()) == before);
}
