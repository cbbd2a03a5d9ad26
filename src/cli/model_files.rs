//! Models from disk: the only place where the command line reads model files.

use super::failure::CliFailure;
use crate::asset::{FileSet, Format, missing_companions};
use crate::wire::Error as WireError;
use std::collections::BTreeSet;
use std::fs;
use std::io::Read as _;
use std::path::{Component, Path};

/// Largest model file that the command line reads, and most bytes of a model with all of its files.
const LARGEST: u64 = 4 << 30;

/// Most files that a model may name.
const MOST_COMPANIONS: usize = 10_000;

/// Reads a model and the files beside it that it names: buffers and images. Nothing outside the model's folder is opened.
pub(super) fn read_model(path: &Path) -> Result<FileSet, CliFailure> {
    let main = read_file(path)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut set = FileSet::single(name, main);
    let folder = path.parent().unwrap_or(Path::new(""));
    let mut asked = BTreeSet::new();
    let mut total = set.total_bytes();
    loop {
        let named: Vec<String> = missing_companions(&set)
            .into_iter()
            .filter(|name| !asked.contains(name))
            .collect();
        if named.is_empty() {
            return Ok(set);
        }
        if asked.len() + named.len() > MOST_COMPANIONS {
            let problem = format!("names more than {MOST_COMPANIONS} files");
            return Err(CliFailure::Input(format!("{} {problem}", path.display())));
        }
        for name in named {
            let beside = folder.join(&name);
            // A missing companion is the reader's to report: it knows whether the file is needed.
            if stays_inside(&name) && beside.is_file() && inside_on_disk(folder, &beside) {
                let bytes = read_file(&beside)?;
                total = total.saturating_add(bytes.len() as u64);
                if total > LARGEST {
                    let problem = format!("has more than {LARGEST} bytes with the files that it names");
                    return Err(CliFailure::Input(format!("{} {problem}", path.display())));
                }
                set.companions.insert(name.clone(), bytes.into());
            }
            asked.insert(name);
        }
    }
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
    // What is no regular file tells no size.
    let mut bytes = Vec::new();
    let file = fs::File::open(path).map_err(refuse)?;
    file.take(LARGEST + 1).read_to_end(&mut bytes).map_err(refuse)?;
    if bytes.len() as u64 > LARGEST {
        let problem = format!("{} has more than {LARGEST} bytes, which are allowed", path.display());
        return Err(CliFailure::Input(problem));
    }
    Ok(bytes)
}

/// Whether a URI is a relative path of plain names.
pub(super) fn stays_inside(uri: &str) -> bool {
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
    let format = Format::from_file_name(&path.to_string_lossy()).ok_or_else(|| {
        let problem = format!("its extension must be one of {}", Format::name_list("and"));
        CliFailure::Input(format!("cannot tell the format of {}: {problem}", path.display()))
    })?;
    match format.refusal_to_write() {
        Some(problem) => Err(CliFailure::Input(format!("cannot write {}: {problem}", path.display()))),
        None => Ok(format),
    }
}

/// A failure of what a file says, with its path.
pub(super) fn in_file(path: &Path, e: WireError) -> CliFailure {
    match CliFailure::from(e) {
        CliFailure::Input(text) => CliFailure::Input(format!("{}: {text}", path.display())),
        other => other,
    }
}
