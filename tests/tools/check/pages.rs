//! What `deploy/ci/` says is so: its example is a case, its tables are complete, its commands and workflows work.

use super::folder::{check, sample_suite};
use crate::support::data::copied;
use crate::support::process::{root, said};
use pliant::check::{Metric, Named as _, SuiteCase};
use std::fs;
use std::os::unix::fs::{PermissionsExt as _, symlink};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn read(name: &str) -> String {
    fs::read_to_string(root().join("deploy/ci").join(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// A folder with the repository's `deploy/` and a built program where the pages have it.
fn workplace() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    symlink(root().join("deploy"), folder.path().join("deploy")).expect("a link");
    fs::create_dir_all(folder.path().join("target/release")).expect("a folder");
    symlink(
        env!("CARGO_BIN_EXE_pliant"),
        folder.path().join("target/release/pliant"),
    )
    .expect("a link");
    folder
}

#[test]
fn the_page_lists_every_metric_and_its_example_is_a_case() {
    let page = read("README.md");
    let blocks: Vec<(&str, &str)> = (page.split("\n```").skip(1).step_by(2))
        .filter_map(|b| b.split_once('\n'))
        .collect();
    let example = blocks
        .iter()
        .find(|(language, _)| *language == "json")
        .expect("an example")
        .1;
    SuiteCase::from_file("example.case.json", example.as_bytes()).expect("the example is a case");
    for metric in Metric::all() {
        assert!(
            page.contains(&format!("`{}`", metric.name())),
            "{} is not in the table",
            metric.name()
        );
    }
    let help = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(["check", "--help"])
        .output()
        .expect("it runs");
    let help = String::from_utf8(help.stdout).expect("text");
    let options = help
        .split_whitespace()
        .filter(|w| w.starts_with("--") && *w != "--help" && *w != "--version");
    for option in options {
        let option = option.trim_end_matches([',', '.']);
        assert!(page.contains(option), "{option} is not on the page");
    }
    for word in page.split_whitespace().filter(|w| w.starts_with("`--")) {
        let option = word.trim_matches(|c: char| "`,;.:|".contains(c));
        assert!(help.contains(option), "{option} is not an option");
    }
}

#[test]
fn the_commands_of_the_page_work() {
    let page = read("README.md");
    let folder = workplace();
    let suite = folder.path().join("copy");
    copied(&root().join("deploy/ci/sample-suite"), &suite);
    let commands = page.lines().filter_map(|line| line.strip_prefix("pliant "));
    let mut ran = 0;
    for command in commands.filter(|c| !c.contains("--server")) {
        let command = command.replace("SUITE", "copy");
        let done = Command::new(env!("CARGO_BIN_EXE_pliant"))
            .args(command.split_whitespace())
            .current_dir(folder.path())
            .output()
            .expect("it runs");
        assert!(
            done.status.success(),
            "pliant {command}: {}",
            String::from_utf8_lossy(&done.stderr)
        );
        ran += 1;
    }
    assert!(ran >= 3);
    assert!(folder.path().join("report.html").exists() && folder.path().join("junit.xml").exists());
    assert_eq!(check(&suite, &[]).code, Some(0), "blessing again changes nothing");
}

/// The script that begins at the first line which ends with `start` below a line that ends with `below`: the rest of that line, or,
/// after a bar, the lines that are indented further.
fn script(text: &str, below: &str, start: &str) -> String {
    let mut lines = text
        .lines()
        .skip_while(|line| !line.trim_end().ends_with(below))
        .skip(1);
    let first = lines
        .find(|line| line.trim_start().starts_with(start))
        .unwrap_or_else(|| panic!("no {start} below {below}"));
    let rest = first.trim_start().strip_prefix(start).expect("found").trim();
    if rest != "|" {
        return rest.to_owned();
    }
    let depth = first.len() - first.trim_start().len();
    let block: Vec<&str> = lines
        .take_while(|line| line.trim().is_empty() || line.len() - line.trim_start().len() > depth)
        .collect();
    block.join("\n")
}

/// A checkout with the suite, and beside it the files of a release around this build's program.
struct Runner {
    folder: tempfile::TempDir,
    archive: String,
}

impl Runner {
    fn new() -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let version = env!("CARGO_PKG_VERSION");
        let name = format!("pliant-{version}-linux-{}", std::env::consts::ARCH);
        let at = |path: &str| folder.path().join(path);
        fs::create_dir_all(at("checkout")).expect("a folder");
        symlink(root().join("deploy"), at("checkout/deploy")).expect("a link");
        fs::create_dir_all(at(&format!("release/{name}"))).expect("a folder");
        let program = at(&format!("release/{name}/pliant"));
        // As small as it may be; the real one is packed by deploy/release.
        write_program(&program, &format!("exec {} \"$@\"", env!("CARGO_BIN_EXE_pliant")));
        let archive = format!("{name}.tar.xz");
        let packed = format!(
            "tar -cJf {archive} {name} && sha256sum {archive} > SHA256SUMS && echo \"$(printf 0%.0s $(seq 64))  other.tgz\" >> SHA256SUMS"
        );
        let done = Command::new("sh")
            .args(["-ec", &packed])
            .current_dir(at("release"))
            .output();
        assert!(done.expect("it runs").status.success());
        // What the forge's own program does for the workflow.
        fs::create_dir(at("bin")).expect("a folder");
        write_program(
            &at("bin/gh"),
            r#"[ "$1 $2 $3" = "release download v$PLIANT_VERSION" ] && [ "$5" = owner/name ] && [ -n "$GH_TOKEN" ]
while [ $# -gt 0 ]; do
    case "$1" in
        --pattern) wanted="${wanted:-} $2"; shift ;;
        --dir) mkdir -p "$2"; to=$2; shift ;;
    esac
    shift
done
for file in $wanted; do cp "$RELEASE/$file" "$to/"; done"#,
        );
        Self { folder, archive }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    fn play(&self, script: &str) -> Output {
        self.play_with(script, &[])
    }

    fn play_with(&self, script: &str, variables: &[(&str, &str)]) -> Output {
        let release = self.path("release");
        let bin = self.path("bin");
        let path = format!("{}:{}", bin.display(), std::env::var("PATH").unwrap_or_default());
        Command::new("bash")
            .args(["-eo", "pipefail", "-c", script])
            .current_dir(self.path("checkout"))
            .env("PATH", path)
            .env("RELEASE", &release)
            .env("PLIANT_RELEASE", format!("file://{}", release.display()))
            .envs([
                ("GH_TOKEN", "token"),
                ("PLIANT_REPOSITORY", "owner/name"),
                ("PLIANT_VERSION", env!("CARGO_PKG_VERSION")),
                ("SUITE", "deploy/ci/sample-suite"),
            ])
            .envs(variables.iter().copied())
            .output()
            .expect("bash runs")
    }

    fn reports(&self) -> usize {
        let reports = ["checkout/check/junit.xml", "checkout/check/report.html"];
        reports.iter().filter(|name| self.path(name).exists()).count()
    }

    /// Another file in place of the archive, as it would come over a bad line.
    fn spoil(&self) {
        fs::write(self.path("release").join(&self.archive), "not what was released").expect("written");
    }
}

fn write_program(path: &Path, script: &str) {
    fs::write(path, format!("#!/bin/sh\nset -eu\n{script}\n")).expect("written");
    fs::set_permissions(path, fs::Permissions::from_mode(0o755)).expect("its rights");
}

#[test]
fn the_github_workflow_checks_with_the_released_program() {
    let text = read("github-actions.yml");
    assert!(!text.contains("cargo"), "nothing is compiled");
    let (fetch, check) = (
        script(&text, "- name: Fetch", "run:"),
        script(&text, "- name: Check", "run:"),
    );
    let runner = Runner::new();
    let fetched = runner.play(&fetch);
    assert!(fetched.status.success(), "{}", said(&fetched));
    let checked = runner.play(&check);
    assert!(checked.status.success() && runner.reports() == 2, "{}", said(&checked));
    // A later run restores the folder that is cached, and fetches nothing.
    assert!(text.contains("path: .pliant") && text.contains("if: steps.cache.outputs.cache-hit != 'true'"));
    let spoiled = Runner::new();
    spoiled.spoil();
    assert!(
        !spoiled.play(&fetch).status.success(),
        "what is not the release is not run"
    );
    assert!(!spoiled.path("checkout/.pliant/pliant").exists());
}

#[test]
fn the_github_matrix_checks_in_shards_and_joins_them() {
    let text = read("github-shards.yml");
    assert!(!text.contains("cargo"), "nothing is compiled");
    let (shards, report) = text.split_once("\n  report:").expect("two jobs");
    let steps = [
        script(shards, "- name: Fetch", "run:"),
        script(shards, "- name: Check", "run:"),
        script(report, "- name: Merge", "run:"),
    ];
    assert_eq!(steps[0], script(report, "- name: Fetch", "run:"));
    assert!(
        shards.contains("INDEX: ${{ strategy.job-index }}") && shards.contains("SHARDS: ${{ strategy.job-total }}")
    );
    let of = shards.lines().find_map(|l| l.trim().strip_prefix("shard: ["));
    let of = of.expect("a matrix").split(',').count().to_string();
    let runner = Runner::new();
    assert!(runner.play(&steps[0]).status.success());
    let run = |index: &str| runner.play_with(&steps[1], &[("INDEX", index), ("SHARDS", &of)]);
    for index in ["0", "1", "2"] {
        let ran = run(index);
        assert!(ran.status.success(), "{}", said(&ran));
        // What comes with the other artifacts is in one folder.
        assert!(runner.path(&format!("checkout/shards/{index}.json")).exists());
    }
    let joined = runner.play(&steps[2]);
    assert!(joined.status.success() && runner.reports() == 2, "{}", said(&joined));
    assert!(
        said(&joined).contains("6 cases in process: 6 passed"),
        "{}",
        said(&joined)
    );
    // A shard that could not be run is named.
    fs::remove_file(runner.path("checkout/shards/1.json")).expect("removed");
    let lacking = runner.play(&steps[2]);
    assert_eq!(lacking.status.code(), Some(2));
    assert!(said(&lacking).contains("shard 2/3 is missing"), "{}", said(&lacking));
}

/// The arguments of a manifest's container.
fn arguments(manifest: &str) -> Vec<&str> {
    let lines = manifest.lines().skip_while(|line| line.trim() != "args:").skip(1);
    let items = lines.map_while(|line| line.trim_start().strip_prefix("- "));
    items.collect()
}

#[test]
fn the_jobs_of_kubernetes_check_in_shards_and_join_them() {
    let read = |name: &str| fs::read_to_string(root().join("deploy/kubernetes/check").join(name)).expect("a manifest");
    let (shards, merge) = (read("shards.yaml"), read("merge.yaml"));
    let number = |key: &str| -> usize {
        let line = shards.lines().find_map(|l| l.trim().strip_prefix(key)).expect(key);
        line.trim().parse().expect("a number")
    };
    let of = number("completions:");
    assert!(number("parallelism:") == of && shards.contains(&format!("- $(JOB_COMPLETION_INDEX)+1/{of}\n")));
    let volume = tempfile::tempdir().expect("a folder");
    let volume = volume.path().display().to_string();
    let sample = sample_suite().display().to_string();
    let play = |manifest: &str, index: usize, suite: &str| {
        let filled = arguments(manifest).into_iter().map(|argument| match argument {
            "/suite" => suite.to_owned(),
            _ => {
                let reply = argument.replace("$(JOB_COMPLETION_INDEX)", &index.to_string());
                reply.replace("/check/", &format!("{volume}/"))
            }
        });
        let ran = Command::new(env!("CARGO_BIN_EXE_pliant"))
            .args(filled)
            .env_remove("PLIANT_DATA")
            .output();
        ran.expect("it runs")
    };
    let early = play(&merge, 0, "");
    assert_eq!(
        early.status.code(),
        Some(2),
        "before the shards there is nothing: {}",
        said(&early)
    );
    // A pod that is run again replaces what it left.
    for index in (0..of).chain([1]) {
        let ran = play(&shards, index, &sample);
        assert!(ran.status.success(), "{}", said(&ran));
    }
    let joined = play(&merge, 0, "");
    assert!(joined.status.success(), "{}", said(&joined));
    let whole = check(&sample_suite(), &[]);
    assert_eq!(String::from_utf8_lossy(&joined.stderr), whole.err);
    for name in ["report.json", "junit.xml", "report.html"] {
        assert!(Path::new(&volume).join("merged").join(name).exists(), "{name}");
    }
    // What fails is for the second Job to say, with an exit code that its policy knows.
    let broken = tempfile::tempdir().expect("a folder");
    let copied = Command::new("cp")
        .arg("-r")
        .arg(sample_suite())
        .arg(broken.path())
        .status();
    assert!(copied.expect("cp runs").success());
    let suite = broken.path().join("sample-suite");
    let golden = suite.join("bend.golden.json");
    let text = fs::read_to_string(&golden).expect("a golden");
    fs::write(&golden, text.replacen("\"digest\": \"xxh3:", "\"digest\": \"xxh3:f", 1)).expect("written");
    for index in 0..of {
        let ran = play(&shards, index, &suite.display().to_string());
        assert!(ran.status.success(), "{}", said(&ran));
    }
    let failed = play(&merge, 0, "");
    assert_eq!(failed.status.code(), Some(1), "{}", said(&failed));
    assert!(merge.contains("values: [1, 2]") && said(&failed).contains("1 of 6 cases failed: bend"));
}

#[test]
fn the_gitlab_pipeline_checks_with_the_released_program() {
    let text = read("gitlab-ci.yml");
    assert!(!text.contains("cargo"), "nothing is compiled");
    let whole = script(&text, "  script:", "-");
    let runner = Runner::new();
    let first = runner.play(&whole);
    if said(&first).contains("curl: not found") || said(&first).contains("curl: command not found") {
        return eprintln!("SKIPPED: curl is not installed");
    }
    assert!(first.status.success() && runner.reports() == 2, "{}", said(&first));
    // With its cache it needs no release.
    runner.spoil();
    let second = runner.play(&whole);
    assert!(second.status.success(), "{}", said(&second));
    let spoiled = Runner::new();
    spoiled.spoil();
    assert!(!spoiled.play(&whole).status.success() && spoiled.reports() == 0);
}

#[test]
fn the_workflows_name_what_a_release_makes() {
    let release = fs::read_to_string(root().join("deploy/release")).expect("the script");
    assert!(release.contains(r#"archive(out, f"pliant-{version}-linux-{name}""#) && release.contains("{name}.tar.xz"));
    for name in ["github-actions.yml", "github-shards.yml", "gitlab-ci.yml"] {
        let text = read(name);
        assert!(
            text.contains(&format!("PLIANT_VERSION: {}\n", env!("CARGO_PKG_VERSION"))),
            "{name}"
        );
        assert!(
            text.contains(" --no-skip "),
            "{name}: what is not checked does not pass"
        );
        assert!(
            text.contains(r#"archive="pliant-$PLIANT_VERSION-linux-$(uname -m).tar.xz""#),
            "{name}"
        );
    }
    let text = read("github-release.yml");
    let make = script(&text, "- name: Make", "run:");
    assert!(make.ends_with("deploy/release -o target/release-files"), "{make}");
    let attach = script(&text, "- name: Attach", "run:");
    assert!(
        attach.contains("target/release-files/* --draft --verify-tag"),
        "nothing is published without a person: {attach}"
    );
    assert!(
        text.contains("restore-keys:"),
        "a run takes over what the one before compiled"
    );
}
