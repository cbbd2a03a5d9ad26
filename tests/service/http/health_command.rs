//! `pliant health`, which containers without a shell are watched by.

use crate::support::certificates::{Authority, Files};
use crate::support::program::ServedProgram;
use crate::support::server::*;
use std::process::Command;

/// Exit code and the last line that was written.
fn health(arguments: &[&str], variables: &[(&str, &str)]) -> (Option<i32>, String) {
    let done = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .arg("health")
        .args(arguments)
        .env_remove("PLIANT_CONFIG")
        .env_remove("PLIANT_LISTEN")
        .envs(variables.iter().copied())
        .output()
        .expect("it runs");
    let said = [done.stdout, done.stderr].concat();
    let said = String::from_utf8(said).expect("text");
    (done.status.code(), said.lines().last().unwrap_or_default().to_owned())
}

#[tokio::test(flavor = "multi_thread")]
async fn health_tells_whether_a_server_takes_sessions() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &["--drain-deadline", "60s"]);
    let url = server.url.clone();
    assert_eq!(health(&[&url], &[]), (Some(0), "ready".into()));
    assert_eq!(health(&[&url, "--live"], &[]), (Some(0), "ok".into()));
    // In a container the server listens on every address, as its environment or its file says.
    let port = url.rsplit(':').next().expect("a port").to_owned();
    let everywhere = [
        ("PLIANT_LISTEN", format!("0.0.0.0:{port}")),
        ("PLIANT_INSECURE_OPEN", "true".into()),
    ];
    let everywhere = everywhere.each_ref().map(|(key, value)| (*key, value.as_str()));
    assert_eq!(health(&[], &everywhere), (Some(0), "ready".into()));
    let config = folder.path().join("pliant.toml");
    std::fs::write(&config, format!("listen = \"127.0.0.1:{port}\"\n")).expect("written");
    assert_eq!(
        health(&["--config", config.to_str().expect("UTF-8")], &[]),
        (Some(0), "ready".into())
    );

    // A session that streams holds the stop up: the process lives, and takes nothing new.
    let id = server.open(bar_obj(8), "").await;
    let socket = format!("{}/v1/sessions/{id}/stream", url.replace("http", "ws"));
    let _stream = within("a socket", tokio_tungstenite::connect_async(socket))
        .await
        .expect("a socket");
    server.ask_to_stop();
    eventually("it leaves", async || {
        let (code, said) = health(&[&url], &[]);
        code == Some(1) && said.starts_with(&format!("pliant: {url} answers 503"))
    })
    .await;
    assert_eq!(health(&[&url, "--live"], &[]).0, Some(0));
    server.kill();
    let (code, said) = health(&[&url], &[]);
    assert!(code == Some(1) && said.contains("does not answer"), "{said}");
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_with_tls_is_known_by_its_own_certificate() {
    let folder = tempfile::tempdir().expect("a folder");
    let authority = Authority::new("an authority that this machine does not know");
    let files = Files::new(&authority.server(1));
    let given = |files: &Files, name: &str| files.path(name).to_str().expect("UTF-8").to_owned();
    let (certificate, key) = (given(&files, "server.pem"), given(&files, "server.key"));
    let arguments = ["--tls-certificate", &certificate, "--tls-key", &key];
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &arguments);
    let address = server.url.strip_prefix("https://").expect("TLS").to_owned();
    let own = |certificate: &str, key: &str| {
        let variables = [
            ("PLIANT_LISTEN", address.as_str()),
            ("PLIANT_TLS_CERTIFICATE", certificate),
            ("PLIANT_TLS_KEY", key),
        ];
        health(&[], &variables)
    };
    assert_eq!(own(&certificate, &key), (Some(0), "ready".into()));
    let another = Files::new(&authority.server(2));
    let (code, said) = own(&given(&another, "server.pem"), &given(&another, "server.key"));
    assert!(code == Some(1) && said.contains("does not answer"), "{said}");
    let (code, said) = health(&[&server.url], &[]);
    assert!(
        code == Some(1) && said.contains("certificate"),
        "named by a URL it has to be trusted: {said}"
    );
}

#[test]
fn what_is_no_server_s_address_is_refused() {
    for (arguments, words) in [
        (["127.0.0.1:7411"].as_slice(), "is not the URL of a server"),
        (&["ftp://host"], "is not the URL of a server"),
        (&["--config", "/nowhere.toml"], "/nowhere.toml"),
        (&["http://127.0.0.1:1", "--ca", "/nowhere.pem"], "/nowhere.pem"),
    ] {
        let (code, said) = health(arguments, &[]);
        assert!(code == Some(2) && said.contains(words), "{arguments:?}: {said}");
    }
}
