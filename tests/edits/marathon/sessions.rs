//! The same in a session of a real server, over HTTP, with undo and redo in between.

use super::*;
use crate::support::server::{AnsweredCall as _, Server, eventually, floats, http, text, within};
use pliant::session::MemoryUse;
use serde_json::json;

struct Talk {
    server: Server,
    id: String,
}

impl Talk {
    fn path(&self, rest: &str) -> String {
        self.server.url(&format!("/v1/sessions/{}/{rest}", self.id))
    }

    /// Status and answer of a call.
    async fn post(&self, rest: &str, body: &Value) -> (u16, Value) {
        let answer = http().post(self.path(rest)).json(body).answer().await;
        let status = answer.status().as_u16();
        (status, answer.json().await.expect("JSON"))
    }

    /// The digest and the number of vertices now.
    async fn state(&self) -> (String, u64) {
        let get = async |path: String| -> Value {
            let answer = http().get(path.clone()).answer().await;
            answer.json().await.expect("JSON")
        };
        let history = get(self.path("history")).await;
        let commits = history["commits"].as_array().expect("commits");
        let current = commits
            .iter()
            .find(|c| c["revision"] == history["current"])
            .expect("listed");
        let session = get(self.server.url(&format!("/v1/sessions/{}", self.id))).await;
        let vertices = session["model"]["vertices"].as_u64().expect("a count");
        (text(&current["digest"]), vertices)
    }

    async fn bytes(&self) -> Vec<u8> {
        let answer = http().get(self.path("positions")).answer().await;
        assert_eq!(answer.status(), 200);
        answer.bytes().await.expect("bytes").to_vec()
    }

    async fn positions(&self) -> Vec<DVec3> {
        let numbers = floats(&self.bytes().await);
        (numbers
            .chunks_exact(3)
            .map(|c| DVec3::new(c[0].into(), c[1].into(), c[2].into())))
        .collect()
    }
}

/// Digests of the states that undo and redo walk over.
struct Line {
    states: Vec<(String, u64)>,
    at: usize,
}

impl Line {
    fn commit(&mut self, state: (String, u64)) {
        self.states.truncate(self.at + 1);
        self.states.push(state);
        self.at += 1;
    }
}

/// Steps of a session: the states it came to, and how many edits were done, refused, and steps undone and redone.
async fn steps(talk: &Talk, seed: u64, count: usize) -> (Vec<(String, u64)>, [usize; 3]) {
    let mut draw = Draw(seed);
    let mut line = Line {
        states: vec![talk.state().await],
        at: 0,
    };
    let (mut all, mut counts) = (Vec::new(), [0; 3]);
    let mut done = 0;
    while done < count {
        let positions = talk.positions().await;
        let (low, high) = (positions.iter()).fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(l, h), p| {
            (l.min(*p), h.max(*p))
        });
        let diagonal = low.distance(high);
        let seen = Seen {
            positions: &positions,
            edge: 0.04 * diagonal,
            diagonal,
            most: 1500,
            apart: true,
        };
        match draw.below(10) {
            0..5 => {
                let edit = seen.edit(&mut draw);
                let (status, answer) = talk.post("edits", &edit).await;
                done += 1;
                match status {
                    200 => {
                        counts[0] += 1;
                        let state = talk.state().await;
                        assert_eq!(text(&answer["digest"]), state.0);
                        assert_eq!(answer["after"]["vertices"].as_u64(), Some(state.1));
                        line.commit(state);
                    }
                    400 | 409 | 413 | 422 => {
                        counts[1] += 1;
                        assert_eq!(talk.state().await, line.states[line.at], "{edit} was refused: {answer}");
                    }
                    other => panic!("{other} for {edit}: {answer}"),
                }
            }
            5..7 => {
                let body = json!({"pose": seen.pose(&mut draw, "top")});
                let (status, _) = talk.post("solve", &body).await;
                // The handle may have lost everything.
                if status == 200 {
                    line.commit(talk.state().await);
                } else {
                    let handles = json!({"handles": seen.handles(&mut draw)});
                    let put = http().put(talk.path("handles")).json(&handles).send();
                    assert_eq!(within("handles", put).await.expect("an answer").status(), 200);
                    line.commit(talk.state().await);
                }
            }
            way => {
                let (word, to) = if way == 9 {
                    ("redo", line.at + 1)
                } else {
                    ("undo", line.at.wrapping_sub(1))
                };
                let (status, answer) = talk.post(word, &json!({})).await;
                match line.states.get(to) {
                    Some(state) => {
                        assert_eq!(status, 200, "{answer}");
                        line.at = to;
                        counts[2] += 1;
                        assert_eq!(&talk.state().await, state, "{word} gives the bits back");
                    }
                    None => assert_eq!(status, 409, "{answer}"),
                }
            }
        }
        all.push(line.states[line.at].clone());
    }
    // All the way back and forth.
    let last = talk.bytes().await;
    let there = line.at;
    while line.at > 0 {
        assert_eq!(talk.post("undo", &json!({})).await.0, 200);
        line.at -= 1;
        assert_eq!(talk.state().await, line.states[line.at]);
    }
    for _ in 0..there {
        assert_eq!(talk.post("redo", &json!({})).await.0, 200);
    }
    assert_eq!(talk.bytes().await, last, "redone to the bit");
    (all, counts)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_with_undo_and_redo() {
    let mut runs = Vec::new();
    for threads in [1, 2] {
        let server = Server::with(|sessions, _| {
            sessions.compute_threads = threads;
            sessions.history = 1000;
        })
        .await;
        let base = server.manager.metrics().held_bytes(MemoryUse::Sessions).get();
        let id = server.bar_session().await;
        let talk = Talk { server, id };
        let held = talk.server.manager.metrics().held_bytes(MemoryUse::Sessions).get();
        assert!(held > base);
        runs.push(steps(&talk, 21, 80).await);
        let gone = http()
            .delete(talk.server.url(&format!("/v1/sessions/{}", talk.id)))
            .send();
        assert_eq!(within("delete", gone).await.expect("an answer").status(), 204);
        let metrics = talk.server.manager.metrics();
        eventually("memory back at base", async || {
            metrics.held_bytes(MemoryUse::Sessions).get() == base
        })
        .await;
    }
    let [done, refused, walked] = runs[0].1;
    println!("session: {done} edits done, {refused} refused, {walked} undone or redone");
    assert!(done > 40 && walked > 10);
    assert_eq!(runs[0], runs[1], "the same bits on one thread and on two");
}
