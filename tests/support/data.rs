//! Models that are too large for the repository: they lie in the folder that `PLIANT_DATA` names, and what needs them is
//! skipped without it, which is said.

use std::io::Write as _;
use std::path::{Path, PathBuf};
use std::sync::Mutex;

/// Says what is skipped and why, where it is seen also when the test passes.
pub fn report_skipped(what: &str, why: &str) {
    let _ = writeln!(std::io::stderr(), "SKIPPED: {what}: {why}");
}

/// Where the data folder is, or would be.
pub fn data_root() -> PathBuf {
    if let Some(named) = std::env::var_os("PLIANT_DATA") {
        return PathBuf::from(named);
    }
    // A crate's tests begin in its own folder, below the repository's.
    let own = Path::new(env!("CARGO_MANIFEST_DIR"));
    let root = own.ancestors().find(|folder| folder.join("Cargo.lock").exists());
    root.unwrap_or(own).join("../shared/data")
}

/// The data folder; `None`, and a line that says so, when it is not there.
pub fn data_folder(what: &str) -> Option<PathBuf> {
    data_path(what, "")
}

/// A file or folder of the data folder; `None`, and a line that says what is skipped, when it is not there.
pub fn data_path(what: &str, name: &str) -> Option<PathBuf> {
    let path = data_root().join(name);
    if path.exists() {
        return Some(path);
    }
    report_skipped(
        what,
        &format!("{} is not there; PLIANT_DATA names the folder", path.display()),
    );
    None
}

/// The bytes of a file of the data folder; `None`, and a line that says what is skipped, when it is not there.
pub fn data_bytes(name: &str) -> Option<Vec<u8>> {
    data_path(name, name).map(|path| std::fs::read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display())))
}

/// Every file below a folder that fits, in order.
pub fn files_below(folder: &Path, fits: impl Fn(&Path) -> bool) -> Vec<PathBuf> {
    let (mut found, mut open) = (Vec::new(), vec![folder.to_path_buf()]);
    while let Some(folder) = open.pop() {
        for entry in std::fs::read_dir(&folder).into_iter().flatten() {
            let path = entry.expect("a readable entry").path();
            if path.is_dir() {
                open.push(path);
            } else if fits(&path) {
                found.push(path);
            }
        }
    }
    found.sort();
    found
}

/// Copies a folder with all that is in it.
pub fn copied(from: &Path, to: &Path) {
    std::fs::create_dir_all(to).expect("a folder");
    for entry in std::fs::read_dir(from).expect("a folder") {
        let entry = entry.expect("an entry");
        let goal = to.join(entry.file_name());
        match entry.path().is_dir() {
            true => copied(&entry.path(), &goal),
            false => drop(std::fs::copy(entry.path(), goal).expect("copied")),
        }
    }
}

/// What is found of each file, two at a time; in the order of the files.
pub fn of_each<T: Send>(files: &[PathBuf], find: impl Fn(usize, &Path) -> T + Sync) -> Vec<T> {
    let next = Mutex::new(files.iter().enumerate());
    let found = Mutex::new(Vec::new());
    std::thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| {
                loop {
                    let Some((k, path)) = next.lock().expect("no panic").next() else {
                        break;
                    };
                    let one = find(k, path);
                    found.lock().expect("no panic").push((k, one));
                }
            });
        }
    });
    let mut found = found.into_inner().expect("no panic");
    found.sort_by_key(|(k, _)| *k);
    found.into_iter().map(|(_, one)| one).collect()
}
