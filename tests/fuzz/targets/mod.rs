//! What is given arbitrary bytes, and what must hold whatever they are: nothing panics, nothing hangs, nothing is taken beyond its
//! limit, and what was accepted can be written and read again.
//!
//! The tests of this folder run every target on stored and mutated inputs; `coverage` runs the same functions under libFuzzer.
#![allow(dead_code)]

pub mod byte_draw;
pub mod decoders;
pub mod edits;
pub mod frames;
pub mod handles;
pub mod jobs;
pub mod messages;
pub mod models;
pub mod motion;
pub mod records;
pub mod reports;
pub mod soups;

/// A function that is given arbitrary bytes.
pub type FuzzTarget = fn(&[u8]);

/// Every target by its name, which is that of its folders of inputs.
pub const TARGETS: [(&str, FuzzTarget); 21] = [
    ("obj", models::obj),
    ("ply", models::ply),
    ("off", models::off),
    ("stl", models::stl),
    ("glb", models::glb),
    ("gltf", models::gltf),
    ("fbx", models::fbx),
    ("any_model", models::any_model),
    ("decoders", decoders::decoders),
    ("bvh", motion::bvh),
    ("rig", motion::rig),
    ("messages", messages::messages),
    ("json", messages::json),
    ("jobs", jobs::jobs),
    ("edits", edits::edits),
    ("handles", handles::handles),
    ("soups", soups::soups),
    ("commit_records", records::commits),
    ("model_records", records::models),
    ("reports", reports::reports),
    ("frames", frames::frames),
];
