//! Topology-changing operations, which this version reads and refuses by name.

use crate::job::pb::{EditRequest, edit_request::Operation};
use crate::session::{Code, Error};

/// Why an edit is not carried out: unimplemented by name, or no operation at all.
pub(super) fn refusal(request: &EditRequest) -> Error {
    let name = match &request.operation {
        None => {
            let allowed = "cut, subdivide, decimate, delete, fill, remesh, merge, insertCurve and weld";
            return Error::invalid("operation", format!("is missing; the contract knows {allowed}"));
        }
        Some(Operation::Cut(_)) => "cut",
        Some(Operation::Subdivide(_)) => "subdivide",
        Some(Operation::Decimate(_)) => "decimate",
        Some(Operation::Delete(_)) => "delete",
        Some(Operation::Fill(_)) => "fill",
        Some(Operation::Remesh(_)) => "remesh",
        Some(Operation::Merge(_)) => "merge",
        Some(Operation::InsertCurve(_)) => "insertCurve",
        Some(Operation::Weld(_)) => "weld",
    };
    Error::new(
        Code::Unimplemented,
        format!("the edit {name} is not implemented by this version"),
    )
}
