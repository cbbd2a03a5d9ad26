//! Clips drive models: bones follow, frames do not depend on what else is solved, twists are spread.

mod arm;
mod blocks;
mod feet;
mod follow;
mod parted;
mod walker;
