//! What a server refuses to be started as, and how a token is made.

use crate::support::certificates::{Authority, Files};
use crate::support::server::AnsweredCall as _;
use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};

fn program(folder: &Path, arguments: &[&str]) -> Command {
    let mut program = Command::new(env!("CARGO_BIN_EXE_pliant"));
    for (name, _) in std::env::vars().filter(|(name, _)| name.starts_with("PLIANT_")) {
        program.env_remove(name);
    }
    program.args(arguments).current_dir(folder);
    program
}

/// Exit code, stdout and the last line of stderr.
fn done(folder: &Path, arguments: &[&str]) -> (Option<i32>, String, String) {
    let done = program(folder, arguments).output().expect("it runs");
    let err = String::from_utf8_lossy(&done.stderr).into_owned();
    let last = err.trim_end().lines().last().unwrap_or_default().to_owned();
    (
        done.status.code(),
        String::from_utf8_lossy(&done.stdout).into_owned(),
        last,
    )
}

/// A server that was started as a program; ended with this value.
struct Started(Child);

impl Started {
    /// Its port, from the one line that it prints.
    fn new(folder: &Path, arguments: &[&str]) -> (Self, u16) {
        let mut child = program(folder, arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("it starts");
        let mut line = String::new();
        let out = child.stdout.take().expect("stdout");
        BufReader::new(out).read_line(&mut line).expect("a line");
        let started = Self(child);
        let port = line.trim().rsplit(':').next().and_then(|port| port.parse().ok());
        (started, port.unwrap_or_else(|| panic!("{line:?} names no port")))
    }
}

impl Drop for Started {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn status(port: u16, token: Option<&str>) -> u16 {
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .expect("a runtime");
    runtime.block_on(async {
        let mut request = crate::support::server::http().get(format!("http://127.0.0.1:{port}/v1/limits"));
        if let Some(token) = token {
            request = request.bearer_auth(token);
        }
        request.answer().await.status().as_u16()
    })
}

#[test]
fn an_address_that_others_reach_needs_to_know_who_calls() {
    let folder = tempfile::tempdir().expect("a folder");
    for listen in ["0.0.0.0:0", "[::]:0", "192.0.2.7:0"] {
        let (code, out, last) = done(folder.path(), &["serve", "--listen", listen]);
        assert_eq!((code, out.as_str()), (Some(2), ""), "{listen}: {last}");
        for way in [
            "[[auth.tokens]]",
            "[auth.jwt]",
            "tls_client_ca",
            "--insecure-open",
            "flag --listen",
        ] {
            assert!(last.contains(way), "{listen}: {last} lacks {way}");
        }
    }
    let (_open, port) = Started::new(folder.path(), &["serve", "--listen", "0.0.0.0:0", "--insecure-open"]);
    assert_eq!(status(port, None), 200);
}

#[test]
fn a_token_that_the_program_makes_is_known_by_its_lines() {
    let folder = tempfile::tempdir().expect("a folder");
    let made = |arguments: &[&str]| {
        let (code, out, last) = done(folder.path(), arguments);
        assert_eq!(code, Some(0), "{last}");
        let (token, lines) = out
            .split_once("\n\n")
            .expect("a token, an empty line and what to configure");
        (token.to_owned(), lines.to_owned())
    };
    let (token, lines) = made(&["token", "st\"udio", "--name", "anna", "--expires", "2999-01-31"]);
    assert!(
        !lines.contains(&token) && lines.contains("expires = \"2999-01-31T00:00:00Z\""),
        "{lines}"
    );
    let (other, more) = made(&["token", "other", "--metrics"]);
    assert_ne!(token, other);
    std::fs::write(folder.path().join("pliant.toml"), lines + &more).expect("written");
    let arguments = ["serve", "--listen", "0.0.0.0:0", "--config", "pliant.toml"];
    let (_started, port) = Started::new(folder.path(), &arguments);
    assert_eq!(status(port, Some(&token)), 200);
    assert_eq!(status(port, Some(&other)), 200);
    assert_eq!(status(port, Some("pliant_")), 401);
    assert_eq!(status(port, None), 401);

    let (code, out, last) = done(folder.path(), &["token", "a", "--expires", "2020-01-01"]);
    assert_eq!((code, &*out), (Some(2), ""), "{last}");
    assert!(last.contains("--expires") && last.contains("has passed"), "{last}");
    let (code, _, last) = done(folder.path(), &["token", "a", "--expires", "tomorrow"]);
    assert!(code == Some(2) && last.contains("2027-01-31T12:00:00Z"), "{last}");
}

#[test]
fn what_is_wrong_with_the_files_is_told_before_anything_is_served() {
    let folder = tempfile::tempdir().expect("a folder");
    let authority = Authority::new("ours");
    let (one, other) = (authority.server(1), authority.server(2));
    let files = Files::new(&one);
    let path = |name: &str| files.path(name).display().to_string();
    std::fs::write(files.path("other.key"), &other.key).expect("written");
    let (certificate, key, other) = (path("server.pem"), path("server.key"), path("other.key"));
    let cases: [(&[&str], &[&str]); 6] = [
        (&["--tls-certificate", &certificate], &["tls_key"]),
        (&["--tls-key", &key], &["tls_certificate"]),
        (&["--tls-client-ca", &certificate], &["tls_client_ca", "tls_key"]),
        (
            &["--tls-certificate", &certificate, "--tls-key", &other],
            &["server.pem", "other.key"],
        ),
        (
            &["--tls-certificate", &key, "--tls-key", &key],
            &["server.key", "no certificate"],
        ),
        (
            &["--tls-certificate", "none.pem", "--tls-key", &key],
            &["none.pem", "No such file"],
        ),
    ];
    for (flags, words) in cases {
        let arguments: Vec<&str> = ["serve", "--listen", "127.0.0.1:0"]
            .into_iter()
            .chain(flags.iter().copied())
            .collect();
        let (code, _, last) = done(folder.path(), &arguments);
        assert_eq!(code, Some(2), "{flags:?}: {last}");
        for word in words {
            assert!(last.contains(word), "{flags:?}: {last} lacks {word}");
        }
    }
    let secret = "pliant_something-secret";
    for (lines, words) in [
        (
            format!("tenant = \"a\"\nsha256 = \"{secret}\""),
            &["auth.tokens[0].sha256", "64 hexadecimal"][..],
        ),
        (
            "tenant = \"\"\nsha256 = \"00\"".into(),
            &["auth.tokens[0].tenant", "1 to 256"],
        ),
        ("tenant = \"a\"".into(), &["sha256", "missing"]),
        (
            "tenant = \"a\"\nsha256 = \"00\"\nexpire = \"x\"".into(),
            &["expire", "expires", "no such key"],
        ),
    ] {
        std::fs::write(folder.path().join("bad.toml"), format!("[[auth.tokens]]\n{lines}\n")).expect("written");
        let (code, _, last) = done(
            folder.path(),
            &["serve", "--listen", "127.0.0.1:0", "--config", "bad.toml"],
        );
        assert_eq!(code, Some(2), "{lines}: {last}");
        assert!(last.contains("bad.toml") && !last.contains(secret), "{last}");
        for word in words {
            assert!(last.contains(word), "{lines}: {last} lacks {word}");
        }
    }
}
