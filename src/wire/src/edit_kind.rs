//! The names of edits in JSON.

use pliant_core::engine::EditKind;

/// Returns the JSON name of a kind of edit.
pub fn edit_kind_name(kind: EditKind) -> &'static str {
    match kind {
        EditKind::Cut => "cut",
        EditKind::Subdivide => "subdivide",
        EditKind::Decimate => "decimate",
        EditKind::Delete => "delete",
        EditKind::Fill => "fill",
        EditKind::Remesh => "remesh",
        EditKind::Merge => "merge",
        EditKind::InsertCurve => "insertCurve",
        EditKind::Weld => "weld",
    }
}
