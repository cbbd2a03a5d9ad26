//! Models from disk: the only place where the command line reads model files.

use super::failure::CliFailure;
use super::input_files::{AllowedFolders, LARGEST, NamedFiles, UnreadFile, folder_of, read_file};
use crate::asset::{FileSet, Format, missing_companions};
use crate::wire::Error as WireError;
use std::collections::BTreeSet;
use std::path::{Component, Path};

/// Most files that a model may name.
const MOST_COMPANIONS: usize = 10_000;

/// Reads a model and the files beside it that it names: buffers and images. Nothing outside the model's folder is opened.
pub(super) fn read_model(path: &Path) -> Result<FileSet, CliFailure> {
    let main = read_file(path)?;
    if main.trim_ascii_start().starts_with(b"HIERARCHY") {
        let place = path.display();
        let problem =
            format!("it is a BVH clip, not a model; `pliant animate MODEL --bvh {place}` plays it on a model");
        return Err(CliFailure::Input(format!("{place}: {problem}")));
    }
    with_companions(path, main)
}

/// Reads the files beside a model that it names.
pub(super) fn with_companions(path: &Path, main: Vec<u8>) -> Result<FileSet, CliFailure> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let mut set = FileSet::single(name, main);
    let beside = NamedFiles::new(folder_of(path), &AllowedFolders::default())?;
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
            if stays_inside(&name) {
                match beside.read_named(&name, LARGEST) {
                    Ok(bytes) => {
                        total = total.saturating_add(bytes.len() as u64);
                        set.companions.insert(name.clone(), bytes.into());
                    }
                    // A missing companion is the reader's to report: it knows whether the file is needed.
                    Err(UnreadFile::Absent { .. } | UnreadFile::Outside { .. } | UnreadFile::Folder(_)) => {}
                    Err(e) => return Err(CliFailure::from(e).in_place(path.display())),
                }
                if total > LARGEST {
                    let problem = format!("has more than {LARGEST} bytes with the files that it names");
                    return Err(CliFailure::Input(format!("{} {problem}", path.display())));
                }
            }
            asked.insert(name);
        }
    }
}

/// Whether a URI is a relative path of plain names.
pub(super) fn stays_inside(uri: &str) -> bool {
    !uri.contains(['\\', ':', '\0']) && Path::new(uri).components().all(|c| matches!(c, Component::Normal(_)))
}

/// Determines the format of an output path.
pub(super) fn output_format(path: &Path) -> Result<Format, CliFailure> {
    let format = Format::from_file_name(&path.to_string_lossy()).ok_or_else(|| {
        let problem = format!("its extension must be one of {}", Format::name_list("and"));
        CliFailure::Input(format!("cannot determine the format of {}: {problem}", path.display()))
    })?;
    match format.refusal_to_write() {
        Some(problem) => Err(CliFailure::Input(format!("cannot write {}: {problem}", path.display()))),
        None => Ok(format),
    }
}

/// A failure of what a file says, with its path.
pub(super) fn in_file(path: &Path, e: WireError) -> CliFailure {
    CliFailure::from(e).in_place(path.display())
}
