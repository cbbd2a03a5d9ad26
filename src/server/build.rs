//! Compiles the services of `proto/` without protoc, and builds the viewer's page where node is there.

use std::{env, error::Error, fs, path::PathBuf};

#[path = "viewer/build.rs"]
mod viewer;

const SCHEMA: &str = "../../proto/pliant/v1/pliant.proto";

fn main() -> Result<(), Box<dyn Error>> {
    println!("cargo:rerun-if-changed={SCHEMA}");
    let out = PathBuf::from(env::var("OUT_DIR")?);
    let mut compiler = protox::Compiler::new(["../../proto"])?;
    compiler
        .include_source_info(true)
        .include_imports(true)
        .open_file(SCHEMA)?;
    let descriptors = compiler.file_descriptor_set();

    // The server writes the numbers of frames straight into the bytes that it sends; a client gets plain messages.
    let services = |name: &str| {
        let folder = out.join("services").join(name);
        fs::create_dir_all(&folder)?;
        let is_server = name == "server";
        let builder = tonic_prost_build::configure()
            .out_dir(folder)
            .build_server(is_server)
            .build_client(!is_server)
            .extern_path(".pliant.v1", "::pliant_wire::pb")
            .codec_path("crate::grpc::codec::MessageCodec");
        let builder = if is_server {
            builder.extern_path(".pliant.v1.DeformResponse", "::pliant_wire::frames::OutgoingResponse")
        } else {
            builder
        };
        builder.compile_fds(descriptors.clone())
    };
    services("server")?;
    services("client")?;
    viewer::build(&out)
}
