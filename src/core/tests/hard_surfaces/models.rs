//! The models of the data folder that `PLIANT_DATA` names.

use glam::DVec3;
use pliant_core::asset::{FileSet, Format};
use pliant_core::deform::VolumeMode;
use pliant_core::engine::{Deformer, DeformerLimits, OpenOptions};
use pliant_core::exec::Exec;
use pliant_core::graph::EdgeWeights;
use std::io::Write as _;
use std::path::{Path, PathBuf};

/// Files of the folder; none, and a line that says what is skipped, without it.
pub fn data_models(what: &str) -> Vec<PathBuf> {
    let folder = std::env::var_os("PLIANT_DATA").map_or_else(
        || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let (mut found, mut open) = (Vec::new(), vec![folder.join("meshes"), folder.join("gltf")]);
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(folder).into_iter().flatten() {
            let path = entry.expect("a readable entry").path();
            if path.is_dir() {
                open.push(path);
            } else if Format::from_file_name(&path.to_string_lossy()).is_some() {
                found.push(path);
            }
        }
    }
    found.sort();
    if found.is_empty() {
        let reason = format!("{} holds no models; PLIANT_DATA names the folder", folder.display());
        let _ = writeln!(std::io::stderr(), "SKIPPED: {what}: {reason}");
    }
    found
}

/// Opens a model with its companions; `None` for one that is refused.
pub fn open_model(path: &Path, exec: &Exec<'_>) -> Option<Deformer> {
    let name = path.file_name()?.to_string_lossy();
    let mut files = FileSet::single(name, std::fs::read(path).ok()?);
    if path.extension().is_some_and(|e| e == "gltf") {
        for entry in std::fs::read_dir(path.parent()?)
            .ok()?
            .flatten()
            .filter(|e| e.path().is_file())
        {
            let bytes = std::fs::read(entry.path()).ok()?;
            files
                .companions
                .insert(entry.file_name().to_string_lossy().into_owned(), bytes.into());
        }
    }
    Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), exec).ok()
}

/// Opens a shape that is given by its vertices and triangles.
pub fn open_shape(positions: &[DVec3], triangles: &[[u32; 3]], exec: &Exec<'_>) -> Deformer {
    open_with(positions, triangles, &OpenOptions::default(), exec)
}

/// The same without interior nodes.
pub fn open_surface(positions: &[DVec3], triangles: &[[u32; 3]], weights: EdgeWeights, exec: &Exec<'_>) -> Deformer {
    let mut options = OpenOptions::default();
    options.body.volume = VolumeMode::Off;
    options.body.graph.weights = weights;
    open_with(positions, triangles, &options, exec)
}

fn open_with(positions: &[DVec3], triangles: &[[u32; 3]], options: &OpenOptions, exec: &Exec<'_>) -> Deformer {
    let mut text = String::new();
    positions
        .iter()
        .for_each(|p| text += &format!("v {} {} {}\n", p.x, p.y, p.z));
    triangles
        .iter()
        .for_each(|t| text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
    let files = FileSet::single("shape.obj", text);
    Deformer::open(files, options, &DeformerLimits::default(), exec).expect("a shape")
}
