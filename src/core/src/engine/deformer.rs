//! The deformer: one model, everything derived from it, its handles, and poses solved on request.

use crate::asset::{BoneLengthRule, BoundSplats, FileSet, Format, Geometry, Model, ShapeFollowers, WrittenFiles};
use crate::deform::{DeformableBody, HandleSystem, MOST_WHOLE_FIELDS, PoseStats, SolveState};
use crate::engine::derived_structures::{DerivedStructures, admit_bytes};
use crate::engine::error::Error;
use crate::engine::facts::{
    DeformerFacts, DeformerWarning, HandleFacts, MeshCounts, ModelFacts, PulledTies, QualityReport, SolverFacts,
    count_u32,
};
use crate::engine::handle::{DefaultPivot, HandlePose, HandlePoses, HandleSet};
use crate::engine::model_topology::ModelTopology;
use crate::engine::quality::{measure_quality, warn_of_large_faces};
use crate::engine::region_context::RegionContext;
use crate::engine::resolved_handles::{ResolvedHandles, resolve_handles};
use crate::engine::riding::{RidingNodes, mark_passengers};
use crate::engine::settings::{DeformerLimits, HeldBeside, OpenOptions};
use crate::engine::shape::{ModelShape, ShapeId, TopologyId};
use crate::engine::stiff::{farthest_off_rigid, find_hard_parts};
use crate::exec::Exec;
use crate::mesh::carry::CarriedPoints;
use crate::mesh::{BoundingBox, Crossing, CrossingPairs, Mesh, MeshReport, count_crossings};
use crate::pool::Pool;
use crate::reference::SpatialRbf;
use glam::DVec3;
use std::cell::OnceCell;
use std::sync::Arc;

/// Bytes of a harmonic field for each handle and node while it is solved: the solution and the right-hand side.
const FIELD_BYTES: u64 = 16;

/// Bytes of stiff parts for each node and entry of an edge.
const STIFF_NODE_BYTES: u64 = 64;
const STIFF_EDGE_BYTES: u64 = 12;

/// A model with everything derived from it. One owner; solves need `&mut`.
pub struct Deformer {
    pub(super) derived: Arc<DerivedStructures>,
    pub(super) options: OpenOptions,
    pub(super) limits: DeformerLimits,
    /// Bytes that it may hold after what comes next. How a graph is built depends on `limits.graph_bytes` alone, which
    /// never changes.
    pub(super) room: u64,
    /// The name of the next new state.
    pub(super) next_topology: TopologyId,
    pub(super) handles: ResolvedHandles,
    pub(super) handle_system: Option<HandleSystem>,
    pub(super) state: SolveState,
    /// For poses that are solved by deforming space.
    pub(super) spatial_rbf: SpatialRbf,
    /// The shape that was committed last, and all nodes of the graph in it.
    pub(super) committed: Option<CommittedShape>,
    /// How many solutions have been named.
    pub(super) solutions: u64,
    /// What it was before edits, and after those that were undone; the last one left comes last.
    past: Vec<Arc<DerivedStructures>>,
}

/// A shape, and all nodes of the graph in it.
pub(super) struct CommittedShape {
    pub id: ShapeId,
    pub nodes: Arc<Vec<DVec3>>,
}

/// Of how many states besides its own a deformer keeps all that follows from them, so that undo and redo need not make it
/// again.
const KEPT: usize = 2;

impl Deformer {
    /// Reads a model and builds mesh, graph and hierarchy. Reports the stages "read", "mesh", "graph", "hierarchy" to
    /// `progress` as they start.
    ///
    /// # Errors
    /// [`Error::Asset`], [`Error::Invalid`] for a volume graph that cannot be built, [`Error::TooLarge`] when the estimate of what it would
    /// hold is above `limits`, [`Error::Cancelled`].
    pub fn open(
        files: FileSet,
        options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        exec.progress.report("read", 0.0);
        let reading = options.reading_within(limits).of_reading();
        let model = Model::read_watched(files, options.format, &reading, exec.progress)?;
        Self::of_model(model, options, limits, exec)
    }

    /// As [`Deformer::open`], of a model that was read.
    ///
    /// # Errors
    /// Those of [`Deformer::open`].
    pub fn of_model(
        mut model: Model,
        options: &OpenOptions,
        limits: &DeformerLimits,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        // Readers do not know how many there will be; the session keeps them as long as it lives.
        model.geometry.positions.shrink_to_fit();
        model.geometry.triangles.shrink_to_fit();
        mark_passengers(&mut model.geometry.primitives, &options.passengers)?;
        check_rigid_chains(&model, &options.following.bone_lengths)?;
        let riding_nodes = Arc::new(RidingNodes::find(&model, &options.passengers)?);
        exec.check()?;
        let topology = ModelTopology {
            riding_nodes,
            ..ModelTopology::new(model)
        };
        let derived = DerivedStructures::build(TopologyId(0), Arc::new(topology), options, limits, exec)?;
        let limits = DeformerLimits {
            graph_bytes: limits.graph_bytes.or(Some(limits.memory_bytes)),
            ..options.reading_within(limits)
        };
        Ok(Self::without_handles(Arc::new(derived), options, limits))
    }

    fn without_handles(derived: Arc<DerivedStructures>, options: &OpenOptions, limits: DeformerLimits) -> Self {
        Self {
            next_topology: derived.lineage.id.next(),
            derived,
            options: options.clone(),
            room: limits.memory_bytes,
            limits,
            handles: ResolvedHandles::default(),
            handle_system: None,
            state: SolveState::default(),
            spatial_rbf: SpatialRbf::default(),
            committed: None,
            solutions: 0,
            past: Vec::new(),
        }
    }

    /// A deformer on another state of the model, without handles. What follows from the present one is kept for the way back
    /// if there is room.
    pub(super) fn with_derived(&self, derived: Arc<DerivedStructures>) -> Self {
        let next_topology = self.next_topology.max(derived.lineage.id.next());
        let mut past: Vec<Arc<DerivedStructures>> = self.past.clone();
        past.push(Arc::clone(&self.derived));
        past.retain(|d| d.lineage.id != derived.lineage.id);
        let mut room = self.room.saturating_sub(derived.byte_size()) / 2;
        // From the last one on, as many as there is room for.
        let kept = (past.iter().rev().take(KEPT))
            .take_while(|d| {
                let fits = d.byte_size() <= room;
                room = room.saturating_sub(d.byte_size());
                fits
            })
            .count();
        past.drain(..past.len() - kept);
        Self {
            room: self.room,
            next_topology,
            solutions: self.solutions,
            past,
            ..Self::without_handles(derived, &self.options, self.limits)
        }
    }

    /// Says how many bytes the deformer may hold from now on.
    pub fn limit_memory(&mut self, bytes: u64) {
        self.room = bytes;
    }

    /// The limits, with as much memory as there is room for.
    pub(super) fn room_limits(&self) -> DeformerLimits {
        DeformerLimits {
            memory_bytes: self.room,
            ..self.limits
        }
    }

    /// A state that was left a short while ago.
    pub(super) fn kept_structures(&self, id: TopologyId) -> Option<Arc<DerivedStructures>> {
        self.past.iter().find(|d| d.lineage.id == id).cloned()
    }

    /// Whether the nodes of the graph in this shape are known, as an edit of it needs.
    pub fn remembers(&self, shape: ShapeId) -> bool {
        shape == self.rest_id() || self.nodes_of(shape).is_some()
    }

    /// The nodes of the graph in a shape that was committed last.
    pub(super) fn nodes_of(&self, shape: ShapeId) -> Option<&Arc<Vec<DVec3>>> {
        let known = self.committed.as_ref().filter(|c| c.id == shape);
        known.map(|c| &c.nodes)
    }

    /// Returns the name of the rest shape.
    pub(super) fn rest_id(&self) -> ShapeId {
        ShapeId::rest(self.derived.lineage.id)
    }

    /// Returns the rest shape.
    pub fn rest_shape(&self) -> ModelShape {
        ModelShape {
            id: self.rest_id(),
            positions: Arc::clone(self.rest()),
            stats: PoseStats::default(),
            turns: Arc::default(),
            gradients: None,
        }
    }

    pub(super) fn topology(&self) -> &Arc<ModelTopology> {
        self.derived.topology()
    }

    /// The rest surface with vertices at one point joined.
    pub fn mesh(&self) -> &Mesh {
        &self.derived.mesh
    }

    /// The model as it was read.
    pub fn model(&self) -> &Model {
        &self.topology().model
    }

    /// Whether edits have made another topology of the model as it was read.
    pub fn is_edited(&self) -> bool {
        self.topology().edited.is_some()
    }

    /// Triangles, normals, tangents and primitives as they are now. Once edited, positions are those of [`Deformer::rest`]
    /// alone.
    pub fn geometry(&self) -> &Geometry {
        self.topology().geometry()
    }

    /// The model at `positions` (one per render vertex) as files; nodes that ride along are where these carry them.
    ///
    /// # Errors
    /// Those of [`Model::write`] and, with nodes that ride along, [`Deformer::carrier`].
    pub fn write(&self, positions: &[DVec3], format: Format, exec: &Exec<'_>) -> Result<WrittenFiles, Error> {
        let motions = self.riding_nodes_at(positions, exec)?.motions();
        let beside = HeldBeside::of(self.byte_size(), exec.progress);
        let points = self.bound_splats().filter(|_| format.holds_splats());
        let carrier = points.map(|_| self.carrier(positions, exec)).transpose()?;
        let splats = points.zip(carrier.as_ref());
        let followers = ShapeFollowers {
            rules: self.options.following.clone(),
            nodes: &motions,
            exec: Some(Exec::new(exec.pool, &beside)),
            splats: splats.map(|(points, carrier)| BoundSplats { carrier, points }),
            rest: self
                .topology()
                .edited
                .as_ref()
                .filter(|edited| !edited.posed)
                .map(|_| self.rest().as_slice()),
        };
        self.topology().write(positions, format, &followers)
    }

    /// The splats of a model of their own that no edit has changed, once they are bound to its surface.
    fn bound_splats(&self) -> Option<&CarriedPoints> {
        let of_splats = self.model().holds_splats() && !self.is_edited();
        let (_, riders) = self.derived.riding_vertices().filter(|_| of_splats)?;
        riders.points_of_first(self.geometry().primitives.first()?.vertex_count as usize)
    }

    /// What was found about the mesh.
    pub fn report(&self) -> &MeshReport {
        self.derived.report()
    }

    /// The connected components that look like hard parts, see [`find_hard_parts`].
    pub fn hard_parts(&self) -> Vec<u32> {
        find_hard_parts(&self.derived.mesh, &self.derived.parts)
    }

    /// The graph and hierarchy.
    pub fn body(&self) -> &DeformableBody {
        &self.derived.body
    }

    /// The handles on the body, once set.
    pub fn handle_system(&self) -> Option<&HandleSystem> {
        self.handle_system.as_ref()
    }

    /// Rest positions, one per render vertex.
    pub fn rest(&self) -> &Arc<Vec<DVec3>> {
        &self.topology().rest
    }

    /// Length of the bounding box's diagonal.
    pub fn diagonal(&self) -> f64 {
        self.derived.body.diagonal
    }

    /// Returns the bytes held.
    pub fn byte_size(&self) -> u64 {
        let committed = self.committed.as_ref().map_or(0, |c| size_of_val(c.nodes.as_slice()));
        let solves = self.state.byte_size() + self.spatial_rbf.byte_size();
        self.derived.byte_size() + self.spare_bytes() + (solves + committed) as u64
    }

    /// Bytes of what [`Deformer::release_memory`] drops and can be made again: the handles' system, and states that were left.
    pub fn spare_bytes(&self) -> u64 {
        // The files are one and the same.
        let files = self.model().files.total_bytes();
        let past: u64 = self.past.iter().map(|d| d.byte_size().saturating_sub(files)).sum();
        past + self.handle_system.as_ref().map_or(0, HandleSystem::byte_size) as u64
    }

    /// Drops the states that were left.
    pub(super) fn forget_past(&mut self) {
        self.past = Vec::new();
    }

    /// Drops all that can be made again: the handles with their system, what was solved, and states that were left. It has no
    /// handles then.
    pub fn release_memory(&mut self) {
        self.handles = ResolvedHandles::default();
        self.handle_system = None;
        self.state = SolveState::default();
        self.spatial_rbf = SpatialRbf::default();
        self.committed = None;
        self.past = Vec::new();
    }

    /// Bytes that a deformer of this model is expected to hold at most.
    pub fn estimate(&self) -> u64 {
        self.derived.estimate()
    }

    /// Returns the facts about model, solver and handles.
    pub fn facts(&self) -> DeformerFacts {
        let DerivedStructures { mesh, parts, body, .. } = self.derived.as_ref();
        let levels = body.hierarchy.level_sizes();
        let warnings: Vec<DeformerWarning> = (self.derived.warnings().into_iter())
            .chain(self.handles.warnings.iter().cloned())
            .collect();
        DeformerFacts {
            primitives: self.geometry().primitives.clone(),
            warnings,
            model: ModelFacts {
                format: self.model().format,
                file_bytes: self.model().files.total_bytes(),
                sha256: self.topology().sha256.to_string(),
                counts: MeshCounts::of(self.rest().len(), self.geometry().triangles.len()),
            },
            solver: SolverFacts {
                solver_vertices: count_u32(mesh.positions.len()),
                graph_vertices: count_u32(body.nodes()),
                graph_edges: body.graph.neighbours.len() as u64 / 2,
                components: count_u32(parts.count),
                ties: self.derived.tie_facts().clone(),
                levels: levels.iter().map(|l| (count_u32(l.vertices), l.edges as u64)).collect(),
                byte_size: self.byte_size(),
                stiff_parts: (self.handle_system.as_ref())
                    .map_or(0, |system| count_u32(system.stiff_parts(body).count())),
            },
            handles: self.handle_facts(),
            origin: self.origin(),
        }
    }

    /// What 32-bit positions are relative to: [`DeformerFacts::origin`].
    pub(super) fn origin(&self) -> DVec3 {
        BoundingBox::of(&self.model().geometry.positions).origin()
    }

    /// What a user should know of `poses`: handles that take tied parts from each other. Poses of other handles give none.
    pub fn pose_warnings(&self, poses: &HandlePoses) -> Vec<DeformerWarning> {
        let (Some(system), Ok(transforms)) = (&self.handle_system, self.transforms(poses)) else {
            return Vec::new();
        };
        let pulled = PulledTies {
            body: self.body(),
            system,
            mesh: self.mesh(),
            primitives: &self.geometry().primitives,
            handles: self.handles(),
        };
        pulled.pull_warnings(&transforms)
    }

    fn handle_facts(&self) -> Vec<HandleFacts> {
        let handles = self.handles.set.handles.iter().enumerate();
        let facts = handles.map(|(k, handle)| HandleFacts {
            id: handle.id.clone(),
            vertices: self.handles.counts[k].vertices,
            interior_nodes: self.handles.counts[k].interior_nodes,
            centroid: self.handles.centroids[k],
            pivot: self.handles.pivots[k],
        });
        facts.collect()
    }

    /// The handles in force.
    pub fn handles(&self) -> &HandleSet {
        &self.handles.set
    }

    /// Replaces the handles and recomputes the first-pass fields (stage "fields"). On an error the old ones stay. An
    /// empty list takes all handles away.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a region that does not fit the model, [`Error::Precondition`] when the handles leave the model without a place,
    /// [`Error::TooLarge`], [`Error::Cancelled`].
    pub fn set_handles(&mut self, handles: impl Into<HandleSet>, exec: &Exec<'_>) -> Result<(), Error> {
        let body = &self.derived.body;
        let handles = handles.into();
        if handles.handles.len() > self.limits.handles {
            return Err(Error::TooLarge {
                what: "handles",
                seen: handles.handles.len() as u64,
                limit: self.limits.handles as u64,
            });
        }
        let is_empty = handles.handles.is_empty();
        let regions = self.rest_regions(exec);
        // A mirror image of each may come beside it.
        let most = handles.handles.len() as u64 * if handles.symmetry_plane.is_some() { 2 } else { 1 };
        // The handles in force and the states that were left stay until the new ones are whole.
        let whole = match body.local_fields {
            true => most.min(MOST_WHOLE_FIELDS as u64) + 1,
            false => most + 1,
        };
        let held = self.estimate() + self.spare_bytes() + whole * body.nodes() as u64 * FIELD_BYTES;
        // Parts with their edges, and a second system.
        let stiff = match &handles.stiff {
            Some(_) => body.nodes() as u64 * STIFF_NODE_BYTES + body.graph.neighbours.len() as u64 * STIFF_EDGE_BYTES,
            None => 0,
        };
        let held = held + stiff;
        let admit = |held_by_handles: u64| {
            exec.check()?;
            admit_bytes(held + held_by_handles, &self.room_limits(), exec)
        };
        let (mut resolved, setup) = resolve_handles(&regions, body, handles, self.options.policy, &admit)?;
        if self.options.loose_vertices_ride {
            resolved.unreferenced = Vec::new();
        }
        let beside = HeldBeside::within(held, self.room, exec.progress);
        let build = |setup| HandleSystem::build(body, setup, &Exec::new(exec.pool, &beside));
        let system = match is_empty {
            true => None,
            false => Some(build(setup).map_err(|e| beside.refusal(e))?),
        };
        let large = match &system {
            Some(system) => warn_of_large_faces(&self.derived.mesh, system, body.diagonal, 0.0, exec)?,
            None => None,
        };
        let with_joints = system
            .as_ref()
            .filter(|_| resolved.set.default_pivot == DefaultPivot::Joint);
        let mut joints = with_joints.map_or_else(Vec::new, |system| system.joints(body, exec.pool));
        joints.resize(resolved.centroids.len(), None);
        let pivots = joints.iter().zip(&resolved.centroids);
        let pivots = pivots.map(|(joint, middle)| joint.unwrap_or(*middle));
        self.handles = ResolvedHandles {
            pivots: pivots.collect(),
            ..resolved
        };
        self.handles.warnings.extend(large);
        self.handle_system = system;
        self.state.reset();
        self.spatial_rbf = SpatialRbf::default();
        Ok(())
    }

    /// What regions of the rest pose are resolved against.
    pub(super) fn rest_regions<'a>(&'a self, exec: &'a Exec<'a>) -> RegionContext<'a> {
        RegionContext {
            pose: "the rest pose",
            positions: self.rest(),
            primitives: &self.geometry().primitives,
            mesh: &self.derived.mesh,
            parts: &self.derived.parts,
            origin: self.origin(),
            exec,
            images: OnceCell::new(),
        }
    }

    /// The points that the handles in force turn about where these poses name none.
    pub(super) fn default_pivots(&self, poses: &HandlePoses) -> Vec<DVec3> {
        let default = HandlePose::default();
        let of = |k: usize| self.handles.default_pivot(k, poses.0.get(k).unwrap_or(&default));
        (0..self.handles.pivots.len()).map(of).collect()
    }

    /// The poses that the handles in force came with.
    pub fn initial_poses(&self) -> HandlePoses {
        HandlePoses(Arc::new(
            self.handles
                .set
                .handles
                .iter()
                .map(|h| h.pose.clone().unwrap_or_default())
                .collect(),
        ))
    }

    /// How far a shape (one position per render vertex) is from the rest shape.
    pub fn quality(&self, positions: &[DVec3], pool: &Pool) -> QualityReport {
        measure_quality(self.mesh(), self.report().closed, &self.mesh().welded(positions), pool)
    }

    /// Largest distance of a vertex that a hard handle holds from where `poses` put it, as a fraction of the bounding box's
    /// diagonal; 0 without handles.
    ///
    /// # Errors
    /// Those of [`Deformer::transforms`].
    pub fn constraint_error(&self, positions: &[DVec3], poses: &HandlePoses) -> Result<f64, Error> {
        let Some(system) = self.handle_system() else {
            return Ok(0.0);
        };
        let now = |s: usize| positions[self.derived.mesh.render_vertices_of(s as u32)[0] as usize];
        let farthest = system.largest_misplacement(self.body(), &self.transforms_in(positions, poses)?, now);
        let diagonal = self.diagonal();
        Ok(if diagonal > 0.0 { farthest / diagonal } else { farthest })
    }

    /// As [`Deformer::quality`], with the number of self-intersections beside when `counts_crossings` asks for it.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when `progress` says so.
    pub fn measure(
        &self,
        positions: &[DVec3],
        counts_crossings: bool,
        exec: &Exec<'_>,
    ) -> Result<QualityReport, Error> {
        let deformed = self.mesh().welded(positions);
        let mut found = measure_quality(self.mesh(), self.report().closed, &deformed, exec.pool);
        if let Some(system) = &self.handle_system {
            found.off_rigid = farthest_off_rigid(system, self.body(), |vertex| deformed[vertex]);
        }
        if counts_crossings {
            let Mesh {
                positions: rest,
                triangles,
                ..
            } = self.mesh();
            let pairs = count_crossings(&deformed, rest, triangles, exec)?;
            let narrow = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
            found.self_intersections = Some(narrow(pairs.all));
            found.new_self_intersections = Some(narrow(pairs.new));
        }
        Ok(found)
    }

    /// What each of the model's triangles crosses in a shape (one position per render vertex); pairs that cross in the rest shape too
    /// are not new.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when `progress` says so.
    pub fn crossing_triangles(&self, positions: &[DVec3], exec: &Exec<'_>) -> Result<Vec<Crossing>, Error> {
        let triangles = self.geometry().triangles.len();
        Ok((self.mesh()).crossing_triangles(positions, Some(self.rest()), triangles, exec)?)
    }

    /// The pairs of triangles that cross in a shape (one position per render vertex), at most `most` of them. What the present handles
    /// hold hard is held.
    ///
    /// # Errors
    /// [`Error::Cancelled`] when `progress` says so.
    pub fn crossing_pairs(&self, positions: &[DVec3], most: usize, exec: &Exec<'_>) -> Result<CrossingPairs, Error> {
        let given = self.handle_system.as_ref().map_or(&[][..], |system| system.given());
        let is_held = |v: u32| given.get(v as usize).is_some_and(|held| *held);
        Ok(self
            .mesh()
            .crossing_pairs(positions, self.rest(), &is_held, most, exec)?)
    }
}

/// How many joints and characters an error lists.
const MOST_SHOWN: usize = 8;
const LONGEST_SHOWN: usize = 64;

/// Refuses a name that no joint of the model has.
///
/// # Errors
/// [`Error::Invalid`] with the name's index, and those of [`Model::joint_names`].
fn check_rigid_chains(model: &Model, rule: &BoneLengthRule) -> Result<(), Error> {
    let BoneLengthRule::KeepBelow(names) = rule else {
        return Ok(());
    };
    let joints = model.joint_names()?;
    for (k, name) in names.iter().enumerate() {
        if joints.binary_search(name).is_err() {
            let clip = |name: &String| format!("\"{}\"", name.chars().take(LONGEST_SHOWN).collect::<String>());
            let known: Vec<String> = joints.iter().take(MOST_SHOWN).map(clip).collect();
            let known = match (joints.len(), known.join(", ")) {
                (0, _) => {
                    "the model has no joint with a name; boneLengths KEEP keeps the lengths of all bones".to_owned()
                }
                (all, known) if all > MOST_SHOWN => format!("there are {known} and {} more", all - MOST_SHOWN),
                (_, known) => format!("there are {known}"),
            };
            let problem = format!("no joint is named {}; {known}", clip(name));
            return Err(Error::invalid(format!("rigidChains[{k}]"), problem));
        }
    }
    Ok(())
}
