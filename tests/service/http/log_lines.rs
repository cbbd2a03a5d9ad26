//! What a server writes from its start to its end, read whole: in either format every line has one form.

use crate::support::program::words;
use crate::support::server::*;
use serde_json::Value;
use std::io::{BufRead as _, BufReader, Read as _};
use std::process::{Command, Stdio};
use std::sync::{Arc, Mutex};

/// Everything that a server wrote, by stream, and its exit code.
struct Said {
    out: String,
    err: String,
    code: Option<i32>,
}

/// Starts a server with a sample and a remark on its configuration, makes calls that succeed and that fail, and stops it.
async fn life(format: &str) -> Said {
    let mut child = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(words(&format!(
            "serve --sample --listen 0.0.0.0:0 --insecure-open --threads 2 --log-format {format}"
        )))
        .env_remove("PLIANT_CONFIG")
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let err = BufReader::new(child.stderr.take().expect("piped"));
    let heard = Arc::new(Mutex::new(String::new()));
    let hearing = Arc::clone(&heard);
    let reader = std::thread::spawn(move || {
        for line in err.lines() {
            let mut text = hearing.lock().expect("whole");
            *text += &line.expect("text");
            text.push('\n');
        }
    });
    let mut stdout = BufReader::new(child.stdout.take().expect("piped"));
    let mut out = String::new();
    stdout.read_line(&mut out).expect("a line");
    let start = out.find("http://").unwrap_or_else(|| panic!("{out}"));
    let url: String = (out[start..].chars())
        .take_while(|c| !c.is_whitespace() && *c != '"')
        .collect();
    let url = url.replace("0.0.0.0", "127.0.0.1");
    let get = async |path: &str| {
        let sent = http().get(format!("{url}{path}")).send();
        within(path, sent)
            .await
            .expect("an answer")
            .text()
            .await
            .expect("a body")
    };
    // The last of what is told at the start: what to try with the sample.
    eventually("the sample", async || {
        heard.lock().expect("whole").contains("creature.obj")
    })
    .await;
    get("/v1/sessions/nobody").await;
    get("/no%0Asuch%1B%5B31mplace%22").await;
    let asked = Command::new("kill").args(["-TERM", &child.id().to_string()]).status();
    assert!(asked.expect("kill runs").success());
    let rest = tokio::task::spawn_blocking(move || {
        stdout.read_to_string(&mut out).expect("text");
        (out, child.wait().expect("an end").code())
    });
    let (out, code) = within("the end", rest).await.expect("it ends");
    reader.join().expect("all is read");
    let err = heard.lock().expect("whole").clone();
    Said { out, err, code }
}

#[tokio::test(flavor = "multi_thread")]
async fn every_line_is_json_where_the_log_is() {
    let Said { out, err, code } = life("json").await;
    assert_eq!(code, Some(0), "{err}");
    assert_eq!(out.lines().count(), 1, "{out}");
    let mut messages = Vec::new();
    for line in out.lines().chain(err.lines()) {
        let parsed: Value = serde_json::from_str(line).unwrap_or_else(|e| panic!("{e}: {line}"));
        for field in ["timestamp", "level", "message", "target"] {
            assert!(parsed[field].is_string(), "{field} of {line}");
        }
        let time = text(&parsed["timestamp"]);
        assert!(time.len() == 27 && time.ends_with('Z'), "{line}");
        messages.push(text(&parsed["message"]));
    }
    let said = |words: &str| messages.iter().filter(|m| m.starts_with(words)).count();
    assert_eq!(said("listening on http://0.0.0.0:"), 1, "{messages:?}");
    assert_eq!(said("what clients send is not encrypted"), 1);
    assert_eq!(said("GET /v1/sessions/nobody"), 1, "each call has its line");
    assert_eq!(said("to try: curl"), 4, "what to try is told as lines too");
    assert_eq!(said("stopped"), 1);
}

#[tokio::test(flavor = "multi_thread")]
async fn every_line_of_the_text_log_has_its_time_level_and_place() {
    let Said { out, err, code } = life("text").await;
    assert_eq!(code, Some(0), "{err}");
    let url = out.trim_end().strip_prefix("listening on http://0.0.0.0:");
    assert!(
        out.lines().count() == 1 && url.is_some_and(|port| port.parse::<u16>().is_ok()),
        "{out}"
    );
    for line in err.lines() {
        let mut words = line.split_whitespace();
        let time = words.next().unwrap_or_default();
        let level = words.next().unwrap_or_default();
        let target = words.next().unwrap_or_default();
        let is_line = time.len() == 27
            && time.ends_with('Z')
            && ["ERROR", "WARN", "INFO", "DEBUG", "TRACE"].contains(&level)
            && target.starts_with("pliant")
            && target.ends_with(':');
        assert!(is_line, "{line:?} in\n{err}");
        assert!(!line.contains('\u{1b}'), "{line:?}");
    }
    assert!(err.contains("GET /v1/sessions/nobody"), "{err}");
}

#[test]
fn why_it_does_not_start_is_told_in_the_log_s_form() {
    let taken = std::net::TcpListener::bind("127.0.0.1:0").expect("a port");
    let address = taken.local_addr().expect("an address").to_string();
    let run = |format: &str| {
        let done = Command::new(env!("CARGO_BIN_EXE_pliant"))
            .args(["serve", "--listen", &address, "--log-format", format])
            .env_remove("PLIANT_CONFIG")
            .output()
            .expect("it runs");
        assert_eq!((done.status.code(), done.stdout.len()), (Some(2), 0));
        String::from_utf8(done.stderr).expect("text")
    };
    let last = |text: &str| text.lines().last().unwrap_or_default().to_owned();
    let json = run("json");
    for line in json.lines() {
        serde_json::from_str::<Value>(line).unwrap_or_else(|e| panic!("{e}: {line}"));
    }
    let told: Value = serde_json::from_str(&last(&json)).expect("JSON");
    assert!(
        told["level"] == "ERROR" && text(&told["message"]).contains("cannot listen on"),
        "{told}"
    );
    assert!(last(&run("text")).starts_with("pliant: cannot listen on"));
}
