//! Finds the glTF files of the data folder, each with the companions that lie beside it.

use super::data::files_below;
use bytes::Bytes;
use pliant::asset::{FileSet, Format, Limits, Model};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Every .glb and .gltf below a folder, in order.
pub fn gltf_files(folder: &Path) -> Vec<PathBuf> {
    files_below(folder, |path| {
        path.extension().is_some_and(|e| e == "glb" || e == "gltf")
    })
}

/// Every model file in some folders of the data folder, in order; there are some.
pub fn models_below(data: &Path, folders: &[&str]) -> Vec<PathBuf> {
    let is_model = |path: &Path| Format::from_file_name(&path.to_string_lossy()).is_some();
    let found = folders
        .iter()
        .flat_map(|folder| files_below(&data.join(folder), is_model));
    let mut models: Vec<PathBuf> = found.collect();
    models.sort();
    assert!(!models.is_empty(), "no models under {}", data.display());
    models
}

/// The set that an upload of this file would be: for .gltf, with every file beside it that is not a model of its own.
pub fn file_set(path: &Path) -> FileSet {
    let name = path.file_name().expect("a file").to_string_lossy().into_owned();
    let mut set = FileSet::single(name, std::fs::read(path).expect("a readable file"));
    if path.extension().is_some_and(|e| e == "gltf") {
        let folder = path.parent().expect("a folder");
        let uris = companion_names(&set.main);
        for uri in uris {
            if let Ok(bytes) = std::fs::read(folder.join(&uri)) {
                set.companions.insert(uri, Bytes::from(bytes));
            }
        }
    }
    set
}

/// Reads the model of such a file; `None` for one that is refused.
pub fn read_model(path: &Path) -> Option<Model> {
    Model::read(file_set(path), None, &Limits::default()).ok()
}

/// The companions of a set, as `parse` of `gltf_parsed` takes them.
pub fn companions_of(files: &FileSet) -> BTreeMap<String, Vec<u8>> {
    let companions = files.companions.iter();
    companions.map(|(name, bytes)| (name.clone(), bytes.to_vec())).collect()
}

/// Relative names in a document's buffers and images; none when it is not a document.
fn companion_names(json: &[u8]) -> Vec<String> {
    let Ok(document) = serde_json::from_slice::<serde_json::Value>(json) else {
        return Vec::new();
    };
    let uris = ["buffers", "images"]
        .iter()
        .filter_map(|key| document[key].as_array())
        .flatten()
        .filter_map(|item| item["uri"].as_str())
        .filter(|uri| !uri.contains(':') && !uri.contains(".."));
    uris.map(|uri| {
        percent_encoding::percent_decode_str(uri)
            .decode_utf8_lossy()
            .into_owned()
    })
    .collect()
}
