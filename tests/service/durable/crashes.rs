//! A writer of random commits and a process that is killed at random moments: after each start every acknowledged commit is there, none
//! is there half, and the shapes are the same to the bit.
//!
//! `PLIANT_CRASHES` says how many rounds there are; the suite runs a few.

use super::{bar_session, path};
use crate::durable::place::{StorePlace, in_every_store};
use crate::support::server::{http, turn_json};
use serde_json::{Value, json};
use std::sync::{Arc, Mutex};
use std::time::Duration;

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
