//! What README.md says is so: its scripts are the tested ones, its limits the program's, its files exist, its job runs.

use pliant::server::config::{KEYS, Settings};
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn read(name: &str) -> String {
    fs::read_to_string(root().join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// The code blocks of README.md as (language, text).
fn blocks(readme: &str) -> Vec<(&str, &str)> {
    readme
        .split("\n```")
        .skip(1)
        .step_by(2)
        .filter_map(|block| block.split_once('\n'))
        .collect()
}

/// The cells of the rows of the table whose head begins with `head`, without backticks.
fn table(readme: &str, head: &str) -> Vec<Vec<String>> {
    let row = |line: &str| {
        line.trim_matches('|')
            .split('|')
            .map(|c| c.trim().replace('`', ""))
            .collect::<Vec<_>>()
    };
    let found = readme.lines().skip_while(|line| !line.starts_with(head));
    found
        .skip(2)
        .take_while(|line| line.starts_with('|'))
        .map(row)
        .collect()
}

#[test]
fn two_commands_start_and_test() {
    let readme = read("README.md");
    let lines: Vec<&str> = blocks(&readme).into_iter().flat_map(|(_, text)| text.lines()).collect();
    let run = lines.iter().position(|l| *l == "cargo run --release -- serve --sample");
    let test: Vec<_> = lines.iter().filter(|l| l.starts_with("cargo test")).collect();
    assert!(
        run.is_some_and(|at| at < 4),
        "README opens with how to run it: `cargo run --release -- serve --sample`"
    );
    assert_eq!(
        test,
        [&"cargo test --workspace"],
        "README shows one test command, which .ci/run takes from it"
    );
}

#[test]
fn the_tour_is_the_tested_one() {
    let readme = read("README.md");
    let blocks = blocks(&readme);
    for (language, script) in [("bash", "tests/clients/tour.sh"), ("python", "tests/clients/tour.py")] {
        let shown: Vec<&str> = blocks
            .iter()
            .filter(|(l, _)| *l == language)
            .map(|(_, text)| *text)
            .collect();
        let wanted = read(script);
        assert_eq!(
            shown,
            [wanted.trim_end()],
            "README's {language} block is {script}: copy it again after a change"
        );
    }
}

#[test]
fn every_module_is_in_the_table() {
    let readme = read("README.md");
    let rows = table(&readme, "| floor | modules |");
    let listed: BTreeSet<String> = rows
        .iter()
        .flat_map(|row| row[1].split(", "))
        .map(|m| m.trim_end_matches('/').to_owned())
        .collect();
    let library = read("src/lib.rs");
    let modules: BTreeSet<String> = library
        .lines()
        .filter_map(|line| line.strip_prefix("pub mod ")?.strip_suffix(';'))
        .map(str::to_owned)
        .collect();
    assert_eq!(
        listed, modules,
        "the table of floors in README.md lists the modules of src/lib.rs, no more, no less"
    );
}

#[test]
fn every_file_it_names_exists() {
    let readme = read("README.md");
    let mut missing = Vec::new();
    for piece in readme.split('`').skip(1).step_by(2) {
        let is_place = ["src/", "tests/", "proto/", "deploy/", "loadtest/", ".ci/"]
            .iter()
            .any(|f| piece.starts_with(f));
        if is_place && !piece.contains(char::is_whitespace) && !root().join(piece).exists() {
            missing.push(piece);
        }
    }
    assert!(
        missing.is_empty(),
        "README.md names files that do not exist: {missing:?}"
    );
}

#[test]
fn the_limits_are_those_of_the_program() {
    let rows = table(&read("README.md"), "| key | default |");
    let told: BTreeSet<&str> = rows.iter().map(|row| row[0].as_str()).collect();
    assert_eq!(
        told,
        KEYS.into_iter().collect(),
        "README's table of keys lists every key of the configuration"
    );
    let mut flags = Vec::new();
    for row in &rows {
        // "none" stands for an empty list.
        let key = KEYS.into_iter().find(|key| *key == row[0]).expect("listed");
        if row[1] != "none" {
            flags.push((key, row[1].clone()));
        }
    }
    let told = Settings::load(None, &flags).expect("README's defaults are values that the program takes");
    let defaults = Settings::load(None, &[]).expect("the defaults");
    assert_eq!(told.listen, defaults.listen);
    assert_eq!(told.server, defaults.server);
    assert_eq!(told.session, defaults.session);
    assert_eq!(
        (told.log, told.log_format, told.sample),
        (defaults.log, defaults.log_format, defaults.sample)
    );
}

#[test]
fn the_job_runs() {
    let readme = read("README.md");
    let blocks = blocks(&readme);
    let jobs: Vec<&str> = blocks
        .iter()
        .filter(|(language, _)| *language == "json")
        .map(|(_, text)| *text)
        .collect();
    let [job] = jobs.as_slice() else {
        panic!("README shows one job, there are {}", jobs.len())
    };
    let folder = tempfile::tempdir().expect("a temporary folder");
    let at = |name: &str| folder.path().join(name);
    fs::write(at("creature.glb"), pliant::asset::sample::creature_glb()).expect("written");
    fs::write(at("job.json"), job).expect("written");
    // Commands that are run from the root of the repository find its suite, and write beside it.
    std::os::unix::fs::symlink(root().join("deploy"), at("deploy")).expect("a link");
    let commands = blocks.iter().flat_map(|(_, text)| text.lines());
    let commands: Vec<&str> = commands
        .filter_map(|line| line.strip_prefix("target/release/pliant "))
        .collect();
    assert!(commands.iter().any(|c| c.starts_with("deform ")) && commands.iter().any(|c| c.starts_with("inspect ")));
    for command in commands {
        let mut pliant = Command::new(env!("CARGO_BIN_EXE_pliant"));
        let done = pliant
            .args(command.split_whitespace())
            .current_dir(folder.path())
            .output()
            .expect("runs");
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(
            done.status.success(),
            "README's `pliant {command}` ended with {}:\n{said}",
            done.status
        );
        println!("{command}\n{}{said}", String::from_utf8_lossy(&done.stdout));
    }
    assert!(at("target/report.html").exists() && at("target/junit.xml").exists());
    assert!(
        at("turned.glb").metadata().is_ok_and(|m| m.len() > 1000),
        "the job writes turned.glb"
    );
}
