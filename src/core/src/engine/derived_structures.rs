//! Everything that follows from a model alone, whatever its handles: mesh, parts, graph and hierarchy.

use super::error::{ESTIMATED_MEMORY, Error};
use super::facts::{BYTES_PER_NODE, DeformerWarning, TieFacts, WarningPlace, interior_warnings, most_nodes, tie_facts};
use super::model_topology::ModelTopology;
use super::part_families::PartFamilies;
use super::riding::{RidingModel, RidingVertices};
use super::riding_frames::{PackedRiders, RidingFrames};
use super::settings::{DeformerLimits, OpenOptions};
use super::shape::TopologyId;
use super::topology_state::{LineageOrigin, MeshDelta, TopologyLineage, TopologyState};
use crate::asset::Model;
use crate::deform::{
    BodyOptions, DeformableBody, FaceSurroundings, LayerSides, NeedlesAndCaps, TieOptions, VolumeMode,
};
use crate::edit::PatchedSurface;
use crate::exec::Exec;
use crate::graph::estimate_nodes;
use crate::mesh::carry::CarrySurface;
use crate::mesh::{Adjacency, Components, Mesh, MeshReport, NONE, inspect};
use crate::pool::Pool;
use crate::progress::Cancelled;
use glam::DVec3;
use std::sync::{Arc, OnceLock};

/// Bytes that a render vertex with its triangles costs beside the graph.
const BYTES_PER_VERTEX: u64 = 500;

/// A model with its graph and hierarchy. Never changes.
pub(super) struct DerivedStructures {
    pub lineage: Arc<TopologyLineage>,
    pub mesh: Mesh,
    pub parts: Components,
    /// Which parts were one, so that they are not tied to each other.
    pub families: PartFamilies,
    pub body: DeformableBody,
    /// Needles and caps of the mesh.
    pub thin: NeedlesAndCaps,
    /// See [`DerivedStructures::framed_nodes`].
    framed_nodes: Vec<u32>,
    volume: VolumeMode,
    loose_vertices_ride: bool,
    riders_keep_sides: bool,
    report: OnceLock<MeshReport>,
    /// The rest surface, once points were carried along with it.
    carry: OnceLock<Arc<CarrySurface>>,
    /// The vertices that ride along, once a shape was solved, or why they cannot.
    riders: OnceLock<Result<RidingVertices, Error>>,
    /// The same packed for frames, once gradients were asked for.
    packed: OnceLock<PackedRiders>,
    ties: OnceLock<TieFacts>,
    /// What is around the surface's vertices, once faces of an animation turned over.
    pub surroundings: OnceLock<FaceSurroundings>,
    /// Which parts lie on which in the rest pose, once a commit kept them apart.
    layers: OnceLock<Arc<LayerSides>>,
}

/// What an edit made of a model.
pub(super) struct TopologyChange<'a> {
    pub topology: Arc<ModelTopology>,
    pub applied: &'a PatchedSurface,
    /// All nodes of the graph before, in the shape that was edited; `None` when that was the rest shape.
    pub nodes: Option<Arc<Vec<DVec3>>>,
    /// Whether the body may follow, or has to be built.
    pub follow: bool,
}

impl DerivedStructures {
    /// Builds everything from nothing.
    pub fn build(
        id: TopologyId,
        topology: Arc<ModelTopology>,
        options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        exec.progress.report("mesh", 0.0);
        let vertices = topology.rest.len() as u64;
        let files = topology.model.files.total_bytes();
        admit_bytes(vertices * BYTES_PER_VERTEX + files, limits, exec)?;
        let mesh = topology.mesh(options.weld)?;
        exec.check()?;

        let surface = mesh.positions.len();
        let nodes = match options.body.volume {
            VolumeMode::Off => surface,
            VolumeMode::Required => estimate_nodes(&mesh, options.body.graph.kind),
            // Without a wish for interior nodes they are what is left out where they do not fit.
            VolumeMode::Auto => estimate_nodes(&mesh, options.body.graph.kind)
                .min(most_nodes(beside_graph(&topology), limits))
                .max(surface),
        };
        admit_bytes(estimate(vertices, nodes as u64) + files, limits, exec)?;
        let parts = MeshParts::find_parts(&topology, &mesh, options)?;
        let body = DeformableBody::build(&mesh, &body_options(&topology, &parts.families, options, limits), exec)?;
        let thin = NeedlesAndCaps::find(&mesh, exec.pool);
        Ok(Self::new(
            Arc::new(TopologyLineage::from_built(id, topology)),
            mesh,
            thin,
            parts,
            body,
            options,
        ))
    }

    /// Everything after an edit: followed where it can be, else built from nothing.
    pub fn edited(
        &self,
        change: TopologyChange<'_>,
        id: TopologyId,
        options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        if change.follow && !change.topology.is_apart() && self.body.graph.follows_edits() {
            exec.progress.report("mesh", 0.0);
            let mesh = change.topology.mesh(options.weld)?;
            let at = change.nodes.as_deref().unwrap_or(&self.body.graph.positions);
            let at = &at[..self.mesh.positions.len()];
            let delta = MeshDelta::between_meshes(&self.mesh.triangles, at, &mesh, change.applied);
            let lists = delta.change_lists(&self.mesh.triangles);
            let moved = change.nodes.clone();
            let families = change.topology.edited.as_ref().map(|e| e.families.clone());
            let families = families.unwrap_or_default();
            let ties = tie_options(&families, options);
            // What there is to go back along costs no more than what it leads to.
            let step = self
                .lineage
                .past
                .followed_by(delta, moved, ties.clone(), self.body.byte_size() as u64);
            let followed = match step {
                None => None,
                Some(step) => {
                    let graph_change = lists.as_mesh_change(&mesh.positions, &mesh.triangles);
                    let nodes = change.nodes.as_ref().map(|n| n.as_slice());
                    let follow = || self.body.follow(&graph_change, nodes, ties.as_ref(), exec);
                    // Much of either takes one thread, and has work for the others now and then.
                    let found = || (parts_of(&mesh), NeedlesAndCaps::find(&mesh, exec.pool));
                    let ((parts, thin), followed) = exec.pool.install(|| rayon::join(found, follow));
                    let parts = MeshParts { parts, families };
                    followed?.map(|body| (step, body, (parts, thin)))
                }
            };
            if let Some((step, body, (parts, thin))) = followed {
                let vertices = change.topology.rest.len() as u64;
                let files = change.topology.model.files.total_bytes();
                admit_bytes(estimate(vertices, body.nodes() as u64) + files, limits, exec)?;
                let lineage = TopologyLineage {
                    id,
                    topology: change.topology,
                    past: LineageOrigin::Edited(step),
                };
                return Ok(Self::new(Arc::new(lineage), mesh, thin, parts, body, options));
            }
        }
        Self::build(id, change.topology, options, limits, exec)
    }

    /// What `state` leads to, again.
    pub fn retrace(
        state: &TopologyState,
        options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let path = &state.0;
        if let LineageOrigin::Edited(_) = path.past {
            let fit = |topology: &ModelTopology, mesh: &Mesh| {
                let families = MeshParts::find_parts(topology, mesh, options)?.families;
                Ok(body_options(topology, &families, options, limits))
            };
            let remade = path.past.retrace(options, &fit, exec)?;
            let remade = remade.ok_or_else(|| Error::Internal("an edit cannot be followed again".into()))?;
            let mesh = path.topology.mesh(options.weld)?;
            let parts = MeshParts::find_parts(&path.topology, &mesh, options)?;
            let thin = NeedlesAndCaps::find(&mesh, exec.pool);
            return Ok(Self::new(Arc::clone(path), mesh, thin, parts, remade.body, options));
        }
        Ok(Self {
            lineage: Arc::clone(path),
            ..Self::build(path.id, Arc::clone(&path.topology), options, limits, exec)?
        })
    }

    fn new(
        lineage: Arc<TopologyLineage>,
        mesh: Mesh,
        thin: NeedlesAndCaps,
        MeshParts { parts, families }: MeshParts,
        body: DeformableBody,
        options: &OpenOptions,
    ) -> Self {
        Self {
            framed_nodes: framed_nodes(&mesh, &thin),
            lineage,
            parts,
            thin,
            families,
            mesh,
            body,
            volume: options.body.volume,
            loose_vertices_ride: options.loose_vertices_ride,
            riders_keep_sides: options.riders_keep_sides,
            report: OnceLock::new(),
            carry: OnceLock::new(),
            riders: OnceLock::new(),
            packed: OnceLock::new(),
            ties: OnceLock::new(),
            surroundings: OnceLock::new(),
            layers: OnceLock::new(),
        }
    }

    /// The nodes by whose frames a shape is made, beside the positions of all, rising.
    pub fn framed_nodes(&self) -> &[u32] {
        &self.framed_nodes
    }

    /// The rest surface, ready to carry points; built on the first call.
    pub fn carry_surface(&self, pool: &Pool) -> &Arc<CarrySurface> {
        let build = || {
            let surface = CarrySurface::build(&self.mesh.positions, &self.mesh.triangles, pool);
            Arc::new(if self.riders_keep_sides {
                surface.with_sides()
            } else {
                surface
            })
        };
        self.carry.get_or_init(build)
    }

    /// Finds what the render vertices of passengers follow, where that is not known yet.
    ///
    /// # Errors
    /// [`Error::Precondition`] when that looks at too much, [`Error::TooLarge`] when it takes more memory than allowed,
    /// [`Error::Cancelled`].
    pub fn bind_riders(&self, limits: &DeformerLimits, exec: &Exec<'_>) -> Result<(), Error> {
        let topology = self.topology();
        let has_loose = self.loose_vertices_ride && self.mesh.solver_from_render.contains(&NONE);
        if !has_loose && !topology.has_passengers() {
            return Ok(());
        }
        let answer = |known: &Result<RidingVertices, Error>| known.as_ref().map(|_| ()).map_err(Error::clone);
        if let Some(known) = self.riders.get() {
            return answer(known);
        }
        let surface = self.carry_surface(exec.pool);
        let held = self.byte_size();
        let admit = |bytes: u64| admit_bytes(held + bytes, limits, exec);
        match RidingVertices::bind(surface, self.riding_model(), admit, exec) {
            // A later call may have more memory, and is not cancelled.
            Err(e @ (Error::TooLarge { .. } | Error::Cancelled)) => Err(e),
            // Another thread may have found the same meanwhile.
            found => answer(self.riders.get_or_init(|| found)),
        }
    }

    /// Which parts lie on which in the rest pose; kept where there is memory for it.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn layer_sides(&self, exec: &Exec<'_>) -> Result<Arc<LayerSides>, Cancelled> {
        if let Some(known) = self.layers.get() {
            return Ok(Arc::clone(known));
        }
        let parts = Components::of_triangles(self.mesh.positions.len(), &self.mesh.triangles);
        let found = Arc::new(LayerSides::at_rest(&self.mesh, parts.of_vertex, exec)?);
        match exec.progress.may_hold(self.byte_size() + found.byte_size() as u64) {
            // Another thread may have found the same meanwhile.
            true => Ok(Arc::clone(self.layers.get_or_init(|| found))),
            false => Ok(found),
        }
    }

    /// Packs what rides along for frames, where that is not done yet.
    ///
    /// # Errors
    /// Those of [`DerivedStructures::bind_riders`].
    pub fn pack_riders(&self, limits: &DeformerLimits, exec: &Exec<'_>) -> Result<RidingFrames<'_>, Error> {
        self.bind_riders(limits, exec)?;
        let surface = self.carry_surface(exec.pool);
        let riders = self.riding_vertices().map(|(_, riders)| riders);
        if self.packed.get().is_none() {
            admit_bytes(
                self.byte_size() + PackedRiders::estimate(&self.mesh, riders),
                limits,
                exec,
            )?;
            exec.check()?;
        }
        let pack = || PackedRiders::pack(surface, &self.mesh, riders, exec.pool);
        Ok(RidingFrames {
            surface,
            packed: self.packed.get_or_init(pack),
            riders,
        })
    }

    /// The model of which vertices ride along.
    pub fn riding_model(&self) -> RidingModel<'_> {
        let topology = self.topology();
        RidingModel {
            mesh: &self.mesh,
            primitives: &topology.geometry().primitives,
            rest: &topology.rest,
            loose: self.loose_vertices_ride,
            of_splats: topology.model.holds_splats(),
        }
    }

    /// The render vertices of passengers with what they follow; `None` where there are none, and before
    /// [`DerivedStructures::bind_riders`].
    pub fn riding_vertices(&self) -> Option<(&CarrySurface, &RidingVertices)> {
        Some((self.carry.get()?, self.riders.get()?.as_ref().ok()?))
    }

    pub fn topology(&self) -> &Arc<ModelTopology> {
        &self.lineage.topology
    }

    /// Whether graph and hierarchy have followed an edit, and were not built from nothing.
    pub fn is_followed(&self) -> bool {
        matches!(self.lineage.past, LineageOrigin::Edited(_))
    }

    /// What is to be said about the mesh; looked for when first asked.
    pub fn report(&self) -> &MeshReport {
        self.report.get_or_init(|| {
            let adjacency = Adjacency::build(self.mesh.positions.len(), &self.mesh.triangles);
            let mut report = inspect(&self.mesh, &adjacency);
            // What rides along is in no face of the mesh, and that is as it should be.
            report.unreferenced_vertices -= self.topology().passenger_vertices();
            if report.unreferenced_vertices == 0 {
                report.warnings.retain(|w| w.code != "unreferenced-vertex");
            }
            report
        })
    }

    /// What holds the parts together; looked for when first asked.
    pub fn tie_facts(&self) -> &TieFacts {
        let primitives = &self.topology().geometry().primitives;
        self.ties
            .get_or_init(|| tie_facts(&self.mesh, &self.parts, &self.body, primitives))
    }

    /// What the user should know about model, mesh and graph.
    pub fn warnings(&self) -> Vec<DeformerWarning> {
        let mut warnings = model_warnings(&self.topology().model, self.report());
        warnings.extend(interior_warnings(&self.body, self.volume));
        warnings.extend(self.riding_vertices().and_then(|(_, riders)| riders.warning()));
        warnings
    }

    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        let model = self.topology().model.files.total_bytes() + self.topology().byte_size();
        let past = match &self.lineage.past {
            LineageOrigin::Built(_) => 0,
            LineageOrigin::Edited(step) => step.byte_size(),
        };
        let parts = self.mesh.byte_size()
            + self.parts.of_vertex.capacity() * 4
            + self.thin.byte_size()
            + 4 * self.framed_nodes.capacity()
            + self.body.byte_size()
            + self.carry.get().map_or(0, |surface| surface.byte_size())
            + self
                .riders
                .get()
                .map_or(0, |r| r.as_ref().map_or(0, RidingVertices::byte_size))
            + self.packed.get().map_or(0, PackedRiders::byte_size)
            + self.surroundings.get().map_or(0, FaceSurroundings::byte_size)
            + self.layers.get().map_or(0, |layers| layers.byte_size());
        model + past + parts as u64
    }

    /// Bytes that a deformer of this model is expected to hold at most.
    pub fn estimate(&self) -> u64 {
        let topology = self.topology();
        estimate(topology.rest.len() as u64, self.body.nodes() as u64) + topology.model.files.total_bytes()
    }
}

/// The connected parts of a mesh, and which of them were one.
struct MeshParts {
    parts: Components,
    families: PartFamilies,
}

impl MeshParts {
    fn find_parts(topology: &ModelTopology, mesh: &Mesh, options: &OpenOptions) -> Result<Self, Error> {
        let parts = parts_of(mesh);
        let families = match &topology.edited {
            Some(edited) => edited.families.clone(),
            None => PartFamilies::of_model(mesh, &parts, &topology.geometry().primitives, &options.kept_apart)?,
        };
        Ok(Self { parts, families })
    }
}

/// The nodes whose frames render vertices beside their own and thin faces need, rising.
fn framed_nodes(mesh: &Mesh, thin: &NeedlesAndCaps) -> Vec<u32> {
    let beside = mesh.inexact_vertices.iter();
    let beside = beside.map(|&v| mesh.solver_from_render[v as usize]);
    let mut nodes: Vec<u32> = beside.chain(thin.framed_vertices()).collect();
    nodes.sort_unstable();
    nodes.dedup();
    nodes.shrink_to_fit();
    nodes
}

fn parts_of(mesh: &Mesh) -> Components {
    Components::of_triangles(mesh.positions.len(), &mesh.triangles)
}

/// How the parts of these families are tied to each other.
fn tie_options(families: &PartFamilies, options: &OpenOptions) -> Option<TieOptions> {
    options.body.ties.as_ref().map(|ties| TieOptions {
        families: families.tie_families(),
        ..ties.clone()
    })
}

/// How the body of a model is built within `limits`.
fn body_options(
    topology: &ModelTopology,
    families: &PartFamilies,
    options: &OpenOptions,
    limits: &DeformerLimits,
) -> BodyOptions {
    let ties = tie_options(families, options);
    let mut options = options.body.clone();
    options.apart = topology.is_apart();
    options.ties = ties;
    let most = &mut options.graph.max_nodes;
    *most = (*most).min(most_nodes(beside_graph(topology), limits));
    options
}

/// Bytes that a model costs beside its graph.
fn beside_graph(topology: &ModelTopology) -> u64 {
    topology.rest.len() as u64 * BYTES_PER_VERTEX + topology.model.files.total_bytes()
}

fn estimate(vertices: u64, nodes: u64) -> u64 {
    vertices * BYTES_PER_VERTEX + nodes * BYTES_PER_NODE
}

/// Refuses work that needs more bytes in total than the limits or its [`Progress`](crate::progress::Progress) allow.
pub(super) fn admit_bytes(bytes: u64, limits: &DeformerLimits, exec: &Exec<'_>) -> Result<(), Error> {
    if bytes <= limits.memory_bytes && exec.progress.may_hold(bytes) {
        return Ok(());
    }
    Err(Error::TooLarge {
        what: ESTIMATED_MEMORY,
        seen: bytes,
        limit: limits.memory_bytes,
    })
}

fn model_warnings(model: &Model, report: &MeshReport) -> Vec<DeformerWarning> {
    let read = model.warnings.iter();
    let read = read.map(|(code, message, place)| DeformerWarning::new(code, message, place));
    let found = report.warnings.iter();
    let found = found.map(|w| DeformerWarning {
        place: WarningPlace::Vertices {
            text: w.place.clone(),
            vertices: w.vertices.clone(),
        },
        ..DeformerWarning::new(w.code, &w.message, "")
    });
    read.chain(found).collect()
}
