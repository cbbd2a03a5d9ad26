//! Edits as operations on a surface: regions become triangles, another model is appended.

use super::DeformerLimits;
use super::clean::unwanted_faces;
use super::edit_command::{
    CleanCommand, CutLine, Edit, EditKind, MergeJoin, ModelMerge, OwnCap, SmoothCommand, SmoothKind,
};
use super::edit_surface::EditSurface;
use super::error::Error;
use super::model_topology::ModelTopology;
use super::other_model::OtherModel;
use super::part_families::VertexOrigins;
use super::quality::{HandleBend, plan_division};
use super::region::Region;
use super::region_context::{RegionContext, vertices_in_region};
use super::seams::Seams;
use super::shape::Shading;
use crate::asset::{Model, Splats};
use crate::edit::{
    CreaseOptions, CutOptions, CutPlane, EditWarning, LoopPair, RemeshOptions, RemeshTarget, SmoothOptions,
    SurfaceCurve, SurfacePatch, SurfaceView,
};
use crate::exec::Exec;
use crate::mesh::{Adjacency, BoundingBox, Mesh, NONE, Weld, mean_edge_length};
use crate::{asset, edit};
use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};
use std::sync::Arc;

/// How many times as large as the smaller of two merged models both together may be: 32-bit positions have 1e7 steps.
const LARGEST: f64 = 1e6;

/// What an operation is planned on. A merge appends to surface and origins.
pub(super) struct EditContext<'a> {
    /// What regions are taken on.
    pub regions: RegionContext<'a>,
    /// The limits of the deformer.
    pub limits: DeformerLimits,
    /// The rest shape, one position per render vertex.
    pub rest: &'a [DVec3],
    /// What the handles in force do, if there are any.
    pub bend: Option<HandleBend<'a>>,
    /// The surface to edit.
    pub surface: &'a mut EditSurface,
    /// What its vertices are made of.
    pub origins: &'a mut VertexOrigins,
    /// Whether a surface far from the origin is edited as it would be near it.
    pub near_origin: bool,
    /// Refuses an edit that would add about so many triangles, before it is begun.
    pub admit_growth: &'a dyn Fn(f64) -> Result<(), Error>,
}

/// Plans an edit.
pub(super) fn plan_edit(context: &mut EditContext<'_>, edit: &Edit, exec: &Exec<'_>) -> Result<SurfacePatch, Error> {
    let progress = exec.progress;
    let kind = edit.kind();
    let surface = context.surface.surface();
    edit::check_faces_at_points(&surface)?;
    let own_caps = edit.own_cap().map(|_| context.surface.primitives.len() as u32);
    let mut patch = match edit {
        Edit::Cut { along, keep, fill, .. } => {
            let options = CutOptions {
                keep: *keep,
                fill: *fill,
                hard_caps: &context.hard_caps(),
                own_caps,
            };
            plan_cut(&surface, along, &options, exec)?
        }
        Edit::Subdivide {
            region,
            scheme,
            creases,
        } => {
            let faces = context.faces_in_region(region.as_ref(), kind)?;
            (context.admit_growth)(3.0 * faces.len() as f64)?;
            let named = points_of(&surface, creases.edges.as_flattened(), "subdivide.creases")?;
            let creases = CreaseOptions {
                degrees: creases.degrees,
                edges: named.as_chunks().0,
                between_primitives: creases.between_primitives,
                sharpness: creases.sharpness.unwrap_or(1.0),
            };
            edit::subdivide_region(&surface, &faces, *scheme, &creases, progress)?
        }
        Edit::SubdivideForPose { region } => {
            let faces = context.faces_in_region(region.as_ref(), kind)?;
            let bend = context.bend.ok_or_else(|| {
                Error::Precondition("no handles are set; subdivide with auto divides what lies between handles".into())
            })?;
            plan_division(&surface, &faces, &bend, exec)?
        }
        Edit::Decimate { region, ratio } => {
            let faces = context.faces_in_region(region.as_ref(), kind)?;
            context.plan_near_origin(|surface| edit::decimate_region(surface, &faces, *ratio, progress))?
        }
        Edit::Delete { region, fill } => {
            let faces = context.faces_in_region(Some(region), kind)?;
            if faces.len() == context.surface.triangles.len() {
                let problem = "holds every triangle; something has to be left";
                return Err(Error::invalid("delete.region", problem));
            }
            edit::delete_faces(&surface, &faces, *fill, progress)?
        }
        Edit::Fill { region, .. } => {
            let faces = match region {
                Some(region) => Some(context.faces_touching(region, 1, kind)?),
                None => None,
            };
            match own_caps {
                Some(own) => edit::fill_holes_flat(&surface, faces.as_deref(), own, progress)?,
                None => edit::fill_holes(&surface, faces.as_deref(), progress)?,
            }
        }
        Edit::Remesh(remesh) => {
            let faces = context.faces_in_region(remesh.region.as_ref(), kind)?;
            let target = match remesh.edge_length {
                None => RemeshTarget::Auto { rest: context.rest },
                Some(length) => RemeshTarget::Length(length),
            };
            let options = RemeshOptions {
                target,
                max_deviation: remesh.max_deviation,
                sharp_degrees: remesh.sharp_degrees.unwrap_or(edit::SHARP_DEGREES),
            };
            let expected = edit::expected_triangles(&surface, &faces, &options)?;
            // What no surface may have is refused as such.
            if expected <= edit::MOST_TRIANGLES as f64 {
                (context.admit_growth)(expected - faces.len() as f64)?;
            }
            context.plan_near_origin(|surface| edit::remesh_region(surface, &faces, &options, progress))?
        }
        Edit::Smooth(smooth) => plan_smoothing(context, smooth, exec)?,
        Edit::Merge(merge) => plan_merge(context, merge, exec)?,
        Edit::InsertCurve { points, closed } => {
            let offset = context.offset_from_origin();
            let near: Vec<DVec3> = points.iter().map(|place| *place - offset).collect();
            let curve = SurfaceCurve::Drawn(&near);
            context.plan_near_origin(|surface| edit::insert_curve(surface, &curve, *closed, progress))?
        }
        Edit::Weld { tolerance } => plan_weld(context, *tolerance, exec)?,
        Edit::Clean(clean) => plan_cleaning(&surface, clean, exec)?,
        Edit::Adopt { .. } => plan_adoption(context),
        // The shape that is edited is the result already.
        Edit::Wrap(_) | Edit::Unintersect(_) => SurfacePatch::default(),
    };
    if let Some(cap) = edit.own_cap() {
        context.add_caps(&mut patch, cap);
    }
    Ok(patch)
}

impl EditContext<'_> {
    /// Plans on the surface; where it is far from the origin, as it is near it, so that decisions between lengths are those there.
    fn plan_near_origin(
        &self,
        plan: impl FnOnce(&SurfaceView<'_>) -> Result<SurfacePatch, edit::Error>,
    ) -> Result<SurfacePatch, Error> {
        let surface = self.surface.surface();
        let offset = self.offset_from_origin();
        if offset == DVec3::ZERO {
            return Ok(plan(&surface)?);
        }
        let bounds = BoundingBox::of(surface.positions);
        let positions = bounds.near_origin(surface.positions);
        let mut patch = plan(&SurfaceView {
            positions: &positions,
            ..surface
        })?;
        let moved = patch.moved.iter_mut().map(|(_, place)| place);
        let places = moved.chain(patch.vertices.iter_mut().map(|vertex| &mut vertex.position));
        places.for_each(|place| *place += offset);
        Ok(patch)
    }

    /// What places lose where they are planned near the origin; zero for surfaces that are there.
    fn offset_from_origin(&self) -> DVec3 {
        let bounds = BoundingBox::of(self.surface.surface().positions);
        match self.near_origin && bounds.is_far() {
            true => bounds.center(),
            false => DVec3::ZERO,
        }
    }

    /// Whether edges are hard where a cap meets a wall of each primitive: where it has normals.
    fn hard_caps(&self) -> Vec<bool> {
        self.surface.primitives.iter().map(|p| p.has_normals).collect()
    }

    /// Adds the primitives that a patch has caps for: that of a cap of primitive p is numbered `primitives.len() + p` in it.
    fn add_caps(&mut self, patch: &mut SurfacePatch, cap: &OwnCap) {
        let old = self.surface.primitives.len() as u32;
        let mut lenders: Vec<u32> = patch
            .triangles
            .iter()
            .filter_map(|t| t.primitive.checked_sub(old))
            .collect();
        lenders.sort_unstable();
        lenders.dedup();
        let renumber = |primitive: &mut u32| {
            let place = primitive.checked_sub(old).and_then(|p| lenders.binary_search(&p).ok());
            *primitive = place.map_or(*primitive, |k| old + k as u32);
        };
        patch.vertices.iter_mut().for_each(|v| renumber(&mut v.primitive));
        patch.triangles.iter_mut().for_each(|t| renumber(&mut t.primitive));
        for (k, &lender) in (0u32..).zip(&lenders) {
            patch.caps.push((old + k, lender));
            self.surface.add_empty_primitive(lender, &cap.material);
            self.origins.add_cap(lender, &cap.material);
        }
    }

    /// The triangles with all corners in a region, rising; all of them without one.
    fn faces_in_region(&self, region: Option<&Region>, kind: EditKind) -> Result<Vec<u32>, Error> {
        match region {
            None => Ok((0..self.surface.triangles.len() as u32).collect()),
            Some(region) => self.faces_touching(region, 3, kind),
        }
    }

    /// The triangles with at least `corners` corners in a region, rising.
    fn faces_touching(&self, region: &Region, corners: usize, kind: EditKind) -> Result<Vec<u32>, Error> {
        let field = format!("{}.region", kind.name());
        let marks = vertices_in_region(&self.regions, region, None).map_err(|e| e.below(&field))?;
        let faces: Vec<u32> = (0u32..)
            .zip(&self.surface.triangles)
            .filter(|(_, t)| t.iter().filter(|&&v| marks[v as usize]).count() >= corners)
            .map(|(t, _)| t)
            .collect();
        if faces.is_empty() {
            let problem = "holds no triangle; a triangle is inside when its three corners are";
            return Err(Error::invalid(field, problem));
        }
        Ok(faces)
    }
}

/// Plans a cut of a surface.
pub(super) fn plan_cut(
    surface: &SurfaceView<'_>,
    along: &CutLine,
    options: &CutOptions<'_>,
    exec: &Exec<'_>,
) -> Result<SurfacePatch, Error> {
    Ok(match along {
        CutLine::Plane(plane) => {
            let (normal, point) = plane.unit_normal_and_point();
            let offset = normal.dot(point);
            edit::cut_by_plane(surface, &CutPlane { normal, offset }, options, exec.progress)?
        }
        CutLine::Polyline { points, closed } => {
            let curve = SurfaceCurve::Drawn(points);
            edit::cut_along_curve(surface, &curve, *closed, options, exec.progress)?
        }
        CutLine::Path { vertices, closed } => {
            let path = points_of(surface, vertices, "cut.path")?;
            edit::cut_along_curve(surface, &SurfaceCurve::Along(&path), *closed, options, exec.progress)?
        }
    })
}

/// The points of render vertices that a field names.
fn points_of(surface: &SurfaceView<'_>, vertices: &[u32], field: &str) -> Result<Vec<u32>, Error> {
    let mut points = Vec::with_capacity(vertices.len());
    for (k, &vertex) in vertices.iter().enumerate() {
        let point = surface.point_of.get(vertex as usize).copied();
        points.push(point.filter(|p| *p != NONE).ok_or_else(|| {
            let count = surface.positions.len();
            let problem =
                format!("is {vertex}, which no triangle uses; the model has {count} vertices, counted from 0");
            Error::invalid(format!("{field}[{k}]"), problem)
        })?);
    }
    Ok(points)
}

/// Moves points; normals and tangents follow, and what stands for other vertices gives them its attributes.
fn plan_smoothing(
    context: &mut EditContext<'_>,
    smooth: &SmoothCommand,
    exec: &Exec<'_>,
) -> Result<SurfacePatch, Error> {
    let faces = context.faces_in_region(smooth.region.as_ref(), EditKind::Smooth)?;
    let progress = exec.progress;
    let options = |sharp_degrees: f64| SmoothOptions {
        iterations: smooth.iterations.unwrap_or(edit::SMOOTHINGS),
        strength: smooth.strength.unwrap_or(edit::SMOOTH_STRENGTH),
        sharp_degrees: smooth.sharp_degrees.unwrap_or(sharp_degrees),
    };
    let mut patch = context.plan_near_origin(|surface| match smooth.kind {
        SmoothKind::Smooth => edit::smooth_region(surface, &faces, &options(180.0), progress),
        SmoothKind::Relax => edit::relax_region(surface, &faces, &options(edit::SHARP_DEGREES), progress),
    })?;
    (context.surface.seams).spread_blends(&mut patch, &context.surface.triangles);
    context.surface.follow_moves(&patch);
    Ok(patch)
}

/// Leaves the surface as it is in the shape.
fn plan_adoption(context: &EditContext<'_>) -> SurfacePatch {
    let mut patch = SurfacePatch::default();
    if context.regions.positions == context.rest {
        let warning = EditWarning::new("adopt-nothing", "the shape is the rest pose already", "");
        patch.warnings.push(warning);
    }
    patch
}

/// Takes away what a cleaning names.
fn plan_cleaning(surface: &SurfaceView<'_>, clean: &CleanCommand, exec: &Exec<'_>) -> Result<SurfacePatch, Error> {
    let faces = unwanted_faces(surface, clean, exec)?;
    if faces.is_empty() {
        let warning = EditWarning::new("clean-nothing", "every part and every triangle stays", "");
        return Ok(SurfacePatch {
            warnings: vec![warning],
            ..SurfacePatch::default()
        });
    }
    Ok(edit::delete_faces(surface, &faces, false, exec.progress)?)
}

/// Joins points; and the render vertices of each point that differ in nothing, as files without indices have them.
fn plan_weld(context: &mut EditContext<'_>, tolerance: f64, exec: &Exec<'_>) -> Result<SurfacePatch, Error> {
    let mut patch = edit::weld_points(&context.surface.surface(), tolerance, exec.progress)?;
    if context.surface.join_equal_vertices() > 0 {
        patch.warnings.retain(|warning| warning.code != edit::NOTHING_TO_WELD);
    }
    Ok(patch)
}

/// Reads the other model that an edit takes.
pub(super) fn read_other(
    other: &OtherModel,
    kind: EditKind,
    limits: &DeformerLimits,
    exec: &Exec<'_>,
) -> Result<(ModelTopology, Mesh), Error> {
    let source = match other.from_session {
        true => "session",
        false => "model",
    };
    let unfit = |e: Error| match e {
        Error::Asset(asset::Error::TooLarge { .. }) | Error::TooLarge { .. } | Error::Cancelled => e,
        other => Error::invalid(format!("{}.{source}", kind.name()), format!("cannot be taken: {other}")),
    };
    let (files, limits) = (other.files.clone(), limits.of_reading());
    if Splats::format_of(&files, other.format).is_some() {
        let problem = match kind {
            EditKind::Merge => "is of Gaussian splats, which have no surface; give the file as a passenger",
            _ => "is of Gaussian splats, which have no surface; give a mesh",
        };
        return Err(Error::invalid(format!("{}.{source}", kind.name()), problem));
    }
    let model = Model::read_watched(files, other.format, &limits, exec.progress).map_err(|e| unfit(e.into()))?;
    let topology = ModelTopology::from_shared_model(Arc::new(model));
    let mesh = topology.mesh(Weld::Rounding).map_err(unfit)?;
    Ok((topology, mesh))
}

/// Appends the other model to surface and origins, and plans how they are joined.
fn plan_merge(context: &mut EditContext<'_>, merge: &ModelMerge, exec: &Exec<'_>) -> Result<SurfacePatch, Error> {
    let (other, mesh) = read_other(&merge.other, EditKind::Merge, &context.limits, exec)?;
    let model = Arc::clone(&other.model);
    let placement = merge.own_from_other;
    let positions: Vec<DVec3> = other.rest.iter().map(|p| placement.transform_point3(*p)).collect();
    check_sizes(context.regions.positions, &positions)?;
    let placed = placed_surface(&other, &mesh, &positions, placement, exec)?;
    let first_point = context.surface.points;
    context.surface.append(&placed);
    let affine = DAffine3::from_mat4(placement);
    context.origins.append(&model, affine, &mesh.source_triangle);
    let surface = context.surface.surface();
    edit::check_faces_at_points(&surface)?;
    let tolerance = merge.tolerance.unwrap_or_else(|| {
        let edges = Adjacency::build(mesh.positions.len(), &mesh.triangles).edges;
        0.5 * mean_edge_length(&mesh.positions, &edges)
    });
    Ok(match merge.join {
        MergeJoin::Loose => SurfacePatch::default(),
        MergeJoin::Weld => edit::weld_boundaries(&surface, first_point, tolerance, exec.progress)?,
        MergeJoin::Stitch => edit::stitch_boundaries(&surface, LoopPair::Appended(first_point), exec.progress)?,
    })
}

/// The surface of a model that is placed by a transform, with normals and tangents turned alike.
fn placed_surface(
    other: &ModelTopology,
    mesh: &Mesh,
    positions: &[DVec3],
    placement: DMat4,
    exec: &Exec<'_>,
) -> Result<EditSurface, Error> {
    let normals_to = DMat3::from_mat4(placement).inverse().transpose();
    let turned: Vec<Vec3> = (other.model.normals.iter())
        .map(|n| (normals_to * n.as_dvec3()).normalize_or_zero().as_vec3())
        .collect();
    let tangents = (other.model.tangents.iter())
        .map(|t| {
            let along = placement.transform_vector3(t.truncate().as_dvec3());
            along.normalize_or_zero().as_vec3().extend(t.w)
        })
        .collect();
    let shading = Shading {
        normals: turned,
        tangents,
    };
    let seams = Seams::find(other.geometry(), &other.rest, mesh, &other.origins(mesh), exec.progress)?;
    let mut surface = EditSurface::new(mesh, other.geometry(), positions, shading, seams);
    if placement.determinant() < 0.0 {
        surface.turn_inside_out();
    }
    Ok(surface)
}

/// Refuses a model that is so much larger than the other, or so far off, that the smaller one would be lost in rounding.
fn check_sizes(own: &[DVec3], placed: &[DVec3]) -> Result<(), Error> {
    let (own, placed) = (BoundingBox::of(own), BoundingBox::of(placed));
    let size = |b: &BoundingBox| (b.max - b.min).length();
    let both = (own.max.max(placed.max) - own.min.min(placed.min)).length();
    let least = size(&own).min(size(&placed));
    if least > 0.0 && both <= LARGEST * least {
        return Ok(());
    }
    let problem = format!(
        "makes both together {:.3e} times as large as the smaller one, allowed is {LARGEST:e}",
        both / least
    );
    Err(Error::invalid("merge.transform", problem))
}
