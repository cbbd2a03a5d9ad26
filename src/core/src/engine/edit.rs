//! Edits of the topology of a deformer: the operation on the surface, then everything that follows from it.
//!
//! An edit works on the current shape or on the rest shape. An edit of the current shape makes it the rest shape, and
//! all handles get their rest poses. An edit of the rest shape keeps poses, and the result is solved with them. The
//! deformer changes only when everything has succeeded.

use super::adopt::ShapeToEdit;
use super::carried_handles::{CarriedHandles, HeldVertices, carry_handles};
use super::derived_structures::{DerivedStructures, TopologyChange};
use super::edit_command::{EditCommand, EditKind, EditOutcome, EditReport, EditedShape, kept_vertex_runs};
use super::edit_operations::{EditContext, plan_edit};
use super::edit_surface::EditSurface;
use super::error::{ESTIMATED_MEMORY, Error};
use super::facts::{DeformerWarning, MeshCounts};
use super::line_cuts::cut_lines;
use super::part_families::VertexOrigins;
use super::quality::{HandleBend, largest_turn};
use super::region::Region;
use super::region_context::{RegionContext, nodes_in_region, vertices_in_region, vertices_of_handle};
use super::riding_edits::{RiddenEdit, take_splats};
use super::seams::Seams;
use super::settings::{EDITED_AT_REST, HeldBeside, SolveMode, SolveSettings};
use super::shape::{ModelShape, Shading};
use super::topology_state::TopologyState;
use super::{Deformer, digest};
use crate::edit::{PatchedSurface, SurfacePatch, apply_patch};
use crate::exec::Exec;
use crate::mesh::NONE;
use glam::DVec3;
use std::sync::Arc;

impl Deformer {
    /// Carries out an edit. On an error nothing has changed.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the field; [`Error::Precondition`] when the surface does not allow what is asked for;
    /// [`Error::TooLarge`], [`Error::Cancelled`].
    pub fn edit(&mut self, order: &EditCommand<'_>, exec: &Exec<'_>) -> Result<EditOutcome, Error> {
        // States that were left can be made again; what is edited and what comes of it have to be held.
        if self.estimate().saturating_add(self.byte_size()) > self.room {
            self.forget_past();
        }
        let seen = self.shape_to_edit(order, exec)?;
        self.edit_shape(order, &seen, exec)
    }

    /// As [`edit`](Self::edit), where [`shape_to_edit`](Self::shape_to_edit) of the edit is known.
    ///
    /// # Errors
    /// As `edit`.
    pub fn edit_shape(
        &mut self,
        order: &EditCommand<'_>,
        seen: &ShapeToEdit,
        exec: &Exec<'_>,
    ) -> Result<EditOutcome, Error> {
        exec.progress.report("edit", 0.0);
        let at_rest = order.on == EditedShape::Rest;
        if order.shape.positions.len() != self.rest().len() {
            return Err(Error::Internal("the shape of another model".into()));
        }
        let (rest, shape) = (self.rest_shape(), &seen.shape);
        let is_given = order.edit.kind().gives_shape();
        let mut origins = self.topology().origins(&self.derived.mesh);
        let mut surface = self.edit_surface(&shape.positions, &origins, exec)?;
        let points = (shape.id != rest.id).then(|| surface.own_surface().point_positions());
        let before = MeshCounts::of(surface.positions.len(), self.geometry().triangles.len());
        let mut context = EditContext {
            regions: self.region_context(shape, exec),
            limits: self.room_limits(),
            rest: &rest.positions,
            near_origin: self.options.body.near_origin,
            bend: self.handle_bend(order),
            surface: &mut surface,
            origins: &mut origins,
            admit_growth: &|triangles| self.admit_growth(triangles, exec),
        };
        // All that there is stays until the edit is whole.
        let beside = HeldBeside::of(self.byte_size(), exec.progress);
        let mut patch = plan_edit(&mut context, order.edit, &Exec::new(exec.pool, &beside))?;
        exec.check()?;
        // What is given vertex by vertex keeps all of them.
        if !is_given {
            patch.idle = std::mem::take(&mut surface.idle_vertices);
        }
        let (applied, left_behind) = self.apply(&mut patch, &surface, &origins, order, exec)?;
        let patch = &patch;
        self.admit_size(&applied, exec)?;
        let on_shape = EditCommand { shape, ..*order };
        let mut carried = self.carry(&applied, patch, &surface.seams, &on_shape, exec)?;
        let mut report = self.report_edit(before, &applied, patch);
        report.warnings.extend(left_behind);
        report.wrap.clone_from(&seen.wrap);
        report.unintersect = seen.unintersect;
        report.warnings.extend_from_slice(&seen.warnings);
        report.warnings.extend(self.rounding_warning(seen, is_given));
        report.warnings.extend(self.flat_warning(seen, is_given));
        let points_before = self.derived.mesh.positions.len();
        let families = (self.derived.families).after_edit(points_before, &surface.surface(), &applied, patch);
        let (mut topology, applied) = (self.topology()).after_edit(&surface, &origins, applied, patch, families);
        if let Some(edited) = topology.edited.as_mut() {
            edited.apart |= order.edit.kind() == EditKind::Cut;
        }
        if is_given {
            // Vertices that the solver has as one are each where they were given.
            let given = |&was: &u32| shape.positions[was as usize];
            topology.rest = Arc::new(applied.old_from_vertex.iter().map(given).collect());
        }
        if shape.id != rest.id {
            // What the edit sees becomes the rest pose, of what rides along too.
            topology.take_posed_rest(self.riding_nodes_at(&shape.positions, exec)?);
        }
        drop((surface, origins));
        exec.check()?;
        let nodes = match points {
            None => Some(None),
            Some(points) => self
                .nodes_of(shape.id)
                .map(|nodes| Some(nodes_with_points(nodes, &points))),
        };
        let change = TopologyChange {
            topology: Arc::new(topology),
            applied: &applied,
            follow: nodes.is_some() && applied.old_from_point.len() == applied.points as usize,
            nodes: nodes.flatten(),
        };
        let id = self.next_topology;
        let derived = (self.derived).edited(change, id, &self.options, &self.room_limits(), exec)?;
        report.repaired = derived.is_followed();
        let mut next = self.with_handles_left(derived, &mut carried, &mut report, exec)?;
        let settings = order.settings.cloned().unwrap_or(EDITED_AT_REST);
        let outcome = next.shape_after_edit(carried, report, at_rest.then_some(settings), exec)?;
        self.give_way(next);
        Ok(outcome)
    }

    /// A deformer of an edited model with the handles that still hold something.
    fn with_handles_left(
        &self,
        derived: DerivedStructures,
        carried: &mut CarriedHandles,
        report: &mut EditReport,
        exec: &Exec<'_>,
    ) -> Result<Self, Error> {
        let mut next = self.with_derived(Arc::new(derived));
        carried.drop_empty(
            self.handles(),
            |region| next.holds_nothing(region, exec),
            |region| vertices_in_region(&next.rest_regions(exec), region, None).is_err(),
        );
        // Regions that were not looked at to their end hold nothing.
        exec.check()?;
        report.handles_kept = carried.set.handles.iter().map(|h| h.id.clone()).collect();
        report.warnings.splice(..0, std::mem::take(&mut carried.warnings));
        let held = self.handle_system.as_ref().map_or(0, |handles| handles.byte_size());
        let beside = HeldBeside::of(held as u64, exec.progress);
        next.set_handles(&carried.set, &Exec::new(exec.pool, &beside))?;
        Ok(next)
    }

    /// The surface after a patch, with what rides along; and what is to be said of what of that stays behind.
    fn apply(
        &self,
        patch: &mut SurfacePatch,
        surface: &EditSurface,
        origins: &VertexOrigins,
        order: &EditCommand<'_>,
        exec: &Exec<'_>,
    ) -> Result<(PatchedSurface, Option<DeformerWarning>), Error> {
        let follows = self.options.loose_vertices_ride;
        let (before, firsts) = (surface.own_surface(), surface.first_vertices());
        (surface.seams).part_facets(patch, &before);
        let ends_lines = self.options.every_cut_ends_lines || order.edit.one_sided_plane().is_some();
        if order.edit.kind() == EditKind::Cut && follows && ends_lines && before.point_of.contains(&NONE) {
            let segments = origins.line_segments(self.geometry())?;
            let surfaces = [&before, &surface.surface()];
            cut_lines(patch, surfaces, &segments, order.edit, &firsts, exec)?;
        }
        let cut = order.edit.one_sided_plane();
        let takes = cut.is_some() || matches!(order.edit.kind(), EditKind::Delete | EditKind::Clean);
        if takes && self.model().holds_splats() {
            take_splats(patch, &before, &self.derived.riding_model().loose(), cut, exec)?;
        }
        let mut applied = apply_patch(&before, patch, &firsts)?;
        let ridden = RiddenEdit {
            model: self.derived.riding_model(),
            before,
            patch,
            kind: order.edit.kind(),
            drawn: &|| Ok(origins.line_segments(self.geometry())?),
            follows,
        };
        let left_behind = ridden.follow(&mut applied, exec)?;
        Ok((applied, left_behind))
    }

    /// What an edit has done, but for the shape after it.
    fn report_edit(&self, before: MeshCounts, applied: &PatchedSurface, patch: &SurfacePatch) -> EditReport {
        // What rides along is in no patch.
        let riding = self.topology().passenger_triangles();
        let mut report = EditReport {
            before,
            after: MeshCounts::of(applied.positions.len(), applied.triangles.len() + riding),
            kept: kept_vertex_runs(applied, before.vertices as usize),
            curve: applied.vertices_of_points(&patch.curve),
            creases: (applied.vertices_of_points(patch.creases.as_flattened()).as_chunks().0).to_vec(),
            deviation: patch.deviation,
            volume_change: patch.volume_change,
            ..Default::default()
        };
        let noticed = patch.warnings.iter();
        (report.warnings).extend(noticed.map(|w| DeformerWarning::new(&*w.code, &*w.message, &*w.place)));
        let mesh = &self.derived.mesh;
        let (collapsed, duplicate) = (mesh.collapsed_triangles.len(), mesh.duplicate_triangles.len());
        if collapsed + duplicate > 0 {
            let message = format!(
                "{collapsed} triangles without area and {duplicate} that repeat another are left out from now on"
            );
            (report.warnings).push(DeformerWarning::new("triangles-dropped", message, ""));
        }
        report
    }

    /// Whether a handle of this region would hold neither a vertex nor a node inside.
    fn holds_nothing(&self, region: &Region, exec: &Exec<'_>) -> bool {
        let context = self.rest_regions(exec);
        let has_vertex = vertices_of_handle(&context, region).is_ok_and(|vertices| vertices.contains(&true));
        let nodes = || nodes_in_region(&context, &self.body().graph, region, None);
        !has_vertex && nodes().map_or(true, |held| held.nodes.is_empty())
    }

    /// The shape after an edit, with its report; `settings` solve for the poses.
    fn shape_after_edit(
        &mut self,
        carried: CarriedHandles,
        mut report: EditReport,
        settings: Option<SolveSettings>,
        exec: &Exec<'_>,
    ) -> Result<EditOutcome, Error> {
        let poses = self.initial_poses();
        let posed = poses.0.iter().any(|pose| pose.moves());
        let (shape, solved) = if let Some(settings) = settings.filter(|_| posed) {
            exec.progress.report("solve", 0.0);
            let solved = self.solve(&poses, &settings, SolveMode::Commit, exec, &mut |_| true)?;
            (solved, Some(settings))
        } else {
            (self.rest_shape(), None)
        };
        report.digest = digest(&shape.positions);
        Ok(EditOutcome {
            report,
            handles: carried.set,
            poses,
            solved,
            shape,
        })
    }

    /// Returns the state of the topology: everything but handles and shape, to go back to.
    pub fn topology_state(&self) -> TopologyState {
        TopologyState(Arc::clone(&self.derived.lineage))
    }

    /// Goes to another state of the topology, without handles. On an error nothing has changed.
    ///
    /// # Errors
    /// [`Error::TooLarge`], [`Error::Cancelled`].
    pub fn restore_topology(&mut self, state: &TopologyState, exec: &Exec<'_>) -> Result<(), Error> {
        if self.derived.lineage.id == state.id() {
            return Ok(());
        }
        let derived = match self.kept_structures(state.id()) {
            Some(derived) => derived,
            None => Arc::new(DerivedStructures::retrace(
                state,
                &self.options,
                &self.room_limits(),
                exec,
            )?),
        };
        let next = self.with_derived(derived);
        self.give_way(next);
        Ok(())
    }

    /// Becomes `next`, which solves with the memory that this one has, unless it has solved something already: what has just been
    /// touched need not be touched for the first time again.
    fn give_way(&mut self, mut next: Self) {
        if next.state.is_empty() {
            next.state = std::mem::take(&mut self.state);
            next.state.reset();
        }
        *self = next;
    }

    /// What the handles in force do to the shape that is edited.
    fn handle_bend<'a>(&'a self, order: &'a EditCommand<'_>) -> Option<HandleBend<'a>> {
        let transforms = || {
            self.transforms_in(&order.shape.positions, order.poses)
                .unwrap_or_default()
        };
        self.handle_system().map(|handles| HandleBend {
            handles,
            mesh: &self.derived.mesh,
            shape: &order.shape.positions,
            turn: largest_turn(&transforms()),
            diagonal: self.diagonal(),
        })
    }

    /// What regions are resolved against in the shape that is edited.
    pub(super) fn region_context<'a>(&'a self, shape: &'a ModelShape, exec: &'a Exec<'a>) -> RegionContext<'a> {
        let current = shape.id != self.rest_id();
        RegionContext {
            pose: if current { "the current shape" } else { "the rest pose" },
            positions: &shape.positions,
            ..self.rest_regions(exec)
        }
    }

    /// The surface in a shape, as an operation reads it.
    pub(super) fn edit_surface(
        &self,
        shape: &[DVec3],
        origins: &VertexOrigins,
        exec: &Exec<'_>,
    ) -> Result<EditSurface, Error> {
        let geometry = self.geometry();
        let mut shading = match geometry.normals.is_empty() {
            true => Shading::default(),
            false => super::shading(geometry, self.rest(), shape),
        };
        if geometry.tangents.is_empty() {
            shading.tangents = Vec::new();
        }
        let mesh = &self.derived.mesh;
        let seams = Seams::find(geometry, self.rest(), mesh, origins, exec.progress)?;
        Ok(EditSurface::new(mesh, geometry, shape, shading, seams))
    }

    /// Refuses an edit that would add about so many triangles, and half as many vertices, by its estimate alone.
    fn admit_growth(&self, triangles: f64, exec: &Exec<'_>) -> Result<(), Error> {
        // Beyond 2^63 numbers do not differ.
        let added = triangles.clamp(0.0, 1e18) as u64;
        let (vertices, faces) = (self.rest().len() as u64, self.geometry().triangles.len() as u64);
        self.admit_counts(vertices + added / 2, faces.saturating_add(added), exec)
    }

    fn admit_size(&self, applied: &PatchedSurface, exec: &Exec<'_>) -> Result<(), Error> {
        let triangles = applied.triangles.len() + self.topology().passenger_triangles();
        self.admit_counts(applied.positions.len() as u64, triangles as u64, exec)
    }

    fn admit_counts(&self, vertices: u64, triangles: u64, exec: &Exec<'_>) -> Result<(), Error> {
        let limits = &self.limits.model;
        let sizes = [
            ("the number of vertices after the edit", vertices, limits.vertices),
            ("the number of triangles after the edit", triangles, limits.triangles),
        ];
        if let Some((what, seen, limit)) = sizes.into_iter().find(|(_, seen, limit)| seen > limit) {
            return Err(Error::TooLarge { what, seen, limit });
        }
        // What grows is expected to need as much for each vertex as what there is, and both are held until the edit is whole.
        let before = self.rest().len().max(1) as u64;
        let grown = (self.derived.estimate() / before).saturating_mul(vertices);
        let seen = grown.saturating_add(self.byte_size());
        if vertices > before && (seen > self.room || !exec.progress.may_hold(seen)) {
            return Err(Error::TooLarge {
                what: ESTIMATED_MEMORY,
                seen,
                limit: self.room,
            });
        }
        Ok(())
    }

    /// What the handles in force hold after an edit.
    fn carry(
        &self,
        applied: &PatchedSurface,
        patch: &SurfacePatch,
        seams: &Seams,
        order: &EditCommand<'_>,
        exec: &Exec<'_>,
    ) -> Result<CarriedHandles, Error> {
        let set = self.handles();
        let context = self.rest_regions(exec);
        let mut vertices = Vec::new();
        for (k, handle) in set.handles.iter().enumerate() {
            let held = vertices_of_handle(&context, &handle.region);
            vertices.push(held.map_err(|e| e.below(&format!("handles[{k}].region")))?);
        }
        if let Some(region) = &set.region_of_interest {
            let held = vertices_in_region(&context, region, None);
            vertices.push(held.map_err(|e| e.below("regionOfInterest"))?);
        }
        if let Some(stiff) = &set.stiff {
            for (field, region) in stiff.listed() {
                let held = vertices_in_region(&context, &region, None);
                vertices.push(held.map_err(|e| e.below(&field))?);
            }
        }
        let at_rest = order.on == EditedShape::Rest;
        // What stands for a vertex that is held is held as well.
        vertices.iter_mut().for_each(|held| seams.spread(held));
        let pivots = self.default_pivots(order.poses);
        let held = HeldVertices {
            set,
            vertices,
            pivots: &pivots,
            moved: match order.shape.positions != *self.rest() {
                true if at_rest => Some(Vec::new()),
                true => self.transforms_in(&order.shape.positions, order.poses).ok(),
                false => None,
            },
        };
        let poses = at_rest.then_some(order.poses.0.as_slice());
        Ok(carry_handles(&held, poses, applied, patch))
    }
}

/// Nodes with those of the surface where an edit takes them to be.
fn nodes_with_points(nodes: &Arc<Vec<DVec3>>, points: &[DVec3]) -> Arc<Vec<DVec3>> {
    if nodes[..points.len()] == *points {
        return Arc::clone(nodes);
    }
    let mut nodes = nodes.as_ref().clone();
    nodes[..points.len()].copy_from_slice(points);
    Arc::new(nodes)
}
