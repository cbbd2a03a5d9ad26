//! A shape to adopt that comes in parts, because it is larger than a message may be.

use crate::error::Error;
use pliant_wire::SessionEdit;

/// Bytes of memory that a vertex of a part takes: as it came, and as it is read.
const BYTES_PER_VERTEX: u64 = 24;

/// The parts that have come so far, as one edit.
pub(crate) struct AdoptedParts {
    edit: SessionEdit,
    /// The session's revision when they came: they are of no use after another change.
    revision: u64,
}

impl AdoptedParts {
    /// An edit with the parts before it, which are taken. Those of another shape stay where they are until a first part or another
    /// edit comes.
    ///
    /// # Errors
    /// A part that does not begin where those before it end; more vertices than the model has.
    pub fn join(before: &mut Option<Self>, edit: SessionEdit, revision: u64, vertices: u32) -> Result<Self, Error> {
        let is_later = edit.is_later_part();
        let taken = before.take_if(|parts| !is_later || parts.edit.shape_in_parts() == edit.shape_in_parts());
        let before = taken.filter(|parts| parts.revision == revision && is_later);
        let edit = match before {
            Some(parts) => parts.edit.join(edit)?,
            None => {
                edit.check_first(0)?;
                edit
            }
        };
        let seen = edit.adopted_vertices();
        if edit.is_part && seen > vertices as usize {
            let problem = format!("has {seen} vertices with the parts before, but the model has {vertices}");
            return Err(pliant_wire::Error::invalid("adopt.positions", problem).into());
        }
        Ok(Self { edit, revision })
    }

    /// The edit; `Err` with the parts where more are to come.
    pub fn whole(self) -> Result<SessionEdit, Box<Self>> {
        match self.edit.is_part {
            true => Err(Box::new(self)),
            false => Ok(self.edit),
        }
    }

    pub fn byte_size(&self) -> u64 {
        BYTES_PER_VERTEX * self.edit.adopted_vertices() as u64
    }
}
