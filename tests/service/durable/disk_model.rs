//! A disk as it was after each change that a process made, with what was synced and what was not.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use xxhash_rust::xxh3::Xxh3;

/// One change of a file or folder.
#[derive(Clone)]
pub struct DiskChange {
    what: u8,
    path: PathBuf,
    other: PathBuf,
    offset: usize,
    bytes: Vec<u8>,
}

impl std::fmt::Debug for DiskChange {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let (what, length) = (char::from(self.what), self.bytes.len());
        write!(f, "{what} {} at {}, {length} bytes", self.path.display(), self.offset)
    }
}

/// The changes that were told so far; one that is being told is left out.
pub fn told_changes(records: &Path) -> Vec<DiskChange> {
    let bytes = fs::read(records).unwrap_or_default();
    let mut rest = &bytes[..];
    let mut changes = Vec::new();
    while let Some((head, after)) = rest.split_at_checked(21) {
        let size = |k: usize| u32::from_le_bytes(head[k..k + 4].try_into().expect("four")) as usize;
        let (path, other, length) = (size(1), size(5), size(9));
        let Some((body, after)) = after.split_at_checked(path + other + length) else {
            break;
        };
        let text = |bytes: &[u8]| PathBuf::from(String::from_utf8(bytes.to_vec()).expect("UTF-8"));
        changes.push(DiskChange {
            what: head[0],
            path: text(&body[..path]),
            other: text(&body[path..path + other]),
            offset: u64::from_le_bytes(head[13..].try_into().expect("eight")) as usize,
            bytes: body[path + other..].to_vec(),
        });
        rest = after;
    }
    changes
}

/// Contents of a file, as programs see it and as it was synced last; none for a folder.
#[derive(Clone, Default)]
struct DiskNode {
    now: Option<Vec<u8>>,
    synced: Option<Vec<u8>>,
}

/// Files and folders below a folder.
#[derive(Clone)]
pub struct DiskModel {
    root: PathBuf,
    nodes: Vec<DiskNode>,
    names: BTreeMap<PathBuf, usize>,
    synced_names: BTreeMap<PathBuf, usize>,
}

/// What a disk holds: contents of files by their path, none for folders.
pub struct DiskTree(BTreeMap<PathBuf, Option<Vec<u8>>>);

impl DiskModel {
    /// A disk with the empty folder `root`.
    pub fn new(root: &Path) -> Self {
        Self {
            root: root.to_owned(),
            nodes: Vec::new(),
            names: BTreeMap::new(),
            synced_names: BTreeMap::new(),
        }
    }

    /// Carries out a change.
    pub fn apply(&mut self, change: &DiskChange) {
        let DiskChange { path, .. } = change;
        match change.what {
            b'c' | b'm' => {
                let empty = (change.what == b'c').then(Vec::new);
                let synced = empty.clone();
                self.nodes.push(DiskNode { now: empty, synced });
                self.names.insert(path.clone(), self.nodes.len() - 1);
            }
            b'w' => {
                let file = self.file(path);
                let end = change.offset + change.bytes.len();
                file.resize(file.len().max(end), 0);
                file[change.offset..end].copy_from_slice(&change.bytes);
            }
            b't' => self.file(path).resize(change.offset, 0),
            b's' => self.sync(path),
            b'r' => {
                let node = self.names.remove(path).expect("a file");
                self.names.insert(change.other.clone(), node);
            }
            b'u' => {
                self.names.remove(path).expect("a file");
            }
            other => panic!("a change {other}"),
        }
    }

    fn file(&mut self, path: &Path) -> &mut Vec<u8> {
        let node = *self
            .names
            .get(path)
            .unwrap_or_else(|| panic!("no file {}", path.display()));
        self.nodes[node].now.as_mut().expect("a file")
    }

    fn sync(&mut self, path: &Path) {
        if let Some(node) = self
            .names
            .get(path)
            .map(|k| &mut self.nodes[*k])
            .filter(|n| n.now.is_some())
        {
            node.synced.clone_from(&node.now);
            return;
        }
        // A folder: the names in it.
        let is_inside = |name: &Path| name.parent() == Some(path);
        self.synced_names.retain(|name, _| !is_inside(name));
        let inside = self.names.iter().filter(|(name, _)| is_inside(name));
        self.synced_names
            .extend(inside.map(|(name, node)| (name.clone(), *node)));
    }

    /// The disk with half of a write.
    pub fn with_half(&self, change: &DiskChange) -> Option<DiskTree> {
        if change.what != b'w' || change.bytes.len() < 2 {
            return None;
        }
        let (mut torn, mut half) = (self.clone(), change.clone());
        half.bytes.truncate(change.bytes.len() / 2);
        torn.apply(&half);
        Some(torn.whole())
    }

    /// All of it, as programs see it.
    pub fn whole(&self) -> DiskTree {
        self.tree(&self.names, |node| &node.now)
    }

    /// What was synced: contents of files, and names by their folder.
    pub fn synced(&self) -> DiskTree {
        let mut tree = self.tree(&self.synced_names, |node| &node.synced);
        let there: Vec<PathBuf> = tree.0.keys().cloned().collect();
        let is_reachable = |name: &Path| {
            let folders = name.ancestors().skip(1).map(Path::to_owned);
            let mut folders = folders.take_while(|f| !f.as_os_str().is_empty());
            folders.all(|folder| there.contains(&folder))
        };
        tree.0.retain(|name, _| is_reachable(name));
        tree
    }

    fn tree(&self, names: &BTreeMap<PathBuf, usize>, of: impl Fn(&DiskNode) -> &Option<Vec<u8>>) -> DiskTree {
        let short = |name: &Path| name.strip_prefix(&self.root).expect("below").to_owned();
        DiskTree(
            names
                .iter()
                .map(|(name, k)| (short(name), of(&self.nodes[*k]).clone()))
                .collect(),
        )
    }
}

impl DiskTree {
    /// What tells it from others.
    pub fn digest(&self) -> u128 {
        let mut hasher = Xxh3::new();
        for (path, bytes) in &self.0 {
            let bytes = bytes.as_deref().unwrap_or(b"\0folder");
            for part in [path.to_str().expect("UTF-8").as_bytes(), bytes] {
                hasher.update(&(part.len() as u64).to_le_bytes());
                hasher.update(part);
            }
        }
        hasher.digest128()
    }

    /// Writes it below a folder.
    pub fn write(&self, folder: &Path) {
        for (path, bytes) in &self.0 {
            let place = folder.join(path);
            match bytes {
                Some(bytes) => fs::write(place, bytes).expect("writable"),
                None => fs::create_dir(place).expect("a folder"),
            }
        }
    }

    /// Whether a folder holds just that, but for the index of the log, which is no file that is written.
    pub fn is_same_as(&self, root: &Path) -> bool {
        let mut left: Vec<PathBuf> = vec![root.to_owned()];
        let mut found = BTreeMap::new();
        while let Some(folder) = left.pop() {
            for entry in fs::read_dir(&folder).expect("readable") {
                let path = entry.expect("an entry").path();
                let name = path.strip_prefix(root).expect("below").to_owned();
                if path.is_dir() {
                    left.push(path);
                    found.insert(name, None);
                } else if !name.to_string_lossy().ends_with("-shm") {
                    found.insert(name, Some(fs::read(&path).expect("readable")));
                }
            }
        }
        found == self.0
    }
}
