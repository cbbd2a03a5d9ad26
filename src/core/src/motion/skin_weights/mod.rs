//! Weights that bind a mesh of any kind to the bones of a rig: soups, open surfaces and thousands of parts too.
//!
//! Heat that flows over the surface (bone heat, Baran and Popović 2007) never reaches parts that hang together with no other,
//! and needs a surface that is one. Here it flows through a lattice over the union of all parts: every cell that holds a
//! vertex, that a triangle passes or that lies inside (`occupied_cells`). Each is pulled to its nearest bone with a stiffness of
//! c / d², d in cells, and one solve on multigrid for all bones has the balance (`heat_columns`). Of a cell's weights
//! the few heaviest are kept, without a jump where another becomes heavier (`four_heaviest`), and smoothed where that took
//! something away. A vertex takes its weights from the cells around it. As each cell is pulled to some bone, no vertex is left
//! out.

mod four_heaviest;
mod heat_columns;

pub(super) use heat_columns::OccupiedCells;
pub use heat_columns::{SkinBone, SkinWeightError, SkinWeightOptions, skin_weights};
