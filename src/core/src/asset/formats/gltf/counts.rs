//! What there is in a document that can follow its model's shape.

use super::document::GltfDocument;
use super::read::GltfNotes;
use super::rig::moves_nodes;
use super::skin::joint_nodes;
use super::targets::TargetTally;
use crate::asset::FollowedCounts;

/// The joints of a document, and those of its clips that move nodes; others have nothing that could follow.
pub(super) fn followable<'t>(doc: &GltfDocument<'_>, clips: impl IntoIterator<Item = &'t str>) -> FollowedCounts {
    let clips = clips.into_iter().filter(|text| moves_nodes(text)).count();
    let number = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
    FollowedCounts {
        joints: number(joint_nodes(doc).len()),
        clips: number(clips),
        ..FollowedCounts::default()
    }
}

/// The counts of a document that is returned unchanged.
pub(super) fn nothing_followed(doc: &GltfDocument<'_>, notes: &GltfNotes) -> FollowedCounts {
    let mut tally = TargetTally::default();
    for row in &notes.rows {
        tally.meet(0, row.node, &doc.meshes.values[row.mesh].primitives[row.primitive]);
    }
    let mut counts = followable(doc, doc.animations.iter().copied());
    tally.count_into(&mut counts);
    counts
}
