//! Recorded clips of the data folder, whole and hostile.

use crate::support::data::data_folder;
use pliant::motion::bvh::{ClipLimits, read_bvh};
use pliant::motion::{Error, MotionClip};
use std::path::{Path, PathBuf};

fn read(path: &Path) -> Result<MotionClip, Error> {
    read_bvh(&std::fs::read(path).expect("a file"), &ClipLimits::default())
}

fn clips_below(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.expect("an entry").path()).collect();
    paths.retain(|path| path.extension().is_some_and(|e| e == "bvh"));
    paths.sort();
    paths
}

#[test]
fn every_recorded_clip_is_read_and_stands_upright() {
    let Some(data) = data_folder("recorded clips") else {
        return;
    };
    let paths = clips_below(&data.join("bvh"));
    assert!(paths.len() > 10);
    for path in paths {
        let clip = read(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
        let frames = clip.recorded.expect("frames");
        assert!(
            clip.skeleton.joints.len() > 20 && frames.count > 60,
            "{}",
            path.display()
        );
        // Bones keep their lengths over the clip where only the root is moved, and places stay finite.
        let mut reach = 0.0_f64;
        for k in 0..16 {
            let seconds = clip.duration * f64::from(k) / 15.0;
            let world = clip.skeleton.world_transforms(&clip.pose_at(seconds));
            for (joint, own) in clip.skeleton.joints.iter().zip(&world) {
                assert!(own.is_finite(), "{}: {}", path.display(), joint.name);
                if let Some(parent) = joint.parent {
                    let length = own.translation.distance(world[parent].translation);
                    let rest = joint.rest.translation.length();
                    assert!(
                        (length - rest).abs() < 1e-3 * (1.0 + rest),
                        "{}: {}",
                        path.display(),
                        joint.name
                    );
                    reach = reach.max(own.translation.distance(world[0].translation));
                }
            }
        }
        assert!(reach > 1.0, "{}", path.display());
    }
}

#[test]
fn more_frames_than_declared_count() {
    let Some(data) = data_folder("a clip with a row too many") else {
        return;
    };
    let clip = read(&data.join("bvh/boxing_toes.bvh")).expect("a clip");
    assert_eq!(clip.recorded.map(|frames| frames.count), Some(3070));
    assert_eq!(clip.warnings.len(), 1);
}

#[test]
fn hostile_clips_are_refused_with_a_reason() {
    let Some(data) = data_folder("hostile clips") else {
        return;
    };
    for path in clips_below(&data.join("hostile/bvh")) {
        let refused = read(&path).expect_err(&path.display().to_string()).to_string();
        assert!(refused.len() < 300 && !refused.contains('\n'), "{refused}");
    }
}
