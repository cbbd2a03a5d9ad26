//! A damaged or removed log of SQLite takes the newest commits away: that is reported, and nothing else is.

use super::{bar_session, seen, turn};
use crate::durable::place::StorePlace;
use std::fs;
use std::path::PathBuf;

const NOTE: &str = "sessions.newest";

/// The files of the database as a killed server left them.
struct Left(Vec<(PathBuf, Vec<u8>)>);

impl Left {
    fn read(place: &StorePlace) -> Self {
        let names = ["sessions.sqlite", "sessions.sqlite-wal", NOTE];
        let files = names.map(|name| place.data().join(name));
        Self(
            files
                .map(|file| (file.clone(), fs::read(&file).expect("a file")))
                .into(),
        )
    }

    fn put_back(&self, place: &StorePlace) {
        let _ = fs::remove_file(place.data().join("sessions.sqlite-shm"));
        for (file, bytes) in &self.0 {
            fs::write(file, bytes).expect("written");
        }
    }

    fn log(&self) -> (&PathBuf, &[u8]) {
        (&self.0[1].0, &self.0[1].1)
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn commits_that_a_damaged_log_takes_away_are_reported_until_somebody_deals_with_them() {
    let place = StorePlace::folder().await.expect("a folder");
    let server = place.start(&[]);
    let id = bar_session(&server).await;
    // Stopped, so that the log begins with what comes now.
    server.stop().await;
    let server = place.start(&[]);
    for k in 1..6 {
        turn(&server, &id, f64::from(k) * 0.1).await;
    }
    let before = seen(&server, &id).await;
    server.kill();
    let left = Left::read(&place);
    let (log, bytes) = left.log();

    let flips = (0..7).map(|k| Some(k * (bytes.len() - 1) / 6));
    for (k, damage) in flips.chain([None]).enumerate() {
        left.put_back(&place);
        match damage {
            Some(at) => {
                let mut damaged = bytes.to_vec();
                damaged[at] ^= 0x5a;
                fs::write(log, damaged).expect("written");
            }
            None => fs::remove_file(log).expect("there"),
        }
        let check = place.store(&["check", "--replay"]);
        assert_eq!(check.code, 1, "{damage:?}: {}", check.out);
        assert!(check.out.contains("lacks the newest"), "{damage:?}: {}", check.out);
        // Starting takes a while, and says the same of each.
        if k % 3 != 1 {
            continue;
        }
        let server = place.start(&[]);
        assert!(server.log().contains("DATA_LOSS"), "{damage:?}: {}", server.log());
        server.stop().await;
        let server = place.start(&[]);
        assert!(server.log().contains("DATA_LOSS"), "at each start: {}", server.log());
        // What is committed from now on is as safe as ever.
        if server.call("GET", &super::path(&id, ""), None).await.0 == 200 {
            turn(&server, &id, 0.7).await;
        }
        server.stop().await;
        assert_eq!(place.store(&["check"]).code, 1);
        fs::remove_file(place.data().join(NOTE)).expect("a note");
        assert_eq!(place.store(&["check"]).code, 0, "the loss is accepted");
        let server = place.start(&[]);
        assert!(!server.log().contains("DATA_LOSS"), "{}", server.log());
        server.stop().await;
    }

    // As it was left, nothing is missing.
    left.put_back(&place);
    assert_eq!(place.store(&["check", "--replay"]).code, 0);
    assert_eq!(seen(&place.start(&[]), &id).await, before);
}

#[tokio::test(flavor = "multi_thread")]
async fn a_kill_loses_nothing_and_raises_no_alarm() {
    let place = StorePlace::folder().await.expect("a folder");
    let mut server = place.start(&[]);
    let id = bar_session(&server).await;
    for round in 1..4 {
        turn(&server, &id, f64::from(round) * 0.1).await;
        let before = seen(&server, &id).await;
        server.kill();
        // A note that a loss of power tore says nothing.
        if round == 2 {
            fs::write(place.data().join(NOTE), "pliant-newest-1 7").expect("written");
        }
        assert_eq!(place.store(&["check"]).code, 0);
        server = place.start(&[]);
        assert_eq!(seen(&server, &id).await, before);
        assert!(!server.log().contains("DATA_LOSS"), "{}", server.log());
    }
}
