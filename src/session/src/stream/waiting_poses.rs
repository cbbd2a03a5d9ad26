//! Poses that wait on a stream: which are merged, and which targets of vertices newer ones replace.

use pliant_core::engine::{HandlePose, VertexTargets};
use pliant_wire::{DeformOptions, Error as WireError, PoseKey};
use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

/// Drag poses that wait one by one; more are merged, oldest first.
pub(crate) const WAITING_DRAGS: usize = 64;

/// Poses by handle.
pub(crate) type DraggedPoses = BTreeMap<String, HandlePose>;

/// The handles that a pose names, each with its pose, or with the error that the stream reports at the pose's turn.
pub(crate) type PoseEntries = Vec<(String, Result<HandlePose, WireError>)>;

/// A pose that waits to be solved.
#[derive(Debug, Clone)]
pub(crate) struct WaitingPose {
    pub seq: u64,
    pub entries: PoseEntries,
    pub commit: bool,
    /// A part of the next pose.
    pub more: bool,
    /// Of a commit that may be sent again.
    pub key: Option<PoseKey>,
    /// The options in force when it came.
    pub settings: Arc<DeformOptions>,
    /// Poses that it stands for, itself included; more than one only when poses had to be merged.
    pub poses: u32,
}

/// Merges the oldest neighbouring drags while too much waits. Errors then do not name the drag.
pub(crate) fn merge_waiting_drags(waiting: &mut VecDeque<WaitingPose>, max_entries: usize) {
    let most = 2 * max_entries + WAITING_DRAGS;
    loop {
        let drags = waiting.iter().filter(|w| !w.commit);
        let (count, entries) = drags.fold((0, 0), |(n, e), w| (n + 1, e + w.entries.len()));
        if count <= WAITING_DRAGS && entries <= most {
            return;
        }
        let mut pairs = waiting.iter().zip(waiting.iter().skip(1));
        let may_merge = |pose: &WaitingPose| !pose.commit && !stays_apart(pose);
        let Some(at) = pairs.position(|(a, b)| may_merge(a) && may_merge(b)) else {
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

/// Poses that wait and cannot be merged, for they are parts of others or have targets: so many at most.
pub(crate) const WAITING_PARTS: usize = 1024;

/// Bytes of all targets that wait, or are dragged.
pub(crate) fn target_bytes(waiting: &VecDeque<WaitingPose>, dragged: &DraggedPoses) -> u64 {
    let waiting = waiting.iter().flat_map(|pose| &pose.entries);
    let waiting = waiting.filter_map(|(_, pose)| pose.as_ref().ok());
    let bytes: usize = waiting.chain(dragged.values()).map(HandlePose::target_bytes).sum();
    bytes as u64
}

/// Whether a pose has to stay as it is, because it is a part of another or has targets.
pub(crate) fn stays_apart(pose: &WaitingPose) -> bool {
    let has_targets =
        |entry: &(String, Result<HandlePose, WireError>)| entry.1.as_ref().is_ok_and(|pose| pose.targets.is_some());
    pose.more || pose.entries.iter().any(has_targets)
}

/// Takes from the drags that wait last what `newer` replaces: positions of all vertices of a handle, as many as before. Weights
/// and normals that it does not have stay.
pub(crate) fn drop_replaced(waiting: &mut VecDeque<WaitingPose>, newer: &WaitingPose) {
    let whole = |pose: &HandlePose| (pose.targets.clone()).filter(|t| t.first.is_none() && !t.positions.is_empty());
    for (id, pose) in &newer.entries {
        let Some(new) = pose.as_ref().ok().and_then(whole) else {
            continue;
        };
        for drag in waiting.iter_mut().rev().take_while(|w| !w.commit && !w.more) {
            let Some(at) = drag.entries.iter().position(|entry| entry.0 == *id) else {
                continue;
            };
            let old = drag.entries[at].1.as_ref().ok().and_then(whole);
            let Some(old) = old.filter(|old| old.positions.len() == new.positions.len()) else {
                break;
            };
            let has_weights = old.weights.is_empty() || !new.weights.is_empty();
            let has_normals = old.normals.is_empty() || !new.normals.is_empty();
            if has_weights && has_normals {
                drop(drag.entries.remove(at));
                continue;
            }
            let left = VertexTargets {
                positions: Vec::new(),
                ..VertexTargets::clone(&old)
            };
            drag.entries[at].1 = Ok(HandlePose {
                targets: Some(Arc::new(left)),
                ..HandlePose::default()
            });
        }
    }
}
