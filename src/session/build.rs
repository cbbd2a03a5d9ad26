//! Names the sources that decide about the bits of a result, for stored sessions.

use std::path::{Path, PathBuf};
use std::{env, error::Error, fs};

/// The crates whose code computes results, as folders next to this one.
const COMPUTING: [&str; 10] = [
    "asset",
    "core",
    "deform",
    "edit",
    "exec",
    "mesh",
    "motion",
    "reference",
    "render",
    "solver",
];

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rustc-env=COMPUTING_SOURCES={}", computing_sources()?);
    Ok(())
}

/// A digest of everything that decides about the bits of a result: the sources of what computes, what they depend on, and the compiler.
/// A stored session names it, so that a program knows whether its own results must be the same.
fn computing_sources() -> Result<String, Box<dyn Error>> {
    println!("cargo:rerun-if-changed=../../Cargo.lock");
    let mut files = vec![PathBuf::from("../../Cargo.lock")];
    let mut folders: Vec<PathBuf> = COMPUTING.iter().map(|c| Path::new("..").join(c)).collect();
    while let Some(folder) = folders.pop() {
        println!("cargo:rerun-if-changed={}", folder.display());
        for entry in fs::read_dir(&folder)? {
            let path = entry?.path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|e| e == "rs" || e == "toml") {
                files.push(path);
            }
        }
    }
    files.sort();
    // FNV-1a: the standard library's hasher may change between compilers.
    let mut digest = 0xcbf2_9ce4_8422_2325_u64;
    let mut take = |bytes: &[u8]| {
        for byte in bytes {
            digest = (digest ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01b3);
        }
    };
    for file in files {
        take(file.to_string_lossy().as_bytes());
        take(&fs::read(&file)?);
    }
    let compiler = env::var("RUSTC").unwrap_or_else(|_| "rustc".into());
    let version = std::process::Command::new(compiler).arg("--version").output()?;
    take(&version.stdout);
    Ok(format!("{digest:016x}"))
}
