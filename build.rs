//! Compiles `proto/` without protoc: messages for `wire`, services for `server`, and the descriptor set that
//! JSON, reflection and the API description are made from. Builds the viewer's page where node is there.

use prost::Message as _;
use std::{env, error::Error, fs, path::PathBuf};

#[path = "src/server/viewer/build.rs"]
mod viewer;

const SCHEMA: &str = "proto/pliant/v1/pliant.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed={SCHEMA}");
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

    let services = out.join("services");
    fs::create_dir_all(&services)?;
    tonic_prost_build::configure()
        .out_dir(services)
        .extern_path(".pliant.v1", "crate::wire::pb")
        .codec_path("crate::server::grpc::codec::MessageCodec")
        .compile_fds(descriptors)?;
    viewer::build(&out)
}
