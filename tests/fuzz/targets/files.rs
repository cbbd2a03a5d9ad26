//! Files of models in every format, read with enough memory and within a small ledger; recordings and rigs.

use glam::DVec3;
use pliant::asset::{Error, FileSet, Format, Limits, Model};
use pliant::motion::bvh::{ClipLimits, read_bvh};
use pliant::progress::Progress;
use pliant::wire;
use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};

/// Small enough that no input takes long.
pub const LIMITS: Limits = Limits {
    cage_triangles: 500,
    vertices: 20_000,
    triangles: 40_000,
    decoded_bytes: 32 << 20,
    document_bytes: 32 << 20,
    points_and_lines: true,
    apart: None,
};

/// The companions that files may name: some bytes, and a material library.
pub fn companions() -> BTreeMap<String, bytes::Bytes> {
    let pattern: Vec<u8> = (0..2048u32).map(|i| (i * 37 % 251) as u8).collect();
    let library = "newmtl a\nKd 1 0 0\nmap_Kd b.png\nnewmtl b\nKd nan 1 2\n";
    BTreeMap::from([
        ("b.bin".to_owned(), pattern.into()),
        ("m.mtl".to_owned(), library.into()),
        ("b.png".to_owned(), vec![0x89, b'P', b'N', b'G', 1, 2, 3].into()),
    ])
}

/// Reads a file, of a given format or of the one that its bytes show, and writes what was read.
pub fn read_and_write(bytes: &[u8], format: Option<Format>) {
    let files = FileSet {
        name: "model".into(),
        main: bytes.to_vec().into(),
        companions: companions(),
    };
    let model = match Model::read(files, format, &LIMITS) {
        Ok(model) => model,
        Err(refused) => return assert!(!refused.to_string().is_empty()),
    };
    assert!(model.positions.len() as u64 <= LIMITS.vertices && model.triangles.len() as u64 <= LIMITS.triangles);
    assert!(
        model.positions.iter().all(|p| p.is_finite()),
        "a position that is not a number"
    );
    let vertices = model.positions.len();
    assert!(
        model.triangles.iter().flatten().all(|&v| (v as usize) < vertices),
        "a vertex that is not there"
    );
    if vertices > 2000 {
        return;
    }
    let moved: Vec<DVec3> = model
        .positions
        .iter()
        .map(|&p| p * 1.0625 + DVec3::new(0.5, 0.0, -0.25))
        .collect();
    // A file as it came, moved in place; and, of some inputs, files that are made from the start, which takes longer.
    let made = [Format::GLB, Format::OBJ, Format::PLY];
    let formats = [model.format]
        .into_iter()
        .chain(made.into_iter().filter(|_| bytes.len().is_multiple_of(16)));
    for written_as in formats {
        let Ok(written) = model.write(&moved, written_as) else {
            continue;
        };
        let own = written.companions.into_iter().map(|(name, bytes)| (name, bytes.into()));
        let again = FileSet {
            name: "again".into(),
            main: written.main.into(),
            companions: companions().into_iter().chain(own).collect(),
        };
        let limits = Limits {
            decoded_bytes: u64::MAX,
            document_bytes: u64::MAX,
            ..LIMITS
        };
        let again = Model::read(again, Some(written_as), &limits);
        if let Err(refused) = again {
            panic!(
                "{} that was written as {} cannot be read again: {refused}",
                model.format.name(),
                written_as.name()
            );
        }
    }
}

/// Allows so many bytes, and notes what was asked for.
#[derive(Debug, Default)]
pub struct SmallLedger {
    budget: u64,
    /// The most bytes that were asked for, and that were allowed.
    asked: AtomicU64,
    allowed: AtomicU64,
}

impl SmallLedger {
    pub fn new(budget: u64) -> Self {
        Self {
            budget,
            ..Self::default()
        }
    }

    pub fn asked(&self) -> u64 {
        self.asked.load(Relaxed)
    }

    pub fn allowed(&self) -> u64 {
        self.allowed.load(Relaxed)
    }
}

impl Progress for SmallLedger {
    fn may_hold(&self, bytes: u64) -> bool {
        self.asked.fetch_max(bytes, Relaxed);
        let is_allowed = bytes <= self.budget;
        if is_allowed {
            self.allowed.fetch_max(bytes, Relaxed);
        }
        is_allowed
    }
}

/// Reads a file of any format within a ledger.
pub fn read_within(bytes: &[u8], limits: &Limits, ledger: &SmallLedger) -> Result<Model, Error> {
    let files = FileSet {
        name: "model".into(),
        main: bytes.to_vec().into(),
        companions: companions(),
    };
    Model::read_watched(files, None, limits, ledger)
}

/// The first byte says how much may be held, the rest is a file: it is read as with enough memory, or refused for the want of it.
pub fn decoders(bytes: &[u8]) {
    let Some((&choice, file)) = bytes.split_first() else {
        return;
    };
    let small = SmallLedger::new(1 << (10 + choice % 16));
    let read = read_within(file, &LIMITS, &small);
    let enough = SmallLedger::new(u64::MAX);
    let wanted = read_within(file, &LIMITS, &enough);
    if small.asked() <= small.budget {
        assert_eq!(
            read.map(|m| m.geometry),
            wanted.map(|m| m.geometry),
            "both have what they ask for"
        );
        return;
    }
    assert!(small.allowed() <= small.budget);
    match read {
        // It asked for more ahead than it needed.
        Ok(model) => assert_eq!(Ok(model.geometry), wanted.map(|m| m.geometry)),
        Err(Error::TooLarge { .. }) => {}
        Err(refused) => assert_eq!(Err(refused), wanted.map(|m| m.geometry)),
    }
}

pub fn bvh(bytes: &[u8]) {
    let limits = ClipLimits {
        bytes: 1 << 20,
        joints: 256,
        frames: 4096,
        numbers: 1 << 18,
    };
    match read_bvh(bytes, &limits) {
        Ok(clip) => {
            let frames = clip.recorded.map_or(0, |recorded| recorded.count);
            assert!(clip.skeleton.joints.len() <= limits.joints && frames <= limits.frames);
            for pose in clip.pose_at(clip.duration * 0.5) {
                assert!(
                    pose.rotation.is_finite() && pose.translation.is_finite(),
                    "a pose that is not a number"
                );
            }
        }
        Err(refused) => assert!(!refused.to_string().is_empty()),
    }
}

pub fn rig(bytes: &[u8]) {
    if let Err(refused) = wire::rig_from_json(bytes) {
        assert!(!refused.to_string().is_empty());
    }
}
