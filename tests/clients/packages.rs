//! What `deploy/release` makes, installed where nothing else of pliant is: from a wheel and a tarball to a deformed model.
//!
//! The program of this build stands in for the one that a release links; what this machine lacks (python3, node, a network for
//! packages) is said and skipped.

use crate::node::lacks_node;
use crate::support::process::needed;
use crate::support::process::{is_npm_offline, root, said, show};
use crate::workflows::program_of_package;
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

fn is_unreachable(said: &str) -> bool {
    let signs = [
        "No matching distribution",
        "Network is unreachable",
        "Temporary failure in name resolution",
        "ensurepip",
    ];
    is_npm_offline(said) || signs.iter().any(|sign| said.contains(sign))
}

/// Makes the files of a release around a program; `None` where that cannot be done here.
fn release(program: &Path, out: &Path) -> Option<()> {
    let mut command = Command::new("python3");
    command.arg(root().join("deploy/release")).args([
        "--dirty",
        "--xz",
        "0",
        "--only",
        "wheel,npm,archive,comfyui,image,chart",
    ]);
    command.arg("--program").arg(program).arg("-o").arg(out);
    let Ok(made) = command.output() else {
        show("SKIPPED: python3 is not installed");
        return None;
    };
    let said = said(&made);
    if !made.status.success() && is_unreachable(&said) {
        show("SKIPPED: packages cannot be fetched");
        return None;
    }
    assert!(made.status.success(), "{said}");
    Some(())
}

#[test]
#[ignore = "takes minutes; .ci/run runs it"]
fn packages_work_where_nothing_else_is() {
    let place = tempfile::tempdir().expect("a folder");
    let out = place.path().join("files");
    let _alone = crate::hold_typescript_package();
    // What a debugger needs is two thirds of the program.
    let program = place.path().join("pliant");
    let stripped = Command::new("strip")
        .arg("-o")
        .arg(&program)
        .arg(env!("CARGO_BIN_EXE_pliant"))
        .status();
    if !stripped.is_ok_and(|status| status.success()) {
        fs::copy(env!("CARGO_BIN_EXE_pliant"), &program).expect("copied");
    }
    if release(&program, &out).is_none() {
        return;
    }
    let sums = fs::read_to_string(out.join("SHA256SUMS")).expect("sums");
    assert!(
        !sums.contains("musllinux") && !sums.contains("manylinux2014"),
        "the program needs the libraries of this machine: {sums}"
    );
    assert!(
        sums.lines().count() >= 5 && sums.contains("THIRD-PARTY-LICENCES.txt") && sums.contains(".cdx.json"),
        "{sums}"
    );
    checksums_and_provenance_name_every_file(&out, &sums);
    contents_fit_cyclonedx(&out);
    runs_on_a_bare_root(&out);
    let licences = fs::read_to_string(out.join("THIRD-PARTY-LICENCES.txt")).expect("licences");
    assert!(
        licences.contains("tokio 1.") && licences.contains("MIT License"),
        "{}",
        &licences[..400]
    );

    let first = Command::new(root().join("tests/clients/first-model.sh"))
        .arg(&out)
        .output();
    let first = first.expect("bash runs");
    let reply = said(&first);
    if !first.status.success() && is_unreachable(&reply) {
        return show("SKIPPED: packages cannot be fetched");
    }
    assert!(first.status.success(), "{reply}");
    assert!(reply.contains("pip: 8628 vertices, b'glTF'"), "{reply}");
    assert!(reply.contains("comfyui: 5 nodes, 8628 vertices"), "{reply}");
    match lacks_node() {
        Some(lack) => show(&format!("SKIPPED: {lack}")),
        None => assert!(reply.contains("npm: 8628 vertices, glTF"), "{reply}"),
    }
    for line in reply.lines().filter(|line| line.ends_with(" s")) {
        show(line);
    }
}

/// The one file of a release whose name ends so.
fn file_of(out: &Path, ending: &str) -> PathBuf {
    let mut files = fs::read_dir(out)
        .expect("files")
        .map(|entry| entry.expect("an entry").path());
    let found = files.find(|path| path.to_string_lossy().ends_with(ending));
    found.unwrap_or_else(|| panic!("there is no {ending}"))
}

fn checksums_and_provenance_name_every_file(out: &Path, sums: &str) {
    let done = Command::new("sha256sum")
        .args(["--check", "--strict", "--quiet", "SHA256SUMS"])
        .current_dir(out)
        .output();
    let done = done.expect("sha256sum runs");
    assert!(done.status.success(), "{}", said(&done));
    let statement: Value =
        serde_json::from_str(&fs::read_to_string(file_of(out, ".provenance.json")).expect("a file")).expect("JSON");
    let mut made: Vec<String> = statement["subject"]
        .as_array()
        .expect("files")
        .iter()
        .map(|file| format!("{}  {}", text(&file["digest"]["sha256"]), text(&file["name"])))
        .collect();
    made.extend(
        sums.lines()
            .filter(|line| line.ends_with(".provenance.json"))
            .map(str::to_owned),
    );
    made.sort();
    let mut summed: Vec<&str> = sums.lines().collect();
    summed.sort_unstable();
    assert_eq!(made, summed, "the statement is of the files that the checksums are of");
    let names = fs::read_dir(out).expect("files").count();
    assert_eq!(summed.len() + 1, names, "and each file has its checksum");
    let built = &statement["predicate"]["buildDefinition"];
    let commit = Command::new("git")
        .args(["rev-parse", "HEAD"])
        .current_dir(root())
        .output()
        .expect("git runs");
    assert_eq!(
        text(&built["resolvedDependencies"][0]["digest"]["gitCommit"]),
        said(&commit).trim()
    );
    assert_eq!(
        built["externalParameters"]["programGiven"], true,
        "this release is around a program that was there"
    );
}

fn text(value: &Value) -> &str {
    value.as_str().unwrap_or_else(|| panic!("{value} is no text"))
}

/// A reader of CycloneDX with its schemas (PyPI).
const CONTENTS: &str = "cyclonedx-python-lib[json-validation]==11.12.0";

const CHECK_CONTENTS: &str = "import sys; from cyclonedx.schema import SchemaVersion; from cyclonedx.validation.json import JsonStrictValidator; \
                              sys.exit(str(JsonStrictValidator(SchemaVersion.V1_6).validate_str(open(sys.argv[1]).read()) or '') or 0)";

fn contents_fit_cyclonedx(out: &Path) {
    let reader = needed!(program_of_package("bill-of-materials", &[CONTENTS], "python"));
    let check = |file: &Path| {
        Command::new(&reader)
            .args(["-c", CHECK_CONTENTS])
            .arg(file)
            .output()
            .expect("python runs")
    };
    let file = file_of(out, ".cdx.json");
    assert!(check(&file).status.success(), "{}", said(&check(&file)));
    let broken = out.with_file_name("broken.json");
    let contents = fs::read_to_string(file).expect("a file");
    assert!(contents.contains("pkg:cargo/tokio@1."), "the crates are named");
    fs::write(
        &broken,
        contents.replace("\"type\": \"library\"", "\"type\": \"libary\""),
    )
    .expect("written");
    assert!(!check(&broken).status.success(), "the check can fail");
}

fn runs_on_a_bare_root(out: &Path) {
    let done = Command::new(root().join("tests/clients/bare-root.sh"))
        .arg(out)
        .output()
        .expect("bash runs");
    let reply = said(&done);
    assert!(done.status.success(), "{reply}");
    if reply.contains("SKIPPED") {
        return show(reply.trim());
    }
    for line in [
        "deformed: glTF",
        "6 cases in process: 6 passed",
        "ready",
        "\"revision\":\"",
        "stopped",
    ] {
        assert!(reply.contains(line), "{line}: {reply}");
    }
}

/// What `deploy/release` would tag a wheel with.
fn tags_of(program: &Path) -> Option<String> {
    let script = "import sys; from importlib.machinery import SourceFileLoader; from pathlib import Path; sys.dont_write_bytecode = True; \
                  print(SourceFileLoader('release', sys.argv[1]).load_module().platform_tags(Path(sys.argv[2]), 'x86_64'))";
    let mut command = Command::new("python3");
    command
        .args(["-W", "ignore", "-c", script])
        .arg(root().join("deploy/release"))
        .arg(program);
    let Ok(done) = command.output() else {
        show("SKIPPED: python3 is not installed");
        return None;
    };
    assert!(done.status.success(), "{}", said(&done));
    Some(String::from_utf8_lossy(&done.stdout).trim().to_owned())
}

/// A program of headers alone, which is linked to libraries and asks for versions of their symbols.
fn program_that_needs(libraries: &[&str], versions: &[&str]) -> Vec<u8> {
    const HEADERS: u64 = 64 + 2 * 56;
    let mut names = vec![0];
    let mut name = |text: &str| {
        let at = names.len() as u64;
        names.extend(text.bytes().chain([0]));
        at
    };
    let mut dynamic: Vec<[u64; 2]> = libraries.iter().map(|library| [1, name(library)]).collect();
    let asked: Vec<u64> = versions.iter().map(|version| name(version)).collect();
    let entries = dynamic.len() as u64 + 4;
    let (needed, text) = (
        HEADERS + 16 * entries,
        HEADERS + 16 * entries + 16 * (1 + asked.len() as u64),
    );
    dynamic.extend([
        [5, text],
        [0x6fff_fffe, needed],
        [0x6fff_ffff, u64::from(!asked.is_empty())],
        [0, 0],
    ]);
    let end = text + names.len() as u64;
    let mut program = b"\x7fELF\x02\x01\x01".to_vec();
    program.resize(64, 0);
    program[32..40].copy_from_slice(&64_u64.to_le_bytes());
    program[54..58].copy_from_slice(&[56, 0, 2, 0]);
    for (kind, start, length) in [(1_u64, 0, end), (2, HEADERS, 16 * entries)] {
        for number in [kind, start, start, start, length, length, 0] {
            program.extend(number.to_le_bytes());
        }
    }
    program.extend(dynamic.iter().flatten().flat_map(|number| number.to_le_bytes()));
    program.extend([1_u16, asked.len() as u16].iter().flat_map(|n| n.to_le_bytes()));
    program.extend([0_u32, 16, 0].iter().flat_map(|n| n.to_le_bytes()));
    for (k, at) in asked.iter().enumerate() {
        program.extend([0_u32, 0].iter().flat_map(|n| n.to_le_bytes()));
        let next = if k + 1 == asked.len() { 0 } else { 16 };
        program.extend([*at as u32, next].iter().flat_map(|n| n.to_le_bytes()));
    }
    program.extend(names);
    program
}

#[test]
fn a_wheel_is_tagged_by_what_its_program_needs() {
    let place = tempfile::tempdir().expect("a folder");
    let tags = |libraries: &[&str], versions: &[&str]| {
        let program = place.path().join("program");
        fs::write(&program, program_that_needs(libraries, versions)).expect("written");
        tags_of(&program)
    };
    let own = needed!(tags_of(Path::new(env!("CARGO_BIN_EXE_pliant"))));
    assert!(own == "linux_x86_64" || own.starts_with("manylinux_2_"), "{own}");
    for (libraries, versions, wanted) in [
        (&[][..], &[][..], "manylinux2014_x86_64.musllinux_1_1_x86_64"),
        (&["libc.so.6"], &["GLIBC_2.2.5"], "manylinux_2_17_x86_64"),
        (
            &["libm.so.6", "libc.so.6", "ld-linux-x86-64.so.2"],
            &["GLIBC_2.9", "GLIBC_2.34"],
            "manylinux_2_34_x86_64",
        ),
        (&["libstdc++.so.6", "libc.so.6"], &["GLIBC_2.34"], "linux_x86_64"),
        (&["libc.musl-x86_64.so.1"], &[], "linux_x86_64"),
    ] {
        assert_eq!(tags(libraries, versions).as_deref(), Some(wanted), "{libraries:?}");
    }
}
