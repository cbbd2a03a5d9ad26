//! Poses that wait on a stream, and how they are merged.

use crate::engine::HandlePose;
use crate::wire::{DeformOptions, Error as WireError, PoseKey};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Drag poses that wait one by one; more are merged, oldest first.
pub(in crate::session) const WAITING_DRAGS: usize = 64;

/// Poses by handle.
pub(in crate::session) type DraggedPoses = BTreeMap<String, HandlePose>;

/// The handles that a pose names, each with its pose, or with the error that the stream reports at the pose's turn.
pub(in crate::session) type PoseEntries = Vec<(String, Result<HandlePose, WireError>)>;

/// A pose that waits to be solved.
#[derive(Debug, Clone)]
pub(in crate::session) struct WaitingPose {
    pub seq: u64,
    pub entries: PoseEntries,
    pub commit: bool,
    /// Of a commit that may be sent again.
    pub key: Option<PoseKey>,
    /// The options in force when it came.
    pub settings: Arc<DeformOptions>,
    /// Poses that it stands for, itself included; more than one only when poses had to be merged.
    pub poses: u32,
}

/// Merges the oldest neighbouring drags while too much waits. Errors then do not name the drag.
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
        let entries = old.entries.into_iter().chain(std::mem::take(&mut new.entries));
        let union: BTreeMap<_, _> = entries.collect();
        // More names than a session has handles: some are wrong, and it is not known yet which.
        new.entries = union.into_iter().take(max_entries).collect();
        new.poses = new.poses.saturating_add(old.poses);
    }
}
