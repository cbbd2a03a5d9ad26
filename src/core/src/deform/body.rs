//! What a deformation works on whatever the handles are: the graph and its hierarchy.

use crate::deform::error::Error;
use crate::deform::second_pass::single_rest::SingleRest;
use crate::exec::Exec;
use crate::graph::{self, MeshGraph};
use crate::mesh::Mesh;
use crate::pool::Pool;
use crate::solver::{self, Hierarchy};
use glam::DVec3;
use rayon::prelude::*;
use std::sync::OnceLock;

pub use crate::graph::{EdgeWeights, TieFamilies, TieOptions};
pub use crate::solver::CoarseOperators;

/// When interior nodes are built.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum VolumeMode {
    /// Where the mesh has an inside, and the graph is not too large with it.
    #[default]
    Auto,
    /// Never.
    Off,
    /// Always; a mesh without an inside is refused.
    Required,
}

/// How a [`DeformableBody`] is built.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct BodyOptions {
    /// When interior nodes are built.
    pub volume: VolumeMode,
    /// Interior nodes: lattice interval, valence, shell offset, edge weights, most nodes.
    pub graph: graph::VolumeOptions,
    /// Operators of the hierarchy.
    pub operators: CoarseOperators,
    /// Whether parts of the mesh get no inside in common, as after a cut. Ties may join them all the same.
    pub apart: bool,
    /// How parts that touch are tied to each other; `None` leaves them to themselves.
    pub ties: Option<TieOptions>,
}

/// The graph of a mesh, its hierarchy, and the rest pose in the coordinates that solving uses.
///
/// Solving happens in centred coordinates of about unit size, scaled by a power of two: neither tiny nor huge models
/// lose digits, and going there and back changes no bit by scaling.
pub struct DeformableBody {
    /// The graph; its first nodes are the mesh's vertices.
    pub graph: MeshGraph,
    /// The multigrid hierarchy over all nodes.
    pub hierarchy: Hierarchy,
    /// Rest positions and their Laplacian in single precision, once an animation asked for them.
    pub(in crate::deform) single: OnceLock<SingleRest>,
    /// Where solving coordinates have their origin, in model space.
    pub(in crate::deform) origin: DVec3,
    /// Model units of one solving unit; a power of two.
    pub(in crate::deform) unit: f64,
    /// Length of the mesh's bounding box diagonal, model units; above 0.
    pub diagonal: f64,
    /// Why there are no interior nodes although mode [`VolumeMode::Auto`] would have them: there would be too many, or finding them would take too long.
    pub too_large: Option<String>,
}

impl DeformableBody {
    /// Builds graph and hierarchy. Reports the stages "graph" and "hierarchy".
    ///
    /// # Errors
    /// [`Error::NoInside`] in mode [`VolumeMode::Required`]; [`Error::Graph`] for senseless options, and in that mode when
    /// the graph would be too large; [`Error::Cancelled`].
    pub fn build(mesh: &Mesh, options: &BodyOptions, exec: &Exec<'_>) -> Result<Self, Error> {
        exec.progress.report("graph", 0.0);
        let built = match options.volume {
            VolumeMode::Off => Ok(None),
            _ if options.apart => graph::volume_apart(mesh, &options.graph, exec),
            _ => graph::volume(mesh, &options.graph, exec),
        };
        let (volume, too_large) = match built {
            Ok(volume) => (volume, None),
            // What cannot be had with an inside can be had as a surface, unless the inside was asked for.
            Err(
                e @ (graph::Error::TooManyNodes { .. }
                | graph::Error::TooManyEdges { .. }
                | graph::Error::FacesTooLong { .. }),
            ) if options.volume == VolumeMode::Auto => (None, Some(e.to_string())),
            Err(e) => return Err(e.into()),
        };
        let graph = match volume {
            Some(graph) => graph,
            None if options.volume == VolumeMode::Required => return Err(Error::NoInside),
            None => graph::surface(mesh, options.graph.weights),
        };
        let graph = match &options.ties {
            Some(ties) => graph::tie_parts(graph, mesh, ties, exec)?,
            None => graph,
        };
        exec.check()?;

        let bounds = mesh.bounds();
        let diagonal = (bounds.max - bounds.min).length();
        let diagonal = if diagonal > 0.0 && diagonal.is_finite() {
            diagonal
        } else {
            1.0
        };
        let unit = power_of_two_near(diagonal);
        let origin = bounds.min + (bounds.max - bounds.min) * 0.5;
        let rest = exec.pool.install(|| place(&graph.positions, origin, unit));

        exec.progress.report("hierarchy", 0.0);
        let view = solver::WeightedGraph {
            offsets: &graph.offsets,
            neighbours: &graph.neighbours,
            weights: graph.weights.as_deref(),
            positions: Some(&rest),
        };
        let build = solver::BuildOptions {
            operators: options.operators,
            ..Default::default()
        };
        let hierarchy = Hierarchy::build(&view, &build, exec)?;
        Ok(Self {
            graph,
            hierarchy,
            single: OnceLock::new(),
            origin,
            unit,
            diagonal,
            too_large,
        })
    }

    /// Number of graph nodes.
    pub fn nodes(&self) -> usize {
        self.graph.positions.len()
    }

    /// Rest position of a node in the coordinates that solving uses. It is not kept: it comes of the one in model space at once.
    #[inline(always)]
    pub fn rest(&self, node: usize) -> DVec3 {
        self.solving_from_model(self.graph.positions[node])
    }

    /// The same of all nodes.
    pub fn rest_of_all(&self, pool: &Pool) -> Vec<[f64; 3]> {
        pool.install(|| place(&self.graph.positions, self.origin, self.unit))
    }

    /// Model units of one unit of the coordinates that solving uses.
    pub fn unit(&self) -> f64 {
        self.unit
    }

    /// Rest positions and their Laplacian in single precision; made when first asked for.
    pub(in crate::deform) fn single_rest(&self) -> &SingleRest {
        (self.single).get_or_init(|| SingleRest::of(self.nodes(), |i| self.rest(i), |i| self.laplacian(i)))
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.graph.byte_size() + self.hierarchy.byte_size() + self.single.get().map_or(0, SingleRest::byte_size)
    }

    /// From model space to solving coordinates.
    #[inline(always)]
    pub(in crate::deform) fn solving_from_model(&self, p: DVec3) -> DVec3 {
        (p - self.origin) / self.unit
    }

    /// From solving coordinates to model space.
    pub(in crate::deform) fn model_from_solving(&self, p: DVec3) -> DVec3 {
        p * self.unit + self.origin
    }

    /// Σ w (p_i − p_j) over the neighbours of a node, solving coordinates: the first sum of equation (8)'s right-hand side.
    pub(in crate::deform) fn laplacian(&self, node: usize) -> DVec3 {
        let here = self.rest(node);
        self.edges(node).map(|(j, w)| w * (here - self.rest(j))).sum()
    }

    /// Neighbours of a node with the weights of the edges.
    pub(in crate::deform) fn edges(&self, node: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let row = self.graph.offsets[node] as usize..self.graph.offsets[node + 1] as usize;
        let weights = self.graph.weights.as_deref();
        row.map(move |e| {
            (
                self.graph.neighbours[e] as usize,
                weights.map_or(1.0, |w| f64::from(w[e])),
            )
        })
    }
}

fn power_of_two_near(length: f64) -> f64 {
    libm::exp2(libm::floor(libm::log2(length)).clamp(-900.0, 900.0))
}

/// Model space to solving coordinates.
pub(in crate::deform) fn place(positions: &[DVec3], origin: DVec3, unit: f64) -> Vec<[f64; 3]> {
    let to_solving = |p: &DVec3| ((*p - origin) / unit).to_array();
    positions.par_iter().map(to_solving).collect()
}
