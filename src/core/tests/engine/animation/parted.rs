//! Frames of a recording that keep surfaces from crossing.

use super::arm::frames;
use glam::DVec3;
use pliant_core::asset::FileSet;
use pliant_core::asset::sample::body_glb;
use pliant_core::engine::{
    ANIMATION_QUALITY, AnimatedFrame, Animation, BLOCK_FRAMES, Contact, Deformer, DeformerLimits, Error, FrameTimes,
    OpenOptions, digest,
};
use pliant_core::exec::Exec;
use pliant_core::motion::bvh::{ClipLimits, read_bvh};
use pliant_core::motion::rig::{DriveOptions, MotionRig, ReferencePose, RestAttitude, RigBone, RigDriver};
use pliant_core::pool::Pool;
use pliant_core::progress::{Progress, Silent};
use std::fmt::Write as _;

const AVOIDED: Contact = Contact::Avoided { clearance: None };
/// The joints of an arm of the built-in body: its elbow bends between the second and the third bone.
const JOINTS: [(&str, f64); 4] = [("chest", 0.0), ("upper", 0.2), ("fore", 0.45), ("hand", 0.7)];
const TIP: f64 = 0.86;
const HEIGHT: f64 = 1.41;

fn body(exec: &Exec<'_>) -> Deformer {
    let files = FileSet::single("body.glb", body_glb());
    Deformer::open(files, &OpenOptions::default(), &DeformerLimits::default(), exec).expect("a model")
}

fn rig() -> MotionRig {
    let at = |x: f64| DVec3::new(x, HEIGHT, 0.0);
    let ends = JOINTS.iter().skip(1).map(|joint| joint.1).chain([TIP]);
    let bones = JOINTS.iter().zip(ends).map(|((id, from), to)| RigBone {
        rest: RestAttitude::Orientation,
        slices: if ["upper", "fore"].contains(id) { 3 } else { 1 },
        ..RigBone::along(*id, at(*from), at(to), 0.06)
    });
    let parents: Vec<Option<String>> = [None]
        .into_iter()
        .chain(JOINTS.map(|(id, _)| Some(id.into())))
        .take(4)
        .collect();
    MotionRig::from_named_parents(bones.collect(), &parents, ReferencePose::Frame(0), None).expect("a rig")
}

/// A clip of the arm, with the bend of its elbow in degrees by frame.
fn recording(bends: &[f64]) -> String {
    let mut text = String::from("HIERARCHY\nROOT chest\n{\nOFFSET 0 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n");
    for two in JOINTS.windows(2) {
        let (name, offset) = (two[1].0, two[1].1 - two[0].1);
        write!(
            text,
            "JOINT {name}\n{{\nOFFSET {offset} 0 0\nCHANNELS 3 Zrotation Xrotation Yrotation\n"
        )
        .expect("text");
    }
    text += "End Site\n{\nOFFSET 0.16 0 0\n}\n}\n}\n}\n}\nMOTION\n";
    write!(text, "Frames: {}\nFrame Time: 0.0333333\n", bends.len()).expect("text");
    for bend in bends {
        writeln!(text, "0 0 0 0 0 0 0 0 {} 0 0 0", -bend).expect("text");
    }
    text
}

fn animation(deformer: &Deformer, bends: &[f64], contact: Contact, exec: &Exec<'_>) -> Animation {
    let clip = read_bvh(recording(bends).as_bytes(), &ClipLimits::default()).expect("a clip");
    let times = FrameTimes::between(0.0, clip.duration, 30.0);
    let rig = rig();
    let driver = RigDriver::new(&rig, clip, &DriveOptions::default()).expect("a driver");
    let animation = deformer.animation(rig, driver, times, &ANIMATION_QUALITY, exec);
    let mut animation = animation.expect("an animation");
    animation.set_contact(contact);
    animation
}

/// The elbow goes to 160 degrees in so many frames, and stays there for some.
fn bending(steps: usize, stays: usize) -> Vec<f64> {
    let bends = (0..=steps).map(|k| 160.0 * k as f64 / steps as f64);
    bends.chain(std::iter::repeat_n(160.0, stays)).collect()
}

fn crossing_pairs(deformer: &Deformer, frames: &[AnimatedFrame], exec: &Exec<'_>) -> Vec<u64> {
    let pairs = |frame: &AnimatedFrame| {
        deformer
            .crossing_pairs(&frame.positions, 0, exec)
            .expect("no cancel")
            .new
    };
    frames.iter().map(pairs).collect()
}

#[test]
fn a_recorded_elbow_hardly_crosses_however_fast_it_bends() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = body(&exec);
    for steps in [30, 6] {
        let bends = bending(steps, 2);
        let [without, with] = [Contact::Ignored, AVOIDED].map(|contact| {
            let animation = animation(&deformer, &bends, contact, &exec);
            frames(&animation, 0..usize::MAX, 1, &exec)
        });
        let [before, after] = [&without, &with].map(|frames| crossing_pairs(&deformer, frames, &exec));
        for (k, (own, left)) in before.iter().zip(&after).enumerate() {
            assert!(left <= own, "frame {k} of {steps}: {own} pairs without, {left} with");
            let is_same = without[k].positions == with[k].positions;
            assert!(*own > 0 || is_same, "frame {k} does not cross and has other bits");
        }
        let [before, after] = [before, after].map(|pairs| pairs.iter().sum::<u64>());
        assert!(
            before > 500 && after * 20 <= before,
            "{steps}: {after} of {before} pairs"
        );
    }
}

#[test]
fn parted_frames_depend_neither_on_threads_nor_on_the_range() {
    let (one, three) = (Pool::new(1).expect("a thread"), Pool::new(3).expect("threads"));
    let reported = |pool: &Pool, range: std::ops::Range<usize>, at_once: usize| -> Vec<(usize, String)> {
        let exec = Exec::new(pool, &Silent);
        let deformer = body(&exec);
        let animation = animation(&deformer, &bending(20, BLOCK_FRAMES - 18), AVOIDED, &exec);
        let frames = frames(&animation, range, at_once, &exec);
        let left = crossing_pairs(&deformer, &frames, &exec);
        assert!(
            left.iter().all(|pairs| *pairs == 0),
            "a block begins in a deep pose: {left:?}"
        );
        frames.iter().map(|f| (f.index, digest(&f.positions))).collect()
    };
    let whole = reported(&one, 0..usize::MAX, 1);
    assert_eq!(whole.len(), BLOCK_FRAMES + 3);
    assert_eq!(whole[60..], reported(&three, 60..usize::MAX, 2)[..]);
    assert_eq!(whole[66..], reported(&one, 66..67, 1)[..]);
}

/// Allows so many bytes.
struct MemoryFor(u64);

impl Progress for MemoryFor {
    fn may_hold(&self, bytes: u64) -> bool {
        bytes <= self.0
    }
}

#[test]
fn parting_asks_for_memory_before_it_takes_it() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let deformer = body(&exec);
    let bends = bending(1, 0);
    let animation = animation(&deformer, &bends, AVOIDED, &exec);
    let little = MemoryFor(1 << 20);
    let mut cursor = animation.cursor(0..2);
    let refused = animation.solve_next(&mut cursor, &Exec::new(&pool, &little));
    assert!(
        matches!(refused, Err(Error::TooLarge { seen, .. }) if seen > 1 << 20),
        "{refused:?}"
    );
    // As much as is asked for is enough.
    let mut cursor = animation.cursor(0..2);
    let Err(Error::TooLarge { seen, .. }) = refused else {
        return;
    };
    for _ in 0..2 {
        animation.solve_next(&mut cursor, &exec).expect("a frame");
    }
    assert!(
        cursor.byte_size() <= seen,
        "{} bytes are held, {seen} were asked for",
        cursor.byte_size()
    );
}
