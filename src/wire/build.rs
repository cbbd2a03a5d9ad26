//! Compiles `proto/` without protoc: the messages, and the descriptor set that JSON, reflection and the API description are made from.

use prost::Message as _;
use std::{env, error::Error, fs, path::PathBuf};

const SCHEMA: &str = "../../proto/pliant/v1/pliant.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed={SCHEMA}");
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let mut compiler = protox::Compiler::new(["../../proto"])?;
    compiler
        .include_source_info(true)
        .include_imports(true)
        .open_file(SCHEMA)?;
    let mut descriptors = compiler.file_descriptor_set();
    fs::write(out.join("descriptors.bin"), descriptors.encode_to_vec())?;
    for file in &mut descriptors.file {
        file.service.clear();
    }
    prost_build::Config::new()
        .bytes(["."])
        .btree_map(["."])
        .enable_type_names()
        .compile_fds(descriptors)?;
    Ok(())
}
