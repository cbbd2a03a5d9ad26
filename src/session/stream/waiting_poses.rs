//! Poses that wait on a stream: which are let in, and how many become few.

use crate::session::error::Error;
use crate::wire::{DeformOptions, pb};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Drag poses that wait one by one; more are merged, oldest first.
pub(in crate::session) const WAITING_DRAGS: usize = 64;

/// Poses by handle.
pub(in crate::session) type DraggedPoses = BTreeMap<String, Option<pb::HandlePose>>;

/// A pose that waits to be solved.
#[derive(Debug, Clone)]
pub(in crate::session) struct WaitingPose {
    pub seq: u64,
    pub entries: Vec<pb::pose::Entry>,
    pub commit: bool,
    /// The options in force when it came.
    pub settings: Arc<DeformOptions>,
    /// Poses that it stands for, itself included; more than one only when poses had to be merged.
    pub poses: u32,
}

/// Refuses what no engine would take and what would make waiting poses large. Everything else is checked when the pose's turn
/// comes, by the engine.
pub(in crate::session) fn check_pose_size(pose: &pb::Pose, max_entries: usize) -> Result<(), Error> {
    if pose.handles.len() > max_entries {
        let text = format!("has {} entries, at most {max_entries} are allowed", pose.handles.len());
        return Err(Error::invalid("pose.handles", text));
    }
    for (k, entry) in pose.handles.iter().enumerate() {
        if entry.id.len() > 128 {
            let text = "is longer than the 128 bytes of any handle";
            return Err(Error::invalid(format!("pose.handles[{k}].id"), text));
        }
        let Some(p) = &entry.pose else { continue };
        let lists = [
            ("translation", &p.translation),
            ("rotation", &p.rotation),
            ("rotationVector", &p.rotation_vector),
            ("scale", &p.scale),
            ("pivot", &p.pivot),
        ];
        if let Some((name, list)) = lists.into_iter().find(|(_, list)| list.len() > 4) {
            let field = format!("pose.handles[{k}].pose.{name}");
            return Err(Error::invalid(
                field,
                format!("has {} numbers, at most 4 are allowed", list.len()),
            ));
        }
    }
    Ok(())
}

/// Merges the oldest neighbouring drags while too much waits. Which of them was wrong, if any, is then not told.
pub(in crate::session) fn merge_waiting_drags(waiting: &mut VecDeque<WaitingPose>, max_entries: usize) {
    let most = 2 * max_entries + WAITING_DRAGS;
    loop {
        let drags = waiting.iter().filter(|w| !w.commit);
        let (count, entries) = drags.fold((0, 0), |(n, e), w| (n + 1, e + w.entries.len()));
        if count <= WAITING_DRAGS && entries <= most {
            return;
        }
        let mut pairs = waiting.iter().zip(waiting.iter().skip(1));
        let Some(at) = pairs.position(|(a, b)| !a.commit && !b.commit) else {
            return;
        };
        let Some(old) = waiting.remove(at) else { return };
        let Some(new) = waiting.get_mut(at) else { return };
        let mut union = DraggedPoses::new();
        union.extend(
            old.entries
                .into_iter()
                .chain(std::mem::take(&mut new.entries))
                .map(|e| (e.id, e.pose)),
        );
        // More names than a session has handles: some are wrong, and nobody knows yet which.
        let few = union.into_iter().take(max_entries);
        new.entries = few.map(|(id, pose)| pb::pose::Entry { id, pose }).collect();
        new.poses = new.poses.saturating_add(old.poses);
    }
}
