//! Files of models in every format.

use glam::DVec3;
use pliant::asset::{FileSet, Format, Limits, Model};
use std::collections::BTreeMap;

/// Small enough that no input takes long.
pub const LIMITS: Limits = Limits {
    vertices: 20_000,
    triangles: 40_000,
    decoded_bytes: 32 << 20,
    document_bytes: 32 << 20,
};

pub fn obj(bytes: &[u8]) {
    read_and_write(bytes, Some(Format::OBJ));
}

pub fn ply(bytes: &[u8]) {
    read_and_write(bytes, Some(Format::PLY));
}

pub fn off(bytes: &[u8]) {
    read_and_write(bytes, Some(Format::OFF));
}

pub fn stl(bytes: &[u8]) {
    read_and_write(bytes, Some(Format::STL));
}

pub fn glb(bytes: &[u8]) {
    read_and_write(bytes, Some(Format::GLB));
}

pub fn gltf(bytes: &[u8]) {
    read_and_write(bytes, Some(Format::GLTF));
}

pub fn fbx(bytes: &[u8]) {
    read_and_write(bytes, Some(Format::FBX));
}

/// The format is told by the bytes.
pub fn any_model(bytes: &[u8]) {
    read_and_write(bytes, None);
}

/// The companions that files may name: some bytes, and a material library.
pub fn companions() -> BTreeMap<String, bytes::Bytes> {
    let pattern: Vec<u8> = (0..2048u32).map(|i| (i * 37 % 251) as u8).collect();
    let library = "newmtl a\nKd 1 0 0\nmap_Kd b.png\nnewmtl b\nKd nan 1 2\n";
    BTreeMap::from([
        ("b.bin".to_owned(), pattern.into()),
        ("m.mtl".to_owned(), library.into()),
        ("b.png".to_owned(), vec![0x89, b'P', b'N', b'G', 1, 2, 3].into()),
    ])
}

fn read_and_write(bytes: &[u8], format: Option<Format>) {
    let files = FileSet {
        name: "model".into(),
        main: bytes.to_vec().into(),
        companions: companions(),
    };
    let model = match Model::read(files, format, &LIMITS) {
        Ok(model) => model,
        Err(refused) => return assert!(!refused.to_string().is_empty()),
    };
    assert!(model.positions.len() as u64 <= LIMITS.vertices && model.triangles.len() as u64 <= LIMITS.triangles);
    assert!(
        model.positions.iter().all(|p| p.is_finite()),
        "a position that is not a number"
    );
    let vertices = model.positions.len();
    assert!(
        model.triangles.iter().flatten().all(|&v| (v as usize) < vertices),
        "a vertex that is not there"
    );
    if vertices > 2000 {
        return;
    }
    let moved: Vec<DVec3> = model
        .positions
        .iter()
        .map(|&p| p * 1.0625 + DVec3::new(0.5, 0.0, -0.25))
        .collect();
    // A file as it came, moved in place; and, of some inputs, files that are made anew, which takes longer.
    let anew = [Format::GLB, Format::OBJ, Format::PLY];
    let formats = [model.format]
        .into_iter()
        .chain(anew.into_iter().filter(|_| bytes.len().is_multiple_of(16)));
    for written_as in formats {
        let Ok(written) = model.write(&moved, written_as) else {
            continue;
        };
        let again = FileSet {
            name: "again".into(),
            main: written.main.into(),
            companions: written
                .companions
                .into_iter()
                .map(|(name, bytes)| (name, bytes.into()))
                .collect(),
        };
        let again = FileSet {
            companions: companions().into_iter().chain(again.companions).collect(),
            ..again
        };
        let again = Model::read(
            again,
            Some(written_as),
            &Limits {
                decoded_bytes: u64::MAX,
                document_bytes: u64::MAX,
                ..LIMITS
            },
        );
        if let Err(refused) = again {
            panic!(
                "{} that was written as {} cannot be read again: {refused}",
                model.format.name(),
                written_as.name()
            );
        }
    }
}
