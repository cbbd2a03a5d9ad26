//! A shape to adopt that comes in parts, because it is larger than a message may be.

use crate::error::Error;
use crate::task::commands::reserve_more;
use crate::task::session_task::SessionTask;
use pliant_wire::{SessionEdit, pb};
use std::ops::ControlFlow;

/// Bytes of memory that a vertex of a part takes: as it came, and as it is read.
const BYTES_PER_VERTEX: u64 = 24;

/// The parts that have come so far, as one edit.
pub(crate) struct AdoptedParts {
    edit: SessionEdit,
    /// The session's revision when they came: they are of no use after another change.
    revision: u64,
}

impl AdoptedParts {
    pub fn byte_size(&self) -> u64 {
        BYTES_PER_VERTEX * self.edit.adopted_vertices() as u64
    }
}

impl SessionTask {
    /// The edit to carry out, with the parts before it; or the answer to one that waits for more parts.
    ///
    /// # Errors
    /// A part that does not begin where those before it end, or more vertices than the model has. Parts are then dropped.
    pub fn join_parts(&mut self, edit: SessionEdit) -> Result<ControlFlow<pb::EditResult, SessionEdit>, Error> {
        let revision = self.history.revision();
        let before = self.adopted_parts.take().filter(|parts| parts.revision == revision);
        let edit = match before {
            Some(parts) if edit.is_later_part() => parts.edit.join(edit)?,
            _ => {
                edit.check_first(0)?;
                edit
            }
        };
        if !edit.is_part {
            return Ok(ControlFlow::Continue(edit));
        }
        let (seen, most) = (edit.adopted_vertices(), self.history.current().vertices() as usize);
        if seen > most {
            let problem = format!("has {seen} vertices with the parts before, but the model has {most}");
            return Err(pliant_wire::Error::invalid("adopt.positions", problem).into());
        }
        reserve_more(self, BYTES_PER_VERTEX * seen as u64, "keeping the parts of a shape")?;
        self.adopted_parts = Some(AdoptedParts { edit, revision });
        Ok(ControlFlow::Break(pb::EditResult {
            revision,
            ..Default::default()
        }))
    }
}
