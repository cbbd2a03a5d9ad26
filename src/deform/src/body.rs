//! What a deformation works on whatever the handles are: the graph and its hierarchy.
//!
//! After an edit of its mesh a body follows in time proportional to the edit: the graph is resampled around the change, the
//! hierarchy is repaired.

use crate::error::Error;
use glam::{DVec3, Vec3A};
use pliant_exec::Exec;
use pliant_exec::pool::Pool;
use pliant_mesh::graph;
pub use pliant_mesh::graph::{EdgeWeights, TieFamilies, TieOptions};
use pliant_mesh::graph::{MeshChange, MeshGraph};
use pliant_mesh::{BoundingBox, Mesh};
pub use pliant_solver::CoarseOperators;
use pliant_solver::Hierarchy;
use rayon::prelude::*;
use std::ops::RangeInclusive;
use std::sync::OnceLock;

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
    /// Whether a mesh [far from the origin](BoundingBox::is_far) gets the graph that it has near the origin.
    pub near_origin: bool,
    /// Whether fields of more than [`MOST_WHOLE_FIELDS`](crate::MOST_WHOLE_FIELDS) handles are solved each around its handle.
    pub local_fields: bool,
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
    pub(crate) single: OnceLock<SingleRest>,
    /// Where solving coordinates have their origin, in model space.
    pub(crate) origin: DVec3,
    /// Model units of one solving unit; a power of two.
    pub(crate) unit: f64,
    /// Length of the mesh's bounding box diagonal, model units; above 0.
    pub diagonal: f64,
    /// Why there are no interior nodes although mode [`VolumeMode::Auto`] would have them: there would be too many, or finding them would take too long.
    pub too_large: Option<String>,
    /// See [`BodyOptions::local_fields`].
    pub local_fields: bool,
}

impl DeformableBody {
    /// Builds graph and hierarchy. Reports the stages "graph" and "hierarchy".
    ///
    /// # Errors
    /// [`Error::NoInside`] in mode [`VolumeMode::Required`]; [`Error::Graph`] for senseless options, and in that mode when
    /// the graph would be too large; [`Error::Cancelled`].
    pub fn build(mesh: &Mesh, options: &BodyOptions, exec: &Exec<'_>) -> Result<Self, Error> {
        let bounds = mesh.bounds();
        if !(options.near_origin && bounds.is_far()) {
            return Self::build_here(mesh, options, exec);
        }
        let mut near = mesh.clone();
        near.positions = bounds.near_origin(&mesh.positions);
        let mut body = Self::build_here(&near, options, exec)?;
        body.graph.move_nodes(&mesh.positions, bounds.center());
        body.origin += bounds.center();
        Ok(body)
    }

    fn build_here(mesh: &Mesh, options: &BodyOptions, exec: &Exec<'_>) -> Result<Self, Error> {
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
                e @ (pliant_mesh::Error::TooManyNodes { .. }
                | pliant_mesh::Error::TooManyEdges { .. }
                | pliant_mesh::Error::FacesTooLong { .. }),
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
        let view = solver_view(&graph, &rest);
        let build = pliant_solver::BuildOptions {
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
            local_fields: options.local_fields,
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
    pub(crate) fn single_rest(&self) -> &SingleRest {
        (self.single).get_or_init(|| SingleRest::of(self.nodes(), |i| self.rest(i), |i| self.laplacian(i)))
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        self.graph.byte_size() + self.hierarchy.byte_size() + self.single.get().map_or(0, SingleRest::byte_size)
    }

    /// From model space to solving coordinates.
    #[inline(always)]
    pub fn solving_from_model(&self, p: DVec3) -> DVec3 {
        (p - self.origin) / self.unit
    }

    /// From solving coordinates to model space.
    pub fn model_from_solving(&self, p: DVec3) -> DVec3 {
        p * self.unit + self.origin
    }

    /// Σ w (p_i − p_j) over the neighbours of a node, solving coordinates: the first sum of equation (8)'s right-hand side.
    pub(crate) fn laplacian(&self, node: usize) -> DVec3 {
        let here = self.rest(node);
        self.edges(node).map(|(j, w)| w * (here - self.rest(j))).sum()
    }

    /// Neighbours of a node with the weights of the edges.
    pub fn edges(&self, node: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
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

/// A graph as the solver reads it, with rest positions in solving coordinates.
fn solver_view<'a>(graph: &'a MeshGraph, rest: &'a [[f64; 3]]) -> pliant_solver::WeightedGraph<'a> {
    pliant_solver::WeightedGraph {
        offsets: &graph.offsets,
        neighbours: &graph.neighbours,
        weights: graph.weights.as_deref(),
        positions: Some(rest),
    }
}

fn power_of_two_near(length: f64) -> f64 {
    libm::exp2(libm::floor(libm::log2(length)).clamp(-900.0, 900.0))
}

/// Model space to solving coordinates.
pub(crate) fn place(positions: &[DVec3], origin: DVec3, unit: f64) -> Vec<[f64; 3]> {
    let to_solving = |p: &DVec3| ((*p - origin) / unit).to_array();
    positions.par_iter().map(to_solving).collect()
}

/// A followed body keeps solving coordinates while the mesh's diagonal is this many units long,
const LENGTHS: RangeInclusive<f64> = 0.125..=8.0;
/// and its middle within so many units of their origin.
const FARTHEST: f64 = 8.0;

/// Lattice edges that a deformation has stretched or squeezed beyond this share of their rest length are strained.
const STRAIN: RangeInclusive<f64> = 0.6..=1.6;
/// A lattice with more than this part of its edges strained is not worth keeping.
const MOST_STRAINED: f64 = 0.05;
/// One of so many lattice nodes is tested.
const SAMPLE: usize = 8;

impl DeformableBody {
    /// The body of the mesh after `change`; `None` where a new one has to be built: where [`graph::resample`] says so,
    /// when the mesh has grown or moved out of the solving coordinates, or when a deformation has strained the lattice.
    ///
    /// `moved` has all nodes, in model space, where a deformation that has become the rest shape left them; `None` when
    /// the rest shape was edited. `ties` are those of the body, with the families of the vertices after the edit. Edges
    /// keep their weights but around the change. The result depends on the arguments alone. Reports the stages "graph"
    /// and "hierarchy".
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn follow(
        &self,
        change: &MeshChange<'_>,
        moved: Option<&[DVec3]>,
        ties: Option<&TieOptions>,
        exec: &Exec<'_>,
    ) -> Result<Option<DeformableBody>, Error> {
        exec.progress.report("graph", 0.0);
        let bounds = exec.pool.install(|| bounds(change.positions));
        let middle = bounds.min + (bounds.max - bounds.min) * 0.5;
        let lost = !LENGTHS.contains(&((bounds.max - bounds.min).length() / self.unit))
            || (middle - self.origin).length() > FARTHEST * self.unit;
        let is_strained = |m: &[DVec3]| m.len() != self.nodes() || exec.pool.install(|| self.is_strained(m));
        if lost || moved.is_some_and(is_strained) {
            return Ok(None);
        }
        let at = moved.unwrap_or(&self.graph.positions);
        let is_worn = self.hierarchy.is_worn();
        // Much of a graph's change takes one thread. A copy of the hierarchy, which knows nothing of it, has work for the others.
        let (resampled, hierarchy) = exec.pool.install(|| {
            rayon::join(
                || graph::resample_tied(&self.graph, at, change, ties, exec),
                || (!is_worn).then(|| self.hierarchy.clone_in_parallel(exec.pool)),
            )
        });
        let Some(resampled) = resampled? else {
            return Ok(None);
        };
        let graph = resampled.graph;
        let rest = exec.pool.install(|| place(&graph.positions, self.origin, self.unit));

        exec.check()?;
        exec.progress.report("hierarchy", 0.0);
        let view = solver_view(&graph, &rest);
        let hierarchy = match hierarchy {
            None => Hierarchy::build(&view, self.hierarchy.options(), exec)?,
            Some(mut hierarchy) => {
                let change = pliant_solver::GraphChange {
                    new_from_old: &resampled.new_from_old,
                    touched: &resampled.touched,
                };
                hierarchy.repair(&view, &change, exec)?;
                hierarchy
            }
        };
        Ok(Some(Self {
            diagonal: self.diagonal_of(&bounds),
            too_large: self.too_large.clone(),
            local_fields: self.local_fields,
            hierarchy,
            single: Default::default(),
            origin: self.origin,
            unit: self.unit,
            graph,
        }))
    }

    fn diagonal_of(&self, bounds: &BoundingBox) -> f64 {
        match (bounds.max - bounds.min).length() {
            length if length > 0.0 => length,
            _ => self.diagonal,
        }
    }

    /// Whether a deformation has strained too many edges of the lattice.
    fn is_strained(&self, moved: &[DVec3]) -> bool {
        let lattice = self.graph.surface + self.graph.stats.shell_nodes;
        let edges_of = |node: usize| {
            let (mut all, mut strained) = (0usize, 0usize);
            for &other in self.graph.row(node as u32) {
                let other = other as usize;
                if other < lattice {
                    continue;
                }
                let before = self.graph.positions[node].distance_squared(self.graph.positions[other]);
                let now = moved[node].distance_squared(moved[other]);
                let (least, most) = (STRAIN.start(), STRAIN.end());
                all += 1;
                strained += usize::from(!(least * least * before..=most * most * before).contains(&now));
            }
            (all, strained)
        };
        let nodes = (lattice..self.nodes())
            .into_par_iter()
            .step_by(SAMPLE)
            .with_min_len(1024);
        let (all, strained) = nodes.map(edges_of).reduce(|| (0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        strained as f64 > MOST_STRAINED * all as f64
    }
}

fn bounds(positions: &[DVec3]) -> BoundingBox {
    const BLOCK: usize = 1 << 15;
    let parts: Vec<BoundingBox> = positions.par_chunks(BLOCK).map(BoundingBox::of).collect();
    let corners: Vec<DVec3> = parts.iter().flat_map(|b| [b.min, b.max]).collect();
    BoundingBox::of(&corners)
}

/// Rest positions and their Laplacian in single precision, solving coordinates.
#[derive(Debug)]
pub(crate) struct SingleRest {
    pub(crate) positions: Vec<Vec3A>,
    pub(crate) laplacian: Vec<Vec3A>,
}

impl SingleRest {
    /// `position` and `laplacian` return those of a node.
    pub(crate) fn of(nodes: usize, position: impl Fn(usize) -> DVec3, laplacian: impl Fn(usize) -> DVec3) -> Self {
        // One thread: a thread that waits for others here could be handed work that waits for this.
        Self {
            positions: (0..nodes).map(|i| position(i).as_vec3a()).collect(),
            laplacian: (0..nodes).map(|i| laplacian(i).as_vec3a()).collect(),
        }
    }

    pub(crate) fn byte_size(&self) -> usize {
        (self.positions.capacity() + self.laplacian.capacity()) * size_of::<Vec3A>()
    }
}
