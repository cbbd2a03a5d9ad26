//! Targets of vertices that wait on a stream: how many may, and which of them newer ones replace.

use crate::stream::mailbox::{DraggedPoses, WaitingPose};
use pliant_core::engine::{HandlePose, VertexTargets};
use pliant_wire::Error as WireError;
use std::collections::VecDeque;
use std::sync::Arc;

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
/// that it does not have stay.
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
            if old.weights.is_empty() || !new.weights.is_empty() {
                drop(drag.entries.remove(at));
                continue;
            }
            let weights = VertexTargets {
                positions: Vec::new(),
                ..VertexTargets::clone(&old)
            };
            drag.entries[at].1 = Ok(HandlePose {
                targets: Some(Arc::new(weights)),
                ..HandlePose::default()
            });
        }
    }
}
