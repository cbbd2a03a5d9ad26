//! The process ends, or the power fails, after each single write and sync of a commit: the session opens to the state before or after
//! that commit, never between, and whatever was acknowledged is there.
//!
//! A server runs once while every change of its files is reported, in order. From that the disk is made as it was after each change, in
//! three ways: with all changes (the process ended), with the last one half done (it ended in the middle of a write), and with nothing
//! but what was synced (the power failed). Each of them is opened.

use super::path;
use crate::support::program::ServedProgram;
use crate::support::server::{bar_obj, ends, turn_json};
use pliant::session::store::{Store, StoreLocation};
use pliant::session::{Error, ErrorCode, Manager, OpenDeformer, SessionConfig, Tenant};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use xxhash_rust::xxh3::Xxh3;

/// The commits of a session and the current one, as (revision, digest).
#[derive(Debug, Clone, PartialEq, Eq)]
struct SeenLog {
    commits: Vec<(u64, String)>,
    current: u64,
}

impl SeenLog {
    fn reply(history: &Value) -> Self {
        let number = |v: &Value| {
            v.as_str()
                .map_or_else(|| v.as_u64(), |t| t.parse().ok())
                .expect("a number")
        };
        let digest = |v: &Value| v.as_str().expect("a digest").to_owned();
        let list = history["commits"].as_array().expect("commits").iter();
        Self {
            commits: list.map(|c| (number(&c["revision"]), digest(&c["digest"]))).collect(),
            current: number(&history["current"]),
        }
    }

    fn of(history: pliant::wire::pb::HistoryResponse) -> Self {
        Self {
            commits: history.commits.into_iter().map(|c| (c.revision, c.digest)).collect(),
            current: history.current,
        }
    }
}

/// The library that reports changes, built by the compiler of C.
fn tracer(folder: &Path) -> PathBuf {
    let library = folder.join("disk_trace.so");
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/service/durable/disk_trace.c");
    let mut compiler = Command::new("cc");
    compiler
        .args(["-shared", "-fPIC", "-O1", "-o"])
        .arg(&library)
        .arg(source)
        .arg("-ldl");
    let built = compiler.output().expect("a compiler of C");
    assert!(built.status.success(), "{}", String::from_utf8_lossy(&built.stderr));
    library
}

/// A session's life under a tracer: what it was after each acknowledged call, and how many changes had been reported by then.
async fn traced_life(folder: &Path) -> (String, Vec<(usize, Option<SeenLog>)>, PathBuf) {
    let (library, records) = (tracer(folder), folder.join("changes"));
    let disk = folder.join("disk");
    std::fs::create_dir(&disk).expect("a folder");
    let text = |path: &Path| path.to_str().expect("UTF-8").to_owned();
    let (preload, root, reply, data) = (text(&library), text(&disk), text(&records), text(&disk.join("data")));
    let variables = [
        ("LD_PRELOAD", &*preload),
        ("DISK_TRACE_ROOT", &*root),
        ("DISK_TRACE", &*reply),
    ];
    let server = ServedProgram::start_anywhere(folder.join("log"), &["--data-dir", &data], &variables);
    let server = server.expect("the server starts");
    let count = || reported_changes(&records).len();
    let mut states = vec![(count(), None)];
    let id = server.open(bar_obj(8), "").await;
    let handles = json!({"handles": ends()});
    let merge = json!({"merge": {"model": base64(&bar_obj(6)), "how": "LOOSE",
        "transform": [1,0,0,0, 0,1,0,0, 0,0,1,0, 5,0,0,1]}});
    let cut = json!({"cut": {"plane": {"normal": [0, 0, 1], "offset": 2.01}, "keep": "BOTH", "fill": true}});
    for (method, rest, body) in [
        ("GET", "", None),
        ("PUT", "/handles", Some(handles)),
        ("POST", "/solve", Some(turn_json(0.4))),
        ("POST", "/edits", Some(merge)),
        ("POST", "/solve", Some(turn_json(0.8))),
        ("POST", "/undo", None),
        ("POST", "/redo", None),
        ("POST", "/edits", Some(cut)),
    ] {
        server.done(method, &path(&id, rest), body.as_ref()).await;
        let changes = count();
        let history = server.done("GET", &path(&id, "/history"), None).await;
        states.push((changes, Some(SeenLog::reply(&history))));
    }
    server.done("DELETE", &path(&id, ""), None).await;
    states.push((count(), None));
    server.kill();
    (id, states, records)
}

/// What a disk holds of a session.
async fn opened(disk: &Path, id: &str) -> Result<Option<SeenLog>, Error> {
    let store = Store::open(&StoreLocation::in_folder(disk)).await?;
    let config = SessionConfig {
        compute_threads: 1,
        ..SessionConfig::default()
    };
    let manager = Manager::with_store(config, OpenDeformer, Arc::new(store)).await?;
    let found = manager.history(&Tenant::default(), id).await;
    manager.abort();
    match found {
        Ok(history) => Ok(Some(SeenLog::of(history))),
        Err(error) if error.code == ErrorCode::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn the_state_is_the_one_before_or_after_wherever_the_process_ends() {
    let folder = tempfile::tempdir().expect("a folder");
    let (id, states, records) = traced_life(folder.path()).await;
    let changes = reported_changes(&records);
    let root = folder.path().join("disk");
    let mut disk = DiskModel::new(&root);
    let mut tried = BTreeSet::new();
    let (mut points, mut opens) = (0, 0);
    let mut found: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for (at, change) in changes.iter().enumerate() {
        let half = disk.with_half(change);
        disk.apply(change);
        points += 1;
        // The states that it may be in: the newest acknowledged one, or the one that was being made.
        let acknowledged = states.iter().rposition(|(changes, _)| *changes <= at + 1);
        let allowed = acknowledged.map_or(0..=0, |k| k..=(k + 1).min(states.len() - 1));
        let kept = [Some(disk.whole()), half, Some(disk.synced())];
        for (way, tree) in kept.into_iter().enumerate() {
            let Some(tree) = tree else { continue };
            if !tried.insert((tree.digest(), *allowed.start())) {
                continue;
            }
            let place = tempfile::tempdir().expect("a folder");
            tree.write(place.path());
            let reply = opened(&place.path().join("data"), &id).await;
            opens += 1;
            let reply = reply.unwrap_or_else(|error| panic!("change {at} ({change:?}), way {way}: {error}"));
            let is_allowed = states[allowed.clone()].iter().position(|(_, state)| *state == reply);
            let which = is_allowed.unwrap_or_else(|| {
                panic!(
                    "change {at} ({change:?}), way {way}: {reply:?} is neither of {:?}",
                    &states[allowed.clone()]
                )
            });
            found.entry(*allowed.start()).or_default().insert(which);
        }
    }
    println!("{points} changes of files, {opens} disks opened");
    assert!(points > 100, "{points}");
    // Every commit was seen from both sides.
    for k in 0..states.len() - 1 {
        assert!(
            found.get(&k).is_some_and(|seen| seen.contains(&0)),
            "state {k} was never seen"
        );
    }
    // What was reported is what is there.
    assert!(disk.whole().is_same_as(&root), "the model of the disk is not the disk");
}

fn base64(text: &str) -> String {
    use base64::Engine as _;
    base64::engine::general_purpose::STANDARD.encode(text)
}

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

/// The changes that were reported so far; one that is being reported is left out.
pub fn reported_changes(records: &Path) -> Vec<DiskChange> {
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
    /// What distinguishes it from others.
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

    /// Whether a folder holds just that, but for the index of the log, which is not a file that is written.
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
