//! Files in and out: what survives a round trip, and what is refused.

mod avatars;
mod bones;
mod bound;
#[cfg(unix)]
mod decoded_apart;
mod decoded_memory;
mod draco;
mod fbx;
mod hostile_gltf;
mod materials;
mod morphs;
mod motion;
mod nodes;
mod nodes_of_files;
mod played;
mod polygons;
mod rigged;
mod rigs;
mod roundtrip_gltf;
mod roundtrip_text;
mod skin_weights;
mod skinned_merges;
mod skins;
#[path = "../support/mod.rs"]
mod support;
