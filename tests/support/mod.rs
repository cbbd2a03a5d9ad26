//! What the tests of this repository share. Each group of tests includes it and uses a part of it.
#![allow(dead_code, unused_imports, unused_macros)]

pub mod avatar;
pub mod bench;
pub mod book;
pub mod bucket;
pub mod certificates;
pub mod commands;
pub mod data;
pub mod draw;
pub mod fbx_text;
pub mod gltf_draft;
pub mod gltf_parsed;
pub mod gltf_sets;
pub mod haproxy;
pub mod khronos;
pub mod messages;
pub mod packed_models;
pub mod peak_memory;
pub mod place;
pub mod postgres;
pub mod process;
pub mod program;
pub mod recipes;
pub mod server;
pub mod shapes;
pub mod skinning;
