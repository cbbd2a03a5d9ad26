//! Models from disk and back: the only place where the command line touches model files.

use super::failure::CliFailure;
use crate::asset::{FileSet, Format, WrittenFiles};
use percent_encoding::percent_decode_str;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write as _;
use std::path::{Component, Path, PathBuf};

/// Largest model file that the command line reads, bytes.
const LARGEST: u64 = 4 << 30;

/// Reads a model and, for glTF, the files beside it that it names. Nothing outside the model's folder is opened.
pub(super) fn read_model(path: &Path) -> Result<FileSet, CliFailure> {
    let main = read_file(path)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut set = FileSet::single(name, main);
    let is_gltf = Format::from_file(&set.name, &set.main) == Some(Format::GLTF);
    if is_gltf {
        let folder = path.parent().unwrap_or(Path::new(""));
        for uri in named_files(&set.main) {
            let decoded = percent_decode_str(&uri).decode_utf8_lossy().into_owned();
            let beside = folder.join(&decoded);
            // A missing companion is the reader's to report: it knows whether the file is needed.
            if stays_inside(&decoded) && beside.is_file() && inside_on_disk(folder, &beside) {
                set.companions.insert(decoded, read_file(&beside)?.into());
            }
        }
    }
    Ok(set)
}

/// Reads a whole file.
pub(super) fn read_file(path: &Path) -> Result<Vec<u8>, CliFailure> {
    let refuse = |e: std::io::Error| CliFailure::Input(format!("cannot read {}: {e}", path.display()));
    let facts = fs::metadata(path).map_err(refuse)?;
    if facts.is_dir() {
        return Err(CliFailure::Input(format!(
            "{} is a folder, a file is needed",
            path.display()
        )));
    }
    if facts.len() > LARGEST {
        let problem = format!(
            "{} has {} bytes, at most {LARGEST} are allowed",
            path.display(),
            facts.len()
        );
        return Err(CliFailure::Input(problem));
    }
    fs::read(path).map_err(refuse)
}

/// Lists the URIs of buffers and images that are not embedded. Broken JSON names none; the reader says what is wrong with it.
fn named_files(json: &[u8]) -> Vec<String> {
    let Ok(document) = serde_json::from_slice::<serde_json::Value>(json) else {
        return Vec::new();
    };
    ["buffers", "images"]
        .iter()
        .filter_map(|list| document.get(list)?.as_array())
        .flatten()
        .filter_map(|entry| entry.get("uri")?.as_str())
        .filter(|uri| !uri.starts_with("data:"))
        .map(str::to_owned)
        .collect()
}

/// Whether a URI is a relative path of plain names.
fn stays_inside(uri: &str) -> bool {
    !uri.contains(['\\', ':', '\0']) && Path::new(uri).components().all(|c| matches!(c, Component::Normal(_)))
}

/// Whether a file lies in a folder after symbolic links are followed.
fn inside_on_disk(folder: &Path, file: &Path) -> bool {
    let folder = if folder.as_os_str().is_empty() {
        Path::new(".")
    } else {
        folder
    };
    match (folder.canonicalize(), file.canonicalize()) {
        (Ok(folder), Ok(file)) => file.starts_with(folder),
        _ => false,
    }
}

/// Tells the format that an output path asks for.
pub(super) fn output_format(path: &Path) -> Result<Format, CliFailure> {
    Format::from_file_name(&path.to_string_lossy()).ok_or_else(|| {
        let problem = format!("its extension must be one of {}", Format::name_list("and"));
        CliFailure::Input(format!("cannot tell the format of {}: {problem}", path.display()))
    })
}

/// Writes a model and its companions beside it: all or nothing as far as a file system allows, each file by rename.
///
/// Refuses to replace a companion of the model that was read by different bytes.
pub(super) fn write_model(
    path: &Path,
    written: &WrittenFiles,
    model: &Path,
    read: &FileSet,
) -> Result<Vec<PathBuf>, CliFailure> {
    let folder = path
        .parent()
        .filter(|p| !p.as_os_str().is_empty())
        .unwrap_or(Path::new("."));
    let mut files = BTreeMap::new();
    for (uri, bytes) in &written.companions {
        if !stays_inside(uri) {
            return Err(CliFailure::Input(format!(
                "the model names \"{uri}\", which lies outside the output's folder"
            )));
        }
        let target = folder.join(uri);
        let own = model.parent().unwrap_or(Path::new("")).join(uri);
        let same_file = matches!((own.canonicalize(), target.canonicalize()), (Ok(a), Ok(b)) if a == b);
        if same_file {
            if read
                .companions
                .get(uri)
                .is_some_and(|before| before.as_ref() == bytes.as_slice())
            {
                continue;
            }
            let problem = format!("writing {} would overwrite the model's own {uri}", path.display());
            return Err(CliFailure::Input(format!(
                "{problem}; write into another folder, or as .glb"
            )));
        }
        files.insert(target, bytes.as_slice());
    }
    files.insert(path.to_owned(), written.main.as_slice());
    let mut temporary = Vec::new();
    for (target, bytes) in &files {
        match write_beside(target, bytes) {
            Ok(temp) => temporary.push((temp, target)),
            Err(e) => {
                temporary.iter().for_each(|(temp, _)| drop(fs::remove_file(temp)));
                return Err(CliFailure::Input(format!("cannot write {}: {e}", target.display())));
            }
        }
    }
    for (temp, target) in &temporary {
        fs::rename(temp, target).map_err(|e| CliFailure::Input(format!("cannot write {}: {e}", target.display())))?;
    }
    Ok(files.into_keys().collect())
}

/// Writes one file: whole or not at all as far as a file system allows.
pub(super) fn write_file(path: &Path, bytes: &[u8]) -> Result<(), CliFailure> {
    let refuse = |e: std::io::Error| CliFailure::Input(format!("cannot write {}: {e}", path.display()));
    let temp = write_beside(path, bytes).map_err(refuse)?;
    fs::rename(&temp, path).map_err(refuse)
}

fn write_beside(target: &Path, bytes: &[u8]) -> std::io::Result<PathBuf> {
    if let Some(folder) = target.parent().filter(|p| !p.as_os_str().is_empty()) {
        fs::create_dir_all(folder)?;
    }
    if target.is_dir() {
        return Err(std::io::Error::other("is a folder"));
    }
    let mut name = target.file_name().unwrap_or_default().to_os_string();
    name.push(format!(".{}.part", std::process::id()));
    let temp = target.with_file_name(name);
    let mut file = fs::File::create(&temp)?;
    let written = file.write_all(bytes).and_then(|()| file.sync_data());
    if written.is_err() {
        let _ = fs::remove_file(&temp);
    }
    written.map(|()| temp)
}
