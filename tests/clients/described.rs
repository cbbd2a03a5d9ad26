//! Calls made from the server's own description: whatever they send, the server does not fail, and answers as it has described.

use crate::support::data::tell_skipped;
use crate::support::program::ServedProgram;
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The generator of calls (PyPI), which invents requests for every operation and method of a description.
const GENERATOR: &str = "schemathesis==4.32.5";

/// The program that invents calls; why it is not there otherwise.
fn generator() -> Result<PathBuf, String> {
    let home = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/schemathesis");
    let stamp = home.join("stamp");
    let program = home.join("bin/st");
    if fs::read_to_string(&stamp).is_ok_and(|had| had == GENERATOR) && program.exists() {
        return Ok(program);
    }
    let pip = home.join("bin/pip").to_string_lossy().into_owned();
    let steps: [(&str, &[&str]); 2] = [
        ("python3", &["-m", "venv", &home.to_string_lossy()]),
        (
            &pip,
            &["install", "--quiet", "--timeout", "15", "--retries", "1", GENERATOR],
        ),
    ];
    for (program, arguments) in steps {
        let done = Command::new(program).args(arguments).output();
        let done = done.map_err(|e| format!("{program}: {e}"))?;
        if !done.status.success() {
            return Err(String::from_utf8_lossy(&done.stderr).chars().take(300).collect());
        }
    }
    fs::write(stamp, GENERATOR).expect("target can be written");
    Ok(program)
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn whatever_is_sent_is_answered_as_described() {
    let generator = match generator() {
        Ok(program) => program,
        Err(why) => return tell_skipped("calls made from /openapi.json", &why),
    };
    let folder = tempfile::tempdir().expect("a folder");
    let server = ServedProgram::start(&folder.path().join("data"), &["--log", "warn"]);
    let id = server.open(String::new(), "?sample=creature").await;
    let handles = json!({"handles": [
        {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}}},
        {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
    ]});
    server
        .done("PUT", &format!("/v1/sessions/{id}/handles"), Some(&handles))
        .await;
    let settings = folder.path().join("schemathesis.toml");
    fs::write(&settings, format!("[parameters]\nid = \"{id}\"\nhandleId = \"head\"\n")).expect("writes");
    let mut command = Command::new(generator);
    command
        .arg("--config-file")
        .arg(&settings)
        .args([
            "run",
            &format!("{}/openapi.json", server.url),
            "--seed",
            "1",
            "--max-examples",
            "20",
        ])
        // The session stays, so that calls reach more than its absence.
        .args([
            "--exclude-method",
            "DELETE",
            "--phases",
            "coverage,fuzzing",
            "--request-timeout",
            "60",
        ])
        .args([
            "--checks",
            "not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance",
        ])
        .args(["--no-color", "--no-shrink"])
        .current_dir(folder.path());
    let done = tokio::task::spawn_blocking(move || command.output());
    let done = done.await.expect("a thread").expect("the generator runs");
    let told = String::from_utf8_lossy(&done.stdout);
    assert!(
        done.status.success(),
        "{told}\n{}",
        String::from_utf8_lossy(&done.stderr)
    );
    assert!(told.contains("generated"), "{told}");
    let after = server.done("GET", &format!("/v1/sessions/{id}"), None).await;
    assert_eq!(after["id"], id.as_str(), "the session is still there: {after}");
}
