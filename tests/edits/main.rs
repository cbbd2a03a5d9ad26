//! Edits of the topology: the operations, the attributes that follow them, and long sequences of them.

mod attributes;
mod attributes_text;
mod cleaning;
mod commands;
mod cut;
mod cut_hostile;
mod dragon;
mod edit_support;
mod field_kept;
mod field_rows;
mod map_coordinates;
mod marathon;
mod named_numbers;
mod no_numbers;
mod nothing_lost;
mod remesh;
mod soups;
mod statue;
#[path = "../support/mod.rs"]
mod support;
mod sweep;
