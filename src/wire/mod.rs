//! The wire: messages of the schema, their JSON, and what they mean as values of [`crate::engine`].
//!
//! Everything that a client can ask is a message of [`pb`]. This module is the only one that checks what clients send; a
//! refusal names the field as clients write it. It knows no session, no connection and no clock.

pub(crate) mod check;
mod create;
mod edit;
mod error;
mod expect;
pub mod frames;
pub mod json;
pub mod pb;

pub use check::DeformOptions;
pub(crate) use create::OpenOptions;
pub use edit::edit_name;
pub use error::Error;
