//! Everything that follows from a model alone, whatever its handles: mesh, parts, graph and hierarchy.

use super::deformer::DeformerLimits;
use super::interior::{self, BYTES_PER_NODE};
use super::mesh_delta::MeshDelta;
use super::model_topology::ModelTopology;
use super::topology_state::{KeptHandleFields, LineageOrigin, TopologyLineage, TopologyState};
use crate::asset::Model;
use crate::deform::{BodyOptions, DeformableBody, EditedBody, VolumeMode};
use crate::edit::PatchedSurface;
use crate::exec::Exec;
use crate::graph::estimate_nodes;
use crate::mesh::{Adjacency, Components, Mesh, MeshReport, inspect};
use crate::wire::OpenOptions;
use crate::wire::{Error, pb};
use glam::DVec3;
use std::sync::{Arc, OnceLock};

/// Bytes that a render vertex with its triangles costs beside the graph.
const BYTES_PER_VERTEX: u64 = 500;

/// A model with its graph and hierarchy. Never changes.
pub(super) struct DerivedStructures {
    pub path: Arc<TopologyLineage>,
    pub mesh: Mesh,
    pub parts: Components,
    pub body: DeformableBody,
    /// How the nodes of the graph came about when the body has followed an edit.
    pub followed: FollowedNodes,
    volume: VolumeMode,
    report: OnceLock<MeshReport>,
}

/// How the nodes of a graph that has followed an edit came about; empty when it was built.
#[derive(Debug, Default)]
pub(super) struct FollowedNodes {
    /// For each node its number before.
    pub old_from_new: Vec<u32>,
    /// FollowedNodes that changed, rising.
    pub touched: Vec<u32>,
}

/// What an edit made of a model.
pub(super) struct TopologyChange<'a> {
    pub foundation: Arc<ModelTopology>,
    pub applied: &'a PatchedSurface,
    /// All nodes of the graph before, in the shape that was edited; `None` when that was the rest shape.
    pub nodes: Option<Arc<Vec<DVec3>>>,
    /// Whether the body may follow, or has to be built.
    pub follow: bool,
    /// The handles that the edit carries over, with their fields before it.
    pub carried: Option<KeptHandleFields>,
}

impl DerivedStructures {
    /// Builds everything from nothing.
    pub fn build(
        foundation: Arc<ModelTopology>,
        choices: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        exec.progress.report("mesh", 0.0);
        let vertices = foundation.rest.len() as u64;
        let files = foundation.model.files.total_bytes();
        admit(vertices * BYTES_PER_VERTEX + files, limits)?;
        let mesh = foundation.mesh(choices.weld)?;
        exec.check()?;

        // Without a wish for interior nodes they are what may be left out to stay within the limits.
        let nodes = if choices.body.volume == VolumeMode::Required {
            estimate_nodes(&mesh)
        } else {
            mesh.positions.len()
        };
        admit(estimate(vertices, nodes as u64) + files, limits)?;
        let body = DeformableBody::build(&mesh, &options(&foundation, choices, limits), exec)?;
        let parts = parts_of(&mesh);
        Ok(Self::new(
            TopologyLineage::built(foundation),
            mesh,
            parts,
            body,
            FollowedNodes::default(),
            choices,
        ))
    }

    /// Everything after an edit: followed where it can be, else built from nothing.
    pub fn edited(
        &self,
        change: TopologyChange<'_>,
        choices: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        if change.follow && !change.foundation.is_apart() {
            exec.progress.report("mesh", 0.0);
            let mesh = change.foundation.mesh(choices.weld)?;
            let at = change.nodes.as_deref().unwrap_or(&self.body.graph.positions);
            let at = &at[..self.mesh.positions.len()];
            let delta = MeshDelta::between(&self.mesh.triangles, at, &mesh, change.applied);
            let lists = delta.lists(&self.mesh.triangles);
            let moved = change.nodes.clone();
            // What there is to go back along costs no more than what it leads to.
            let step = self.path.past.then(delta, moved, self.body.bytes() as u64);
            let followed = match step {
                None => None,
                Some(step) => {
                    let graph_change = lists.change(&mesh.positions, &mesh.triangles);
                    let nodes = change.nodes.as_ref().map(|n| n.as_slice());
                    // Finding the parts takes one thread; what follows has work for the others.
                    let (parts, followed) = exec
                        .pool
                        .install(|| rayon::join(|| parts_of(&mesh), || self.body.follow(&graph_change, nodes, exec)));
                    followed?.map(|followed| (step, followed, parts))
                }
            };
            if let Some((step, followed, parts)) = followed {
                let EditedBody {
                    body,
                    old_from_new,
                    touched,
                } = followed;
                let nodes = FollowedNodes { old_from_new, touched };
                let vertices = change.foundation.rest.len() as u64;
                let files = change.foundation.model.files.total_bytes();
                admit(estimate(vertices, body.nodes() as u64) + files, limits)?;
                let path = TopologyLineage {
                    foundation: change.foundation,
                    past: LineageOrigin::Edited(step),
                    restart: change.carried,
                };
                return Ok(Self::new(path, mesh, parts, body, nodes, choices));
            }
        }
        Self::build(change.foundation, choices, limits, exec)
    }

    /// What `trail` leads to, again.
    pub fn retrace(
        trail: &TopologyState,
        choices: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let path = &trail.0;
        if let LineageOrigin::Edited(_) = path.past {
            let fit = |foundation: &ModelTopology| options(foundation, choices, limits);
            let remade = path.past.retrace(choices, &fit, exec)?;
            let remade = remade.ok_or_else(|| Error::Internal("an edit cannot be followed again".into()))?;
            let mesh = path.foundation.mesh(choices.weld)?;
            let parts = parts_of(&mesh);
            return Ok(Self {
                path: Arc::clone(path),
                ..Self::new(
                    TopologyLineage::built(Arc::clone(&path.foundation)),
                    mesh,
                    parts,
                    remade.body,
                    remade.nodes,
                    choices,
                )
            });
        }
        Ok(Self {
            path: Arc::clone(path),
            ..Self::build(Arc::clone(&path.foundation), choices, limits, exec)?
        })
    }

    fn new(
        path: TopologyLineage,
        mesh: Mesh,
        parts: Components,
        body: DeformableBody,
        followed: FollowedNodes,
        choices: &OpenOptions,
    ) -> Self {
        Self {
            path: Arc::new(path),
            parts,
            mesh,
            body,
            followed,
            volume: choices.body.volume,
            report: OnceLock::new(),
        }
    }

    pub fn foundation(&self) -> &Arc<ModelTopology> {
        &self.path.foundation
    }

    /// Whether graph and hierarchy have followed an edit, and were not built from nothing.
    pub fn is_followed(&self) -> bool {
        matches!(self.path.past, LineageOrigin::Edited(_))
    }

    /// What is to be said about the mesh; looked for when first asked.
    pub fn report(&self) -> &MeshReport {
        self.report.get_or_init(|| {
            let adjacency = Adjacency::build(self.mesh.positions.len(), &self.mesh.triangles);
            inspect(&self.mesh, &adjacency)
        })
    }

    /// What the user should know about model, mesh and graph.
    pub fn warnings(&self) -> Vec<pb::Warning> {
        let mut warnings = warnings_of(&self.foundation().model, self.report());
        warnings.extend(interior::warnings(&self.body, self.volume));
        warnings
    }

    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        let model = self.foundation().model.files.total_bytes() + self.foundation().bytes();
        let past = match &self.path.past {
            LineageOrigin::Built(_) => 0,
            LineageOrigin::Edited(step) => step.bytes(),
        };
        let parts = self.mesh.bytes()
            + self.parts.of_vertex.capacity() * 4
            + (self.followed.old_from_new.capacity() + self.followed.touched.capacity()) * 4
            + self.body.bytes();
        model + past + parts as u64
    }

    /// Bytes that a bench for this model is expected to hold at most.
    pub fn estimate(&self) -> u64 {
        let foundation = self.foundation();
        estimate(foundation.rest.len() as u64, self.body.nodes() as u64) + foundation.model.files.total_bytes()
    }
}

fn parts_of(mesh: &Mesh) -> Components {
    Components::of_triangles(mesh.positions.len(), &mesh.triangles)
}

/// How the body of a model is built within `limits`.
fn options(foundation: &ModelTopology, choices: &OpenOptions, limits: &DeformerLimits) -> BodyOptions {
    let beside = foundation.rest.len() as u64 * BYTES_PER_VERTEX + foundation.model.files.total_bytes();
    let mut options = choices.body.clone();
    options.apart = foundation.is_apart();
    interior::fit(&mut options, beside, limits);
    options
}

fn estimate(vertices: u64, nodes: u64) -> u64 {
    vertices * BYTES_PER_VERTEX + nodes * BYTES_PER_NODE
}

pub(super) fn admit(bytes: u64, limits: &DeformerLimits) -> Result<(), Error> {
    if bytes <= limits.memory_bytes {
        return Ok(());
    }
    Err(Error::TooLarge {
        what: "the estimated memory of the session in bytes",
        seen: bytes,
        limit: limits.memory_bytes,
    })
}

fn warnings_of(model: &Model, report: &MeshReport) -> Vec<pb::Warning> {
    let read = model.warnings.iter().map(|(code, message, place)| pb::Warning {
        code: code.clone(),
        message: message.clone(),
        r#where: place.clone(),
    });
    let found = report.warnings.iter().map(|w| pb::Warning {
        code: w.code.into(),
        message: w.message.clone(),
        r#where: w.place.clone(),
    });
    read.chain(found).collect()
}
