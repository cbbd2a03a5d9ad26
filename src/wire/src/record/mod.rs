//! What a session's store keeps, as bytes: commits, how a model was opened, where its files are.
//!
//! The parts are messages of the schema, which only grows, in a few messages of this room alone; so a record that was written once
//! can be read by every later version. Everything is checked again when it is read: bytes of a disk are no better than bytes of
//! a client. Knows no database: where records lie, and that they are whole, is the store's.

mod commit;
mod messages;
mod options;

pub use commit::{AnsweredFrame, LoggedCommit};
pub use messages::{FileReferences, ShapeProbe};
pub use options::RecordedModel;
