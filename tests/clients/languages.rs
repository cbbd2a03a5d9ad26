//! The packages for C++ and C#: compiled from the one schema by the commands of their pages, and run against the real server. What is not
//! installed or cannot be fetched here is said and skipped.

use crate::pages::checkout::has;
use crate::python::{assert_bent, positions};
use crate::support::book;
use crate::support::process::{file_of_repository, root, said, show};
use crate::support::program::{ServedProgram, new_token};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Ends a build that lacks what it fetches.
const CANNOT_FETCH: i32 = 75;

/// The commands that a page leaves to this test.
fn commands(page: &str) -> Vec<String> {
    let blocks = book::blocks(&file_of_repository(page));
    let own = blocks
        .iter()
        .filter(|block| block.word("by") == Some("tests/clients/languages.rs"));
    own.flat_map(|block| block.text.lines()).map(str::to_owned).collect()
}

/// A package and how it is tried.
struct Package {
    page: &'static str,
    /// How the page's commands begin.
    first: &'static str,
    /// Programs without which it cannot be built.
    needed: &'static [&'static str],
    /// Runs what the example does not show, with an address, a model and a token behind it.
    checks: &'static str,
}

/// The last command of the page as a program and its words, after the others have built it; `None` where that cannot be done here.
fn built(package: &Package) -> Option<Vec<String>> {
    let page = package.page;
    for program in package.needed {
        if !has(program) {
            show(&format!("SKIPPED: {page}: {program} is not installed"));
            return None;
        }
    }
    let mut commands = commands(page);
    assert!(commands[0].starts_with(package.first), "{page}: {commands:?}");
    let run = commands.pop().expect("the page runs its example");
    for command in commands {
        let done = Command::new("bash").args(["-c", &command]).current_dir(root()).output();
        let done = done.expect("bash runs");
        let reply = said(&done);
        if done.status.code() == Some(CANNOT_FETCH) {
            show(&format!("SKIPPED: {page}: {}", reply.trim()));
            return None;
        }
        assert!(done.status.success(), "`{command}` of {page}: {reply}");
    }
    Some(run.split_whitespace().map(str::to_owned).collect())
}

/// The example with other words in place of the page's address, model and output.
fn example(run: &[String], words: [&str; 3], token: Option<&str>) -> Output {
    let mut command = Command::new(&run[0]);
    command
        .args(&run[1..run.len() - 3])
        .args(words)
        .current_dir(root())
        .env_remove("PLIANT_TOKEN");
    command
        .envs(token.map(|token| ("PLIANT_TOKEN", token)))
        .output()
        .expect("the example runs")
}

/// Runs the example as a user would, and wrongly, and then what it does not show.
fn works(package: &Package) {
    let Some(run) = built(package) else { return };
    let page = package.page;
    let folder = tempfile::tempdir().expect("a folder");
    let at = |name: &str| folder.path().join(name).to_str().expect("UTF-8").to_owned();
    let made = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(["sample", "creature", "-o", &at("creature.glb")])
        .output();
    assert!(made.expect("it runs").status.success());
    let (token, lines) = new_token();
    let token = token.as_str();
    fs::write(at("config.toml"), lines).expect("written");
    let server = ServedProgram::start_in_memory(at("log").into(), &["--config", &at("config.toml")]);

    let good = [server.url.as_str(), &at("creature.glb"), &at("bent.glb")];
    let done = example(&run, good, Some(token));
    let reply = said(&done);
    assert!(done.status.success(), "{page}: {reply}\n{}", server.log());
    for line in ["8628 vertices", "0 triangles flipped", "the cut: 17252 faces become "] {
        assert!(reply.contains(line), "{page}: {line}: {reply}");
    }
    assert_bent(&positions(Path::new(good[1])), &positions(Path::new(good[2])));

    for (words, token, reason) in [
        (good, None, "token"),
        (
            [good[0], &at("config.toml"), good[2]],
            Some(token),
            "allowed are glb, gltf, obj",
        ),
        (
            [server.url.trim_start_matches("http://"), good[1], good[2]],
            Some(token),
            "is not an address such as http://",
        ),
        (["http://127.0.0.1:1", good[1], good[2]], Some(token), "127.0.0.1:1"),
    ] {
        let done = example(&run, words, token);
        assert_eq!(done.status.code(), Some(1), "{page}: {words:?}: {}", said(&done));
        assert!(said(&done).contains(reason), "{page}: {reason}: {}", said(&done));
    }
    let checks = Command::new("bash")
        .args([
            "-c",
            &format!("{} \"$@\"", package.checks),
            "checks",
            good[0],
            good[1],
            token,
        ])
        .current_dir(root())
        .output()
        .expect("bash runs");
    let reply = said(&checks);
    assert!(checks.status.success(), "{page}: {reply}\n{}", server.log());
    assert!(
        reply.lines().filter(|line| line.starts_with("right: ")).count() >= 14,
        "{page}: {reply}"
    );
}

#[test]
fn the_cpp_package_is_built_from_the_schema_and_works() {
    works(&Package {
        page: "proto/clients/cpp/README.md",
        first: "cmake -S proto/clients/cpp",
        needed: &["cmake", "g++", "protoc", "grpc_cpp_plugin", "pkg-config"],
        checks: "g++ -std=c++17 -Wall -Wextra -Werror -I proto/clients/cpp/include -isystem target/cpp/generated tests/clients/cpp/checks.cpp \
                 target/cpp/libpliant_client.a $(pkg-config --cflags --libs grpc++ protobuf) -pthread -o target/cpp/checks && target/cpp/checks",
    });
}

#[test]
fn the_csharp_package_is_built_from_the_schema_and_works() {
    works(&Package {
        page: "proto/clients/csharp/README.md",
        first: "bash tests/clients/csharp/build target/csharp",
        needed: &["mcs", "mono", "protoc", "apt-get"],
        checks: "mono target/csharp/Checks.exe",
    });
}
