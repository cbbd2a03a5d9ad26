//! Builds the viewer's page for the binary: called by the package's build script.
//!
//! `PLIANT_VIEWER` says what is wanted: `auto` (the default: build it where node and its packages can be had, else leave it
//! out with a warning), `require` (fail when it cannot be built), `off`, or a folder that holds a built page. Writes
//! `viewer_files.rs`, the list of the page's files, which is empty without a page. Reaches for the network only when
//! packages are missing or their list changed.

use std::error::Error;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::{env, fs};

/// Where the page's sources are.
const SOURCES: &str = "viewer";

/// What the page is made from; a change rebuilds it.
const INPUTS: [&str; 9] = [
    "viewer/src",
    "viewer/public",
    "viewer/index.html",
    "viewer/package.json",
    "viewer/package-lock.json",
    "viewer/vite.config.ts",
    "viewer/tsconfig.json",
    "viewer/build.rs",
    "../../proto/clients/typescript/src",
];

/// The oldest node that the page's tools run on.
const NODE: (u32, u32) = (20, 19);

/// Makes the page, or does without, and writes the list of its files into `out`.
pub fn build(out: &Path) -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-env-changed=PLIANT_VIEWER");
    for input in INPUTS {
        println!("cargo:rerun-if-changed={input}");
    }
    let wanted = env::var("PLIANT_VIEWER").unwrap_or_default();
    let page = match wanted.as_str() {
        "off" => None,
        "require" => Some(make(out)?),
        "" | "auto" => match make(out) {
            Ok(page) => Some(page),
            Err(reason) => {
                println!("cargo:warning=the viewer is left out: {reason}; PLIANT_VIEWER=require tries again");
                None
            }
        },
        folder => Some(PathBuf::from(folder).canonicalize()?),
    };
    let mut files = Vec::new();
    if let Some(page) = &page {
        if !page.join("index.html").is_file() {
            return Err(format!("PLIANT_VIEWER: {} holds no index.html", page.display()).into());
        }
        collect(page, page, &mut files)?;
        files.sort();
    }
    fs::write(out.join("viewer_files.rs"), listing(page.as_deref(), &files)?)?;
    Ok(())
}

/// Builds the page from its sources.
fn make(out: &Path) -> Result<PathBuf, Box<dyn Error>> {
    let node = output(Command::new("node").arg("--version"))
        .map_err(|_| "node is not installed")?
        .trim()
        .to_owned();
    let mut numbers = node
        .trim_start_matches('v')
        .split('.')
        .map_while(|n| n.parse::<u32>().ok());
    let version = (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0));
    if version < NODE {
        return Err(format!("node {node} is older than {}.{}", NODE.0, NODE.1).into());
    }
    let sources = Path::new(SOURCES).canonicalize()?;
    install(&sources)?;
    let page = out.join("viewer");
    let vite = sources.join("node_modules/vite/bin/vite.js");
    output(
        Command::new("node")
            .arg(vite)
            .arg("build")
            .current_dir(&sources)
            .env("PLIANT_VIEWER_OUT", &page),
    )?;
    Ok(page)
}

/// Fetches the packages that the lock file names, unless they are there.
fn install(sources: &Path) -> Result<(), Box<dyn Error>> {
    let changed = |path: &Path| fs::metadata(path).and_then(|m| m.modified());
    let locked = changed(&sources.join("package-lock.json"))?;
    let installed = changed(&sources.join("node_modules/.package-lock.json"));
    if installed.is_ok_and(|installed| installed >= locked) {
        return Ok(());
    }
    let npm = if cfg!(windows) { "npm.cmd" } else { "npm" };
    let mut command = Command::new(npm);
    command
        .current_dir(sources)
        .args(["ci", "--no-audit", "--no-fund", "--prefer-offline"]);
    // Without a network this must end soon.
    command.args([
        "--fetch-retries=1",
        "--fetch-retry-mintimeout=1000",
        "--fetch-timeout=60000",
    ]);
    output(&mut command)?;
    Ok(())
}

/// What a command prints; fails with the end of its complaints.
fn output(command: &mut Command) -> Result<String, Box<dyn Error>> {
    let name = command.get_program().to_string_lossy().into_owned();
    let done = command.output().map_err(|error| format!("{name}: {error}"))?;
    if done.status.success() {
        return Ok(String::from_utf8_lossy(&done.stdout).into_owned());
    }
    let complaints = String::from_utf8_lossy(&done.stderr);
    let lines: Vec<&str> = complaints.lines().filter(|line| !line.trim().is_empty()).collect();
    let reported = lines[lines.len().saturating_sub(4)..].join(" / ");
    Err(format!("{name} ended with {}: {reported}", done.status).into())
}

/// Paths of the files below `folder`, relative to `page`.
fn collect(page: &Path, folder: &Path, files: &mut Vec<String>) -> Result<(), Box<dyn Error>> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.is_dir() {
            collect(page, &path, files)?;
        } else if path.extension().is_none_or(|e| e != "gz") {
            let name = path
                .strip_prefix(page)?
                .to_str()
                .ok_or("a file of the page has a name that is not UTF-8")?;
            files.push(name.replace('\\', "/"));
        }
    }
    Ok(())
}

/// The list as an expression of type `&[File]`.
fn listing(page: Option<&Path>, files: &[String]) -> Result<String, Box<dyn Error>> {
    let mut text = String::from("&[\n");
    for (name, page) in files.iter().zip(page.iter().cycle()) {
        let path = page.join(name);
        let packed = page.join(format!("{name}.gz"));
        let gzip = if packed.is_file() {
            format!("Some(include_bytes!({:?}))", packed.to_string_lossy())
        } else {
            "None".to_owned()
        };
        let tag = fingerprint(&fs::read(&path)?);
        writeln!(
            text,
            "    File {{ path: {name:?}, tag: \"{tag:016x}\", plain: include_bytes!({:?}), gzip: {gzip} }},",
            path.to_string_lossy(),
        )?;
    }
    text.push(']');
    Ok(text)
}

/// FNV-1a, 64 bits: distinguishes builds of a file.
fn fingerprint(bytes: &[u8]) -> u64 {
    bytes.iter().fold(0xcbf2_9ce4_8422_2325, |hash, byte| {
        (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3)
    })
}
