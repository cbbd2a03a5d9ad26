//! The folder that an agent may read models from and write them to.

use bytes::Bytes;
use pliant_asset::{FileSet, WrittenFiles, missing_companions};
use pliant_session::{Error, ErrorCode};
use std::fs;
use std::io::{Read as _, Write as _};
use std::path::{Component, Path, PathBuf};

/// Names of companions that are followed, at most.
const MOST_COMPANIONS: usize = 1000;

/// A folder; nothing outside of it is read or written, whatever links lie in it.
#[derive(Debug, Clone)]
pub struct AgentFolder(PathBuf);

impl AgentFolder {
    /// The folder at a path.
    ///
    /// # Errors
    /// A text, when there is no folder.
    pub fn new(path: &Path) -> Result<Self, String> {
        let found = path.canonicalize().map_err(|e| format!("{}: {e}", path.display()))?;
        match found.is_dir() {
            true => Ok(Self(found)),
            false => Err(format!("{} is not a folder", path.display())),
        }
    }

    /// Where it lies.
    pub fn path(&self) -> &Path {
        &self.0
    }

    /// A path below the folder as the folder sees it, without `..`.
    fn joined(&self, path: &str, field: &str) -> Result<PathBuf, Error> {
        let given = Path::new(path);
        let outside = || {
            let shown: String = path.chars().take(200).collect();
            let problem = format!("\"{shown}\" lies outside of {}, the folder of --root", self.0.display());
            Error {
                field: Some(field.to_owned()),
                ..Error::new(ErrorCode::PermissionDenied, format!("{field}: {problem}"))
            }
        };
        let inner = given.strip_prefix(&self.0).unwrap_or(given);
        if inner.as_os_str().is_empty() || path.len() > 4096 || path.contains('\0') {
            return Err(Error::invalid(field, "must be a path of 1 to 4096 bytes"));
        }
        let is_plain = |part: Component<'_>| matches!(part, Component::Normal(_) | Component::CurDir);
        if !inner.components().all(is_plain) {
            return Err(outside());
        }
        let whole = self.0.join(inner);
        // Links may lead out: what is there already is looked at as it really is.
        let there = whole.ancestors().find_map(|part| part.canonicalize().ok());
        match there.is_some_and(|there| there.starts_with(&self.0)) {
            true => Ok(whole),
            false => Err(outside()),
        }
    }

    fn read(&self, path: &Path, shown: &str, field: &str, most: u64) -> Result<Bytes, Error> {
        let unreadable = |e: std::io::Error| Error {
            field: Some(field.to_owned()),
            ..Error::new(ErrorCode::NotFound, format!("{field}: \"{shown}\" cannot be read: {e}"))
        };
        let found = path.canonicalize().map_err(unreadable)?;
        if !found.starts_with(&self.0) {
            return Err(Error::invalid(
                field,
                format!("\"{shown}\" lies outside of the folder of --root"),
            ));
        }
        if !fs::metadata(&found).map_err(unreadable)?.is_file() {
            return Err(Error::invalid(field, format!("\"{shown}\" is not a regular file")));
        }
        let mut bytes = Vec::new();
        let file = fs::File::open(&found).map_err(unreadable)?;
        file.take(most.saturating_add(1))
            .read_to_end(&mut bytes)
            .map_err(unreadable)?;
        match bytes.len() as u64 > most {
            true => Err(Error::new(
                ErrorCode::TooLarge,
                format!("{field}: \"{shown}\" has more than the {most} bytes that are allowed"),
            )),
            false => Ok(bytes.into()),
        }
    }

    /// A model with the files that it names, of at most so many bytes together.
    ///
    /// # Errors
    /// `PERMISSION_DENIED` for what lies outside, `NOT_FOUND` for what cannot be read.
    pub fn read_model(&self, path: &str, most: u64) -> Result<FileSet, Error> {
        let whole = self.joined(path, "path")?;
        let name = whole.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let mut files = FileSet::single(name, self.read(&whole, path, "path", most)?);
        let folder = whole.parent().unwrap_or(&self.0).to_owned();
        let mut tried: Vec<String> = Vec::new();
        loop {
            let wanted = missing_companions(&files)
                .into_iter()
                .filter(|name| !tried.contains(name));
            let wanted: Vec<String> = wanted.collect();
            if wanted.is_empty() || tried.len() > MOST_COMPANIONS {
                return Ok(files);
            }
            for name in wanted {
                let left = most.saturating_sub(files.total_bytes());
                // One that is not there, or not to be read, is missing; the reader of the format says what follows.
                let companion = folder.join(&name);
                if let Ok(bytes) = self.read(&companion, &name, "path", left) {
                    files.companions.insert(name.clone(), bytes);
                }
                tried.push(name);
            }
        }
    }

    /// Writes a model and its companions; answers their paths below the folder. Files are written beside their places and renamed.
    ///
    /// # Errors
    /// `PERMISSION_DENIED` for a place outside; `ALREADY_EXISTS` for a file that is there, unless `overwrite`.
    pub fn write_model(&self, path: &str, written: &WrittenFiles, overwrite: bool) -> Result<Vec<String>, Error> {
        let whole = self.joined(path, "path")?;
        let folder = whole.parent().unwrap_or(&self.0).to_owned();
        let mut files: Vec<(PathBuf, &[u8])> = Vec::new();
        for (uri, bytes) in &written.companions {
            let beside = folder.strip_prefix(&self.0).unwrap_or(Path::new("")).join(uri);
            files.push((self.joined(&beside.to_string_lossy(), "path")?, bytes));
        }
        files.push((whole, &written.main));
        for (place, _) in &files {
            let problem = match fs::symlink_metadata(place) {
                Ok(facts) if !facts.is_file() => "is there and no regular file",
                Ok(_) if !overwrite => "is there; set overwrite to replace it",
                _ => continue,
            };
            let shown = place.strip_prefix(&self.0).unwrap_or(place).display();
            return Err(Error {
                field: Some("path".to_owned()),
                ..Error::new(ErrorCode::AlreadyExists, format!("path: \"{shown}\" {problem}"))
            });
        }
        let mut told = Vec::new();
        for (place, bytes) in &files {
            let shown = place.strip_prefix(&self.0).unwrap_or(place).display().to_string();
            write_beside(place, bytes)
                .map_err(|e| Error::invalid("path", format!("\"{shown}\" cannot be written: {e}")))?;
            told.push(shown);
        }
        told.reverse();
        Ok(told)
    }
}

fn write_beside(place: &Path, bytes: &[u8]) -> std::io::Result<()> {
    let folder = place.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder)?;
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    file.write_all(bytes)?;
    file.persist(place).map_err(|e| e.error)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_outside_is_read_or_written() {
        let outer = tempfile::tempdir().expect("a folder");
        let inner = outer.path().join("in");
        fs::create_dir(&inner).expect("a folder");
        fs::write(outer.path().join("secret.obj"), "v 0 0 0").expect("a file");
        fs::write(inner.join("own.obj"), "v 0 0 0").expect("a file");
        let folder = AgentFolder::new(&inner).expect("a folder");
        assert!(folder.read_model("own.obj", 100).is_ok());
        assert_eq!(
            folder.read_model("own.obj", 3).expect_err("too large").code,
            ErrorCode::TooLarge
        );
        let absolute = outer.path().join("secret.obj").display().to_string();
        for path in ["../secret.obj", "a/../../secret.obj", "/etc/passwd", &absolute] {
            let denied = folder.read_model(path, 100).expect_err(path);
            assert_eq!(denied.code, ErrorCode::PermissionDenied, "{path}");
        }
        #[cfg(unix)]
        {
            std::os::unix::fs::symlink(outer.path(), inner.join("out")).expect("a link");
            std::os::unix::fs::symlink(outer.path().join("secret.obj"), inner.join("link.obj")).expect("a link");
            for path in ["out/secret.obj", "link.obj"] {
                assert_eq!(
                    folder.read_model(path, 100).expect_err(path).code,
                    ErrorCode::PermissionDenied,
                    "{path}"
                );
            }
            let written = WrittenFiles {
                main: vec![1],
                ..WrittenFiles::default()
            };
            for path in ["out/new.obj", "link.obj"] {
                assert!(folder.write_model(path, &written, true).is_err(), "{path}");
            }
            assert_eq!(fs::read(outer.path().join("secret.obj")).expect("there"), b"v 0 0 0");
            assert!(!outer.path().join("new.obj").exists());
        }
    }
}
