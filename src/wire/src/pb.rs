//! The messages of `proto/pliant/v1/pliant.proto`, generated, and their descriptors.

#![allow(missing_docs, clippy::all)]

include!(concat!(env!("OUT_DIR"), "/pliant.v1.rs"));

/// The encoded descriptor set of the schema, with comments.
pub const DESCRIPTORS: &[u8] = include_bytes!(concat!(env!("OUT_DIR"), "/descriptors.bin"));
