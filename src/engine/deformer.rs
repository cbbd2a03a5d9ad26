//! One model on the bench: everything derived from it, its handles, and poses solved on request.

use super::derived_structures::{DerivedStructures, admit};
use super::handles::{HandlesBeforeEdit, ResolvedHandles, resolve_handles};
use super::model_topology::{ModelTopology, primitive};
use super::quality::quality;
use super::region::RegionContext;
use crate::asset::{self, FileSet, Format, Geometry, Model, WrittenFiles};
use crate::deform::{DeformableBody, FieldRestart, HandleSystem, SolveState};
use crate::exec::Exec;
use crate::mesh::{Mesh, MeshReport, self_intersections};
use crate::pool::Pool;
use crate::wire::OpenOptions;
use crate::wire::{Error, pb};
use glam::DVec3;
use std::sync::Arc;

/// What a bench may hold.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeformerLimits {
    /// Sizes of the model.
    pub model: asset::Limits,
    /// Bytes that the bench may hold; checked by estimate before anything large is allocated.
    pub memory_bytes: u64,
    /// Handles of one request.
    pub handles: usize,
}

impl Default for DeformerLimits {
    fn default() -> Self {
        Self {
            model: asset::Limits::default(),
            memory_bytes: 16 << 30,
            handles: 1024,
        }
    }
}

/// The pose of every handle in force, in the order of the handles. Cheap to clone.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandlePoses(pub Arc<Vec<pb::HandlePose>>);

/// A model with everything derived from it. One owner; solves need `&mut`.
pub struct Deformer {
    pub(super) derived: Arc<DerivedStructures>,
    pub(super) choices: OpenOptions,
    pub(super) limits: DeformerLimits,
    /// Bytes that it may hold after an edit. How a graph is built depends on `limits` alone, which never change.
    pub(super) room: u64,
    pub(super) handles: ResolvedHandles,
    pub(super) rig: Option<HandleSystem>,
    pub(super) state: SolveState,
    /// The shape that was committed last, and all nodes of the graph in it.
    pub(super) committed: Option<CommittedShape>,
    /// What it was before edits, and after those that were undone; the last one left comes last.
    past: Vec<Arc<DerivedStructures>>,
}

/// A shape, and all nodes of the graph in it.
pub(super) struct CommittedShape {
    pub positions: Arc<Vec<DVec3>>,
    pub nodes: Arc<Vec<DVec3>>,
}

/// Of how many states besides its own a bench keeps all that follows from them, so that undo and redo need not make it
/// again.
const KEPT: usize = 2;

impl Deformer {
    /// Reads a model and builds mesh, graph and hierarchy. Reports the stages "read", "mesh", "graph", "hierarchy" to
    /// `progress` as they start.
    ///
    /// # Errors
    /// [`Error::Asset`], [`Error::Invalid`] for options, [`Error::TooLarge`] when the estimate of what the bench would
    /// hold is above `limits`, [`Error::Cancelled`].
    pub fn open(
        files: FileSet,
        create: &pb::CreateOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let choices = OpenOptions::check(create)?;
        exec.progress.report("read", 0.0);
        let model = Model::read(files, choices.format, &limits.model)?;
        exec.check()?;
        let derived = DerivedStructures::build(Arc::new(ModelTopology::new(model)), &choices, limits, exec)?;
        Ok(Self {
            derived: Arc::new(derived),
            choices,
            limits: *limits,
            room: limits.memory_bytes,
            handles: ResolvedHandles::default(),
            rig: None,
            state: SolveState::default(),
            committed: None,
            past: Vec::new(),
        })
    }

    /// A bench on another state of the model, without handles. What follows from the present one is kept for the way back
    /// if there is room.
    pub(super) fn on(&self, derived: Arc<DerivedStructures>) -> Self {
        let mut past: Vec<Arc<DerivedStructures>> = self.past.clone();
        past.push(Arc::clone(&self.derived));
        past.retain(|d| !Arc::ptr_eq(&d.path, &derived.path));
        let mut room = self.room.saturating_sub(derived.bytes()) / 2;
        // From the last one on, as many as there is room for.
        let kept = (past.iter().rev().take(KEPT))
            .take_while(|d| {
                let fits = d.bytes() <= room;
                room = room.saturating_sub(d.bytes());
                fits
            })
            .count();
        past.drain(..past.len() - kept);
        Self {
            derived,
            choices: self.choices.clone(),
            limits: self.limits,
            room: self.room,
            handles: ResolvedHandles::default(),
            rig: None,
            state: SolveState::default(),
            committed: None,
            past,
        }
    }

    /// Says how many bytes the bench may hold after its next edit, at most those of its limits.
    pub fn limit_memory(&mut self, bytes: u64) {
        self.room = bytes.min(self.limits.memory_bytes);
    }

    /// A state that was left a short while ago.
    pub(super) fn kept(&self, path: &Arc<super::topology_state::TopologyLineage>) -> Option<Arc<DerivedStructures>> {
        self.past.iter().find(|d| Arc::ptr_eq(&d.path, path)).cloned()
    }

    /// Whether the nodes of the graph in this shape are known, as an edit of it needs.
    pub fn remembers(&self, shape: &Arc<Vec<DVec3>>) -> bool {
        Arc::ptr_eq(shape, self.rest()) || self.nodes_of(shape).is_some()
    }

    /// The nodes of the graph in a shape that was committed last.
    pub(super) fn nodes_of(&self, shape: &Arc<Vec<DVec3>>) -> Option<&Arc<Vec<DVec3>>> {
        let known = self.committed.as_ref().filter(|c| Arc::ptr_eq(&c.positions, shape));
        known.map(|c| &c.nodes)
    }

    fn foundation(&self) -> &Arc<ModelTopology> {
        self.derived.foundation()
    }

    fn mesh(&self) -> &Mesh {
        &self.derived.mesh
    }

    /// The model as it was read.
    pub fn model(&self) -> &Model {
        &self.foundation().model
    }

    /// Triangles, normals, tangents and primitives as they are now. Once edited, positions are those of [`Deformer::rest`]
    /// alone.
    pub fn geometry(&self) -> &Geometry {
        self.foundation().geometry()
    }

    /// The model at `positions` (one per render vertex) as files.
    ///
    /// # Errors
    /// Those of [`Model::write`].
    pub fn write(&self, positions: &[DVec3], format: Format) -> Result<WrittenFiles, Error> {
        self.foundation().write(positions, format)
    }

    /// What was found about the mesh.
    pub fn report(&self) -> &MeshReport {
        self.derived.report()
    }

    /// The graph and hierarchy.
    pub fn body(&self) -> &DeformableBody {
        &self.derived.body
    }

    /// The handles on the body, once set.
    pub fn rig(&self) -> Option<&HandleSystem> {
        self.rig.as_ref()
    }

    /// Positions at rest, one per render vertex.
    pub fn rest(&self) -> &Arc<Vec<DVec3>> {
        &self.foundation().rest
    }

    /// Length of the bounding box's diagonal.
    pub fn diagonal(&self) -> f64 {
        self.derived.body.diagonal
    }

    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        let committed = self.committed.as_ref().map_or(0, |c| size_of_val(c.nodes.as_slice()));
        let parts = self.rig.as_ref().map_or(0, HandleSystem::bytes) + self.state.bytes() + committed;
        // The files are one and the same.
        let files = self.model().files.total_bytes();
        let past: u64 = self.past.iter().map(|d| d.bytes().saturating_sub(files)).sum();
        self.derived.bytes() + past + parts as u64
    }

    /// Bytes that a bench for this model is expected to hold at most.
    pub fn estimate(&self) -> u64 {
        self.derived.estimate()
    }

    /// What a session answers about model, solver and handles; id, revision, times and limits are the caller's.
    pub fn facts(&self) -> pb::Session {
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let DerivedStructures { mesh, parts, body, .. } = self.derived.as_ref();
        let levels = body
            .hierarchy
            .level_sizes()
            .iter()
            .map(|l| pb::solver_facts::Level {
                vertices: count(l.vertices),
                edges: l.edges as u64,
            })
            .collect();
        pb::Session {
            primitives: self.geometry().primitives.iter().map(primitive).collect(),
            warnings: (self.derived.warnings().into_iter())
                .chain(self.handles.warnings.iter().cloned())
                .collect(),
            model: Some(pb::ModelFacts {
                format: self.model().format.name().into(),
                bytes: self.model().files.total_bytes(),
                sha256: self.foundation().sha256.to_string(),
                vertices: count(self.rest().len()),
                triangles: count(self.geometry().triangles.len()),
            }),
            solver: Some(pb::SolverFacts {
                solver_vertices: count(mesh.positions.len()),
                graph_vertices: count(body.nodes()),
                graph_edges: body.graph.neighbours.len() as u64 / 2,
                components: count(parts.count),
                levels,
                bytes: self.bytes(),
            }),
            handles: self.handle_facts(),
            ..Default::default()
        }
    }

    fn handle_facts(&self) -> Vec<pb::HandleFacts> {
        let handles = self.handles.request.handles.iter();
        handles
            .zip(self.handles.counts.iter().zip(&self.handles.centroids))
            .map(|(h, (&vertices, c))| pb::HandleFacts {
                id: h.id.clone(),
                vertices,
                centroid: c.to_array().to_vec(),
                pose: None,
            })
            .collect()
    }

    /// The handles in force.
    pub fn handles(&self) -> &pb::SetHandlesRequest {
        &self.handles.request
    }

    /// Replaces the handles and recomputes the first-pass fields (stage "fields"). On an error the old ones stay. An
    /// empty list takes all handles away.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the field, [`Error::Precondition`] when the handles leave the model without a place,
    /// [`Error::TooLarge`], [`Error::Cancelled`].
    pub fn set_handles(&mut self, request: &pb::SetHandlesRequest, exec: &Exec<'_>) -> Result<(), Error> {
        let DerivedStructures {
            path, body, followed, ..
        } = self.derived.as_ref();
        // What an edit carried over, whoever asks for it.
        let carried = path.restart.as_ref().filter(|c| c.request == *request);
        let before = carried.map(|c| HandlesBeforeEdit {
            rigging: c.fields.setup(),
            old_from_new: &followed.old_from_new,
        });
        let (ground, most) = (self.ground(), self.limits.handles);
        let (set, rigging) = resolve_handles(&ground, body, request, self.choices.policy, before, most)?;
        let field_bytes = (rigging.handles.len() as u64 + 1) * body.nodes() as u64 * 12;
        admit(self.estimate() + field_bytes, &self.limits)?;
        let restart = carried.map(|c| FieldRestart {
            before: &c.fields,
            old_from_new: &followed.old_from_new,
            touched: &followed.touched,
        });
        let rig = match request.handles.is_empty() {
            true => None,
            false => Some(HandleSystem::restart(body, rigging, restart.as_ref(), exec)?),
        };
        self.handles = set;
        self.rig = rig;
        self.state = SolveState::default();
        Ok(())
    }

    /// What regions are resolved against.
    pub(super) fn ground(&self) -> RegionContext<'_> {
        RegionContext {
            pose: "the rest pose",
            positions: self.rest(),
            primitives: &self.geometry().primitives,
            mesh: &self.derived.mesh,
            parts: &self.derived.parts,
            graph: &self.derived.body.graph,
        }
    }

    /// Default pivots of the handles in force.
    pub(super) fn centroids(&self) -> &[DVec3] {
        &self.handles.centroids
    }

    /// The poses that the handles in force came with.
    pub fn initial_poses(&self) -> HandlePoses {
        HandlePoses(Arc::new(
            self.handles
                .request
                .handles
                .iter()
                .map(|h| h.pose.clone().unwrap_or_default())
                .collect(),
        ))
    }

    /// How far a shape (one position per render vertex) is from the rest shape.
    pub fn quality(&self, positions: &[DVec3], pool: &Pool) -> pb::Quality {
        quality(self.mesh(), self.report().closed, &self.welded(positions), pool)
    }

    /// As [`Deformer::quality`], with what `output` asks for beside: the number of self-intersections.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when `progress` says so.
    pub fn measure(&self, positions: &[DVec3], output: &pb::Output, exec: &Exec<'_>) -> Result<pb::Quality, Error> {
        let deformed = self.welded(positions);
        let mut found = quality(self.mesh(), self.report().closed, &deformed, exec.pool);
        if output.self_intersections {
            let pairs = self_intersections(&deformed, &self.mesh().triangles, exec)?;
            found.self_intersections = Some(u32::try_from(pairs).unwrap_or(u32::MAX));
        }
        Ok(found)
    }

    /// Of positions of render vertices those of the solver's vertices.
    fn welded(&self, positions: &[DVec3]) -> Vec<DVec3> {
        let of = |s: u32| positions[self.mesh().render_vertices_of(s)[0] as usize];
        (0..self.mesh().positions.len() as u32).map(of).collect()
    }
}
