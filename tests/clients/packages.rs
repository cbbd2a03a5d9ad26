//! What `deploy/release` makes, installed where nothing else of pliant is: from a wheel and a tarball to a deformed model.
//!
//! The program of this build stands in for the one that a release links; what this machine lacks (python3, node, a network for
//! packages) is said and skipped.

use crate::node::{is_offline, lacks_node, said, tell};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

/// Makes wheels and tarball; `None` where that cannot be done here.
fn release(out: &Path) -> Option<()> {
    let mut command = Command::new("python3");
    command
        .arg(root().join("deploy/release"))
        .args(["--dirty", "--only", "wheel,npm"]);
    command
        .args(["--program", env!("CARGO_BIN_EXE_pliant")])
        .arg("-o")
        .arg(out);
    let Ok(made) = command.output() else {
        tell("SKIPPED: python3 is not installed");
        return None;
    };
    let said = said(&made);
    let unreachable = [
        "No matching distribution",
        "Network is unreachable",
        "Temporary failure in name resolution",
        "ensurepip",
    ];
    if !made.status.success() && (is_offline(&said) || unreachable.iter().any(|sign| said.contains(sign))) {
        tell("SKIPPED: packages cannot be fetched");
        return None;
    }
    assert!(made.status.success(), "{said}");
    Some(())
}

fn only(folder: &Path, fits: impl Fn(&str) -> bool) -> PathBuf {
    let found: Vec<PathBuf> = fs::read_dir(folder)
        .expect("a folder")
        .flatten()
        .map(|f| f.path())
        .collect();
    let name = |file: &Path| file.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_owned();
    let mut fitting = found.iter().filter(|file| fits(&name(file)));
    let first = fitting.next().unwrap_or_else(|| panic!("{found:?}")).clone();
    assert_eq!(fitting.next(), None, "{found:?}");
    first
}

/// A command that finds nothing but what the system has.
fn bare(program: impl AsRef<std::ffi::OsStr>, folder: &Path) -> Command {
    let mut command = Command::new(program);
    command
        .current_dir(folder)
        .env_remove("PLIANT_BIN")
        .env("PATH", "/usr/local/bin:/usr/bin:/bin");
    command
}

fn done(output: std::io::Result<Output>, what: &str) -> String {
    let output = output.unwrap_or_else(|e| panic!("{what}: {e}"));
    let told = said(&output);
    assert!(output.status.success(), "{what}: {told}");
    told
}

const BEND: &str = r#"
import pliant
with pliant.connect() as client:
    open("creature.glb", "wb").write(client.sample())
with pliant.open("creature.glb") as s:
    s.handle("feet", half_space=((0, -1, 0), -0.14))
    s.handle("head", sphere=((0.76, 1.22, 0), 0.36))
    bent = s.solve({"head": {"rotation_vector": (0, 0.8, 0)}})
    s.export("turned.glb")
print(bent.shape, open("turned.glb", "rb").read(4))
"#;

const DRAG: &str = r#"
import { spawn } from "node:child_process";
import { Client } from "pliant-client";
const server = spawn(process.argv[2], ["serve", "--listen", "127.0.0.1:0", "--log", "warn"], { stdio: ["ignore", "pipe", "inherit"] });
const line = await new Promise((resolve) => server.stdout.once("data", (bytes) => resolve(String(bytes))));
const pliant = new Client({ url: line.trim().replace("listening on ", "") });
const session = await pliant.sample();
const before = await session.positions();
const model = await session.model("glb");
console.log(`opened ${before.length} ${model.size > 1000}`);
await session.close();
server.kill();
"#;

#[test]
fn packages_work_where_nothing_else_is() {
    let place = tempfile::tempdir().expect("a folder");
    let out = place.path().join("files");
    let _alone = crate::hold_typescript_package();
    if release(&out).is_none() {
        return;
    }
    let sums = fs::read_to_string(out.join("SHA256SUMS")).expect("sums");
    assert!(
        sums.lines().count() >= 5 && sums.contains("THIRD-PARTY-LICENCES.txt") && sums.contains(".cdx.json"),
        "{sums}"
    );
    let licences = fs::read_to_string(out.join("THIRD-PARTY-LICENCES.txt")).expect("licences");
    assert!(
        licences.contains("tokio 1.") && licences.contains("MIT License"),
        "{}",
        &licences[..400]
    );

    let home = place.path().join("python");
    done(Command::new("python3").args(["-m", "venv"]).arg(&home).output(), "venv");
    let wheel = only(&out, |name| name.ends_with(".whl") && !name.contains("none-any"));
    let pip = bare(home.join("bin/pip"), place.path())
        .args(["install", "-q", "--disable-pip-version-check"])
        .arg(&wheel)
        .output();
    done(pip, "pip");
    let told = done(
        bare(home.join("bin/python"), place.path()).args(["-c", BEND]).output(),
        "python",
    );
    assert!(told.contains("(8628, 3) b'glTF'"), "{told}");
    assert!(home.join("bin/pliant").is_file());

    if let Some(lack) = lacks_node() {
        tell(&format!("SKIPPED: {lack}"));
        return;
    }
    let page = place.path().join("node");
    fs::create_dir(&page).expect("a folder");
    fs::write(page.join("package.json"), r#"{"type": "module", "private": true}"#).expect("written");
    fs::write(page.join("drag.js"), DRAG).expect("written");
    let tarball = only(&out, |name| name.ends_with(".tgz"));
    let npm = Command::new("npm")
        .args(["install", "--no-audit", "--no-fund"])
        .arg(&tarball)
        .current_dir(&page)
        .output();
    done(npm, "npm");
    let node = Command::new("node")
        .arg("drag.js")
        .arg(home.join("bin/pliant"))
        .current_dir(&page)
        .output();
    let told = done(node, "node");
    assert!(told.contains("opened 25884 true"), "{told}");
}
