//! Names of edits as clients write them.

use super::pb;

/// The JSON name of an edit's operation.
pub fn edit_name(edit: &pb::EditRequest) -> &'static str {
    use pb::edit_request::Operation;
    match &edit.operation {
        Some(Operation::Cut(_)) => "cut",
        Some(Operation::Subdivide(_)) => "subdivide",
        Some(Operation::Decimate(_)) => "decimate",
        Some(Operation::Delete(_)) => "delete",
        Some(Operation::Fill(_)) => "fill",
        Some(Operation::Remesh(_)) => "remesh",
        Some(Operation::Merge(_)) => "merge",
        Some(Operation::InsertCurve(_)) => "insertCurve",
        Some(Operation::Weld(_)) => "weld",
        None => "none",
    }
}
