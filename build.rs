//! Compiles `proto/` without protoc: messages for `wire`, services for `server`, and the descriptor set that
//! JSON, reflection and the API description are made from. Builds the viewer's page where node is there.

use prost::Message as _;
use std::{env, error::Error, fs, path::PathBuf};

#[path = "src/server/viewer/build.rs"]
mod viewer;

const SCHEMA: &str = "proto/pliant/v1/pliant.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed={SCHEMA}");
    println!("cargo:rustc-env=COMPUTING_SOURCES={}", computing_sources()?);
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let mut compiler = protox::Compiler::new(["proto"])?;
    compiler
        .include_source_info(true)
        .include_imports(true)
        .open_file(SCHEMA)?;
    let descriptors = compiler.file_descriptor_set();
    fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;

    let mut messages = descriptors.clone();
    for file in &mut messages.file {
        file.service.clear();
    }
    prost_build::Config::new()
        .bytes(["."])
        .btree_map(["."])
        .enable_type_names()
        .compile_fds(messages)?;

    // The server writes the numbers of frames straight into the bytes that it sends; a client gets plain messages.
    let services = |name: &str| {
        let folder = out.join("services").join(name);
        fs::create_dir_all(&folder)?;
        let is_server = name == "server";
        let builder = tonic_prost_build::configure()
            .out_dir(folder)
            .build_server(is_server)
            .build_client(!is_server)
            .extern_path(".pliant.v1", "crate::wire::pb")
            .codec_path("crate::server::grpc::codec::MessageCodec");
        let builder = if is_server {
            builder.extern_path(".pliant.v1.DeformResponse", "crate::wire::frames::OutgoingResponse")
        } else {
            builder
        };
        builder.compile_fds(descriptors.clone())
    };
    services("server")?;
    services("client")?;
    viewer::build(&out)
}

/// A digest of everything that decides about the bits of a result: the sources of what computes, what they depend on, and the compiler.
/// A stored session names it, so that a program knows whether its own results must be the same.
fn computing_sources() -> Result<String, Box<dyn Error>> {
    println!("cargo:rerun-if-changed=Cargo.lock");
    let mut files = vec![PathBuf::from("Cargo.lock")];
    let mut folders = vec![PathBuf::from("src/core"), PathBuf::from("src/solver")];
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
