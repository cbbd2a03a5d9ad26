//! Files that a command writes: nothing is replaced without `--force`, no folder is made without `--parents`.
//!
//! Every obstacle is reported before anything is written, and where possible before any work. Files are written beside
//! their places and renamed, so a stopped command leaves no partial file.

use super::input_files::{folder_of, read_regular_file, stays_inside};
use super::terminal::CliFailure;
use crate::asset::{FileSet, WrittenFiles};
use clap::Args;
use std::collections::BTreeMap;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use tempfile::TempPath;

/// Random letters in the name of a temporary file.
const RANDOM_LETTERS: usize = 12;

/// What a command may do to the folder that it writes into.
#[derive(Debug, Clone, Copy, Default, Args)]
pub(super) struct OutputPermission {
    /// Replace existing files
    #[arg(long)]
    pub force: bool,
    /// Create missing folders
    #[arg(long)]
    pub parents: bool,
}

impl OutputPermission {
    /// Says why a file may not be written at a path; changes nothing.
    pub(super) fn check_target(self, path: &Path) -> Result<(), CliFailure> {
        let refuse = |problem: &str| Err(CliFailure::unwritable(path, problem));
        if path.file_name().is_none() {
            return refuse("that names no file");
        }
        match fs::metadata(path) {
            Ok(facts) if facts.is_dir() => return refuse("it is a folder"),
            Ok(facts) if !facts.is_file() => return refuse("it is not a regular file"),
            Ok(_) if !self.force => return refuse("it exists; --force replaces it"),
            _ => {}
        }
        let folder = folder_of(path);
        match fs::metadata(folder) {
            Ok(facts) if !facts.is_dir() => refuse(&format!("{} is not a folder", folder.display())),
            Err(_) if !self.parents => refuse(&format!(
                "the folder {} does not exist; --parents makes it",
                folder.display()
            )),
            _ => Ok(()),
        }
    }

    /// The same, for goldens: to replace them is what was asked for.
    pub(super) fn for_goldens(self) -> Self {
        Self { force: true, ..self }
    }

    /// Says why a file cannot be written at a path, which is tried with one beside it that goes away again.
    pub(super) fn try_target(self, path: &Path) -> Result<(), CliFailure> {
        self.check_target(path)?;
        let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        // Of folders that are to be made, the one that is there takes the first of them.
        let there = target.ancestors().skip(1).find(|folder| folder.is_dir());
        let beside = there
            .unwrap_or(Path::new("."))
            .join(target.file_name().unwrap_or_default());
        let tried = fill_beside(&beside, &mut |_| Ok(()));
        tried.map(drop).map_err(|e| CliFailure::unwritable(path, e))
    }

    /// Writes one file.
    pub(super) fn write_file(self, path: &Path, bytes: &[u8]) -> Result<(), CliFailure> {
        self.write_all(&BTreeMap::from([(path.to_owned(), bytes)]))
    }

    /// Writes one file bit by bit.
    pub(super) fn write_streamed(
        self,
        path: &Path,
        fill: &mut dyn FnMut(&mut dyn Write) -> std::io::Result<()>,
    ) -> Result<(), CliFailure> {
        self.check_target(path)?;
        self.make_folder_of(path)?;
        let target = path.canonicalize().unwrap_or_else(|_| path.to_owned());
        let temp = fill_beside(&target, fill).map_err(|e| CliFailure::unwritable(path, e))?;
        self.check_target(path)?;
        temp.persist(&target)
            .map_err(|e| CliFailure::unwritable(&target, e.error))?;
        Ok(())
    }

    /// Makes the folder that a file is to lie in, where that is allowed.
    pub(super) fn make_folder_of(self, path: &Path) -> Result<(), CliFailure> {
        if !self.parents {
            return Ok(());
        }
        fs::create_dir_all(folder_of(path)).map_err(|e| CliFailure::unwritable(path, e))
    }

    /// Writes a model and its companions beside it. A companion that lies there already, byte for byte, is left alone.
    ///
    /// A companion of the model that was read is never replaced by other bytes, with `--force` neither: the model would
    /// no longer be what it was. Only a model that is written over itself takes its companions along.
    pub(super) fn write_model(
        self,
        path: &Path,
        written: &WrittenFiles,
        model: &Path,
        read: &FileSet,
    ) -> Result<Vec<PathBuf>, CliFailure> {
        let over_itself = is_same_file(path, model);
        spare_companions(path, model, read)?;
        let mut files = BTreeMap::new();
        for (uri, bytes) in &written.companions {
            if !stays_inside(uri) {
                return Err(CliFailure::Input(format!(
                    "the model names \"{uri}\", which lies outside the output's folder"
                )));
            }
            let target = folder_of(path).join(uri);
            // What lies beside the model under that name is the model's only if the model was read with it.
            let before = read.companions.get(uri);
            let before = before.filter(|_| is_same_file(&folder_of(model).join(uri), &target));
            let own = before.is_some();
            let stays = match before {
                Some(before) => before.as_ref() == bytes.as_slice(),
                None => holds_bytes(&target, bytes),
            };
            if stays {
                continue;
            }
            if own && !over_itself {
                let problem = format!("writing {} would overwrite the model's own {uri}", path.display());
                return Err(CliFailure::Input(format!(
                    "{problem}; write into another folder, or as .glb"
                )));
            }
            files.insert(target, bytes.as_slice());
        }
        files.insert(path.to_owned(), written.main.as_slice());
        files.keys().try_for_each(|path| self.check_target(path))?;
        self.make_folder_of(path)?;
        if folder_of(path).is_dir() {
            // Folders that the model's files lie in belong to the model.
            let made =
                |target: &PathBuf| fs::create_dir_all(folder_of(target)).map_err(|e| CliFailure::unwritable(target, e));
            files.keys().try_for_each(made)?;
        }
        self.write_all(&files)?;
        Ok(files.into_keys().collect())
    }

    /// Writes files: all or nothing as far as a file system allows.
    fn write_all(self, files: &BTreeMap<PathBuf, &[u8]>) -> Result<(), CliFailure> {
        files.keys().try_for_each(|path| self.check_target(path))?;
        files.keys().try_for_each(|path| self.make_folder_of(path))?;
        let mut temporary: Vec<(TempPath, PathBuf)> = Vec::new();
        for (path, bytes) in files {
            // A link stays a link: what it points to is replaced.
            let target = path.canonicalize().unwrap_or_else(|_| path.clone());
            let temp =
                fill_beside(&target, &mut |file| file.write_all(bytes)).map_err(|e| CliFailure::unwritable(path, e))?;
            temporary.push((temp, target));
        }
        // Another program may have been faster while the files were written.
        files.keys().try_for_each(|path| self.check_target(path))?;
        for (temp, target) in temporary {
            temp.persist(&target)
                .map_err(|e| CliFailure::unwritable(&target, e.error))?;
        }
        Ok(())
    }
}

/// Refuses a file name without the ending of what is written.
pub(super) fn check_ending(path: &Path, ending: &str, what: &str) -> Result<(), CliFailure> {
    if path.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)) {
        return Ok(());
    }
    let problem = format!("{what} is written as {ending}; use a .{ending} file name");
    Err(CliFailure::Input(format!("{}: {problem}", path.display())))
}

/// Refuses a place where a file of a model lies that is read: what the model names beside itself is replaced by nothing else.
///
/// # Errors
/// Which file it is, and of which model.
pub(super) fn spare_companions(path: &Path, model: &Path, read: &FileSet) -> Result<(), CliFailure> {
    let own = read
        .companions
        .keys()
        .find(|uri| is_same_file(&folder_of(model).join(uri), path));
    let Some(own) = own else { return Ok(()) };
    let problem = format!("{} is made of it, as \"{own}\"; name another file", model.display());
    Err(CliFailure::unwritable(path, problem))
}

/// Whether both paths lead to one file that is there.
fn is_same_file(a: &Path, b: &Path) -> bool {
    matches!((a.canonicalize(), b.canonicalize()), (Ok(a), Ok(b)) if a == b)
}

/// Whether two paths are one place in one folder, though no file may be there yet.
pub(super) fn is_same_place(a: &Path, b: &Path) -> bool {
    a.file_name() == b.file_name() && is_same_file(folder_of(a), folder_of(b))
}

/// Whether two paths lead to one place, through links too, whatever of it is there.
pub(super) fn is_same_target(a: &Path, b: &Path) -> bool {
    let is_same_text = matches!((std::path::absolute(a), std::path::absolute(b)), (Ok(a), Ok(b)) if a == b);
    is_same_text || is_same_file(a, b) || is_same_place(a, b)
}

/// Whether a file is there and holds these bytes.
pub(super) fn holds_bytes(path: &Path, bytes: &[u8]) -> bool {
    read_regular_file(path, bytes.len() as u64).is_ok_and(|there| there == bytes)
}

/// Writes a temporary file beside a place, which goes away unless it is renamed.
///
/// Its name is random and new, so another user of the folder cannot put a link or a pipe there first.
fn fill_beside(
    target: &Path,
    fill: &mut dyn FnMut(&mut dyn Write) -> std::io::Result<()>,
) -> std::io::Result<TempPath> {
    let mut name = target.file_name().unwrap_or_default().to_os_string();
    name.push(".");
    let mut made = tempfile::Builder::new();
    made.prefix(&name).rand_bytes(RANDOM_LETTERS).suffix(".part");
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt as _;
        // As any other file: what others may do with it is for the umask to say.
        made.permissions(fs::Permissions::from_mode(0o666));
    }
    let mut file = made.tempfile_in(folder_of(target)).map_err(without_temporary_name)?;
    fill(file.as_file_mut())?;
    file.as_file().sync_data()?;
    // Closed: a model may have more files than may be open at once.
    Ok(file.into_temp_path())
}

/// The error, without the temporary file's name.
fn without_temporary_name(error: std::io::Error) -> std::io::Error {
    match error.kind() {
        std::io::ErrorKind::Other => error,
        kind => kind.into(),
    }
}
