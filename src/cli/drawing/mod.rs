//! What the pictures of `pliant render` and `pliant animate` have in common: views, shapes in their own look, colours that stand for
//! numbers, and places seen from near by.

mod close_up;
mod heat;
mod shape;
mod views;

pub(super) use close_up::{CloseUp, SeenShape, bounds_of, parse_close_up};
pub(super) use heat::{Contacts, crossing_words, crossings_by_triangle, heat_colours};
pub(super) use shape::{DrawnShape, NormalChoice};
pub(super) use views::{UpAxisChoice, ViewList, parse_size, parse_views};
