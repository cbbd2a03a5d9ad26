//! The volume graph of a mesh: surface, shell and lattice (Zhou et al. 2005).
//!
//! `build` runs the stages in order: `solid` finds which parts enclose space, `caps` closes their holes, `shell` moves
//! copies of vertices inwards, `lattice` (by `scan` or as an octree) fills the inside with nodes of the `lattice_grid`
//! and joins them, and `placing` gives each of them its vertex. `placing` makes the paper's graph, `shape` the one that
//! follows the shape: `principal_axes` gives the axes of its lattice, and `spread` ties the surface to it and joins what
//! is too thin for it.

pub(in crate::graph) mod build;
pub(super) mod caps;
mod lattice;
pub(super) mod lattice_grid;
mod placing;
mod principal_axes;
mod scan;
mod shape;
pub(super) mod shell;
pub(super) mod solid;
pub(super) mod spread;

pub use build::{estimate_nodes, volume, volume_apart};
pub use principal_axes::principal_axes;

use crate::Error;
use crate::graph::mesh_graph::EdgeWeights;

/// What interior nodes follow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum InteriorKind {
    /// The shape: a lattice whose interval follows the thickness of each part, whatever its triangles, along the principal
    /// axes of the mesh. Places too thin for it have struts across.
    #[default]
    Shape,
    /// The triangles, as in the paper: a copy of each vertex, and a lattice about as dense as the mesh, along the axes of the
    /// file.
    Paper,
}

/// How a volume graph is built.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumeOptions {
    /// What interior nodes follow.
    pub kind: InteriorKind,
    /// Side of a lattice cell. By default, of kind [`InteriorKind::Shape`], ¾ of volume ÷ area of each part; of kind
    /// [`InteriorKind::Paper`] the mean edge length or what gives 1.2 lattice nodes for each vertex, whichever is larger.
    /// Widened when the graph would have more than `max_nodes` nodes.
    pub interval: Option<f64>,
    /// Neighbours of a lattice node: 14 (default), or 8 in the other of the two cubic grids only.
    pub valence: u32,
    /// Of kind [`InteriorKind::Paper`], how far the shell is moved inwards; by default the mean edge length, of the mesh or of the part, whichever is
    /// less. Less where there is less room.
    pub shell_offset: Option<f64>,
    /// Weights of the mesh's edges.
    pub weights: EdgeWeights,
    /// Of kind [`InteriorKind::Shape`], what edges inside weigh relative to the default, 1e-3 to 1e3. With less, the mesh's edges
    /// keep their lengths better, and sections collapse in bends.
    pub stiffness: f64,
    /// Most nodes that the graph may have.
    pub max_nodes: usize,
    /// Of kind [`InteriorKind::Shape`], whether [`resample`](crate::graph::resample()) follows an edit of the mesh.
    pub follows_edits: bool,
}

impl Default for VolumeOptions {
    fn default() -> Self {
        Self {
            kind: InteriorKind::Shape,
            interval: None,
            valence: 14,
            shell_offset: None,
            weights: EdgeWeights::default(),
            stiffness: 1.0,
            max_nodes: 50_000_000,
            follows_edits: true,
        }
    }
}

impl VolumeOptions {
    /// The paper's graph with the paper's weights.
    pub fn paper() -> Self {
        Self {
            kind: InteriorKind::Paper,
            weights: EdgeWeights::Uniform,
            ..Self::default()
        }
    }

    /// Refuses options that make no sense.
    pub(in crate::graph) fn check(&self) -> Result<(), Error> {
        Error::check_length("interval", self.interval)?;
        Error::check_length("shell offset", self.shell_offset)?;
        if !(1e-3..=1e3).contains(&self.stiffness) {
            let seen = self.stiffness;
            return Err(Error::invalid(
                "stiffness",
                format!("is {seen}, allowed are 1e-3 to 1e3"),
            ));
        }
        match self.valence {
            8 | 14 => Ok(()),
            seen => Err(Error::invalid("valence", format!("is {seen}, allowed are 14 and 8"))),
        }
    }
}
