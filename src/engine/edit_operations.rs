//! Edit requests to operations on a surface: every number checked, regions turned into triangles.

use super::Deformer;
use super::edit::refused;
use super::model_topology::{EditSurface, ModelTopology};
use super::vertex_origins::VertexOrigins;
use crate::asset::{self, FileSet, Format, Model};
use crate::edit::{
    self, CutOptions, CutPlane, KeptSide, LoopPair, MOST_POINTS, PatchedSurface, RemeshTarget, SubdivisionScheme,
    SurfaceCurve, SurfacePatch,
};
use crate::mesh::{Adjacency, BoundingBox, NONE, Weld, mean_edge_length};
use crate::progress::Progress;
use crate::wire::check::{enumerated, number, plane, positive};
use crate::wire::{Error, pb};
use glam::{DAffine3, DMat3, DMat4, DVec3, Vec3};
use pb::edit_request::{self as wire, Operation};
use std::sync::Arc;

/// How many times as large as the smaller of two merged models both together may be: 32-bit positions tell 1e7 apart.
const LARGEST: f64 = 1e6;

/// What an operation is planned on. A merge appends to sheet and origins.
pub(super) struct EditContext<'a> {
    /// The bench, unchanged.
    pub bench: &'a Deformer,
    /// The surface to edit.
    pub sheet: &'a mut EditSurface,
    /// What its vertices are made of.
    pub origins: &'a mut VertexOrigins,
    /// The shape, one position per render vertex.
    pub shape: &'a [DVec3],
    /// The model of another session.
    pub other: Option<&'a FileSet>,
}

/// A planned operation.
pub(super) struct PlannedEdit {
    /// What it changes.
    pub patch: SurfacePatch,
    /// Points along an inserted curve, in the numbers after the edit.
    pub curve: Vec<u32>,
    /// Whether it may leave parts that touch and do not belong together.
    pub parts: bool,
}

impl PlannedEdit {
    /// One render vertex for each point of the curve.
    pub fn curve(&self, applied: &PatchedSurface) -> Vec<u32> {
        if self.curve.is_empty() {
            return Vec::new();
        }
        let mut vertex_of = vec![NONE; applied.points as usize];
        // From the last to the first, so that the first vertex of each point stays.
        for (vertex, &p) in applied.point_of.iter().enumerate().rev() {
            if p != NONE {
                vertex_of[p as usize] = vertex as u32;
            }
        }
        self.curve.iter().map(|&p| vertex_of[p as usize]).collect()
    }
}

/// Plans the operation of a request.
pub(super) fn plan(
    scene: &mut EditContext<'_>,
    request: &pb::EditRequest,
    progress: &dyn Progress,
) -> Result<PlannedEdit, Error> {
    let simple = |patch: SurfacePatch| PlannedEdit {
        patch,
        curve: Vec::new(),
        parts: false,
    };
    match &request.operation {
        None => {
            let allowed = "cut, subdivide, decimate, delete, fill, remesh, merge, insertCurve or weld";
            Err(Error::invalid(
                "operation",
                format!("is missing, allowed is one of {allowed}"),
            ))
        }
        Some(Operation::Cut(cut)) => Ok(PlannedEdit {
            parts: true,
            ..simple(self::cut(scene, cut, progress)?)
        }),
        Some(Operation::Subdivide(subdivide)) => {
            let faces = scene.faces(subdivide.region.as_ref(), "subdivide.region")?;
            let scheme = match enumerated(subdivide.scheme, "subdivide.scheme")? {
                wire::subdivide::Scheme::Loop => SubdivisionScheme::Loop,
                wire::subdivide::Scheme::Midpoint => SubdivisionScheme::Midpoint,
            };
            let patch = edit::subdivide_region(&scene.sheet.surface(), &faces, scheme, progress).map_err(refused)?;
            Ok(simple(patch))
        }
        Some(Operation::Decimate(decimate)) => {
            let ratio = number(decimate.ratio, "decimate.ratio")?;
            let faces = scene.faces(decimate.region.as_ref(), "decimate.region")?;
            let patch = edit::decimate_region(&scene.sheet.surface(), &faces, ratio, progress).map_err(refused)?;
            Ok(simple(patch))
        }
        Some(Operation::Delete(delete)) => {
            if delete.region.is_none() {
                return Err(Error::invalid("delete.region", "is missing; say what is to be deleted"));
            }
            let faces = scene.faces(delete.region.as_ref(), "delete.region")?;
            if faces.len() == scene.sheet.triangles.len() {
                let problem = "holds every triangle; something has to be left";
                return Err(Error::invalid("delete.region", problem));
            }
            let patch = edit::delete_faces(&scene.sheet.surface(), &faces, delete.fill, progress).map_err(refused)?;
            Ok(simple(patch))
        }
        Some(Operation::Fill(fill)) => {
            let faces = match &fill.region {
                Some(region) => Some(scene.touched(region, "fill.region")?),
                None => None,
            };
            let patch = edit::fill_holes(&scene.sheet.surface(), faces.as_deref(), progress).map_err(refused)?;
            Ok(simple(patch))
        }
        Some(Operation::Remesh(remesh)) => self::remesh(scene, remesh, progress).map(simple),
        Some(Operation::Merge(merge)) => self::merge(scene, merge, progress),
        Some(Operation::InsertCurve(curve)) => {
            let line = line(&curve.points, "insertCurve.points", curve.closed)?;
            let (patch, curve) = edit::insert_curve(
                &scene.sheet.surface(),
                &SurfaceCurve::Drawn(&line),
                curve.closed,
                progress,
            )
            .map_err(refused)?;
            Ok(PlannedEdit {
                patch,
                curve,
                parts: false,
            })
        }
        Some(Operation::Weld(weld)) => {
            let tolerance = positive(weld.tolerance, "weld.tolerance")?;
            let patch = edit::weld_points(&scene.sheet.surface(), tolerance, progress).map_err(refused)?;
            Ok(simple(patch))
        }
    }
}

impl EditContext<'_> {
    /// Triangles with all corners in a region; all without one.
    fn faces(&self, region: Option<&pb::Region>, field: &str) -> Result<Vec<u32>, Error> {
        self.bench.faces(self.sheet, self.shape, region, 3, field)
    }

    /// Triangles with a corner in a region.
    fn touched(&self, region: &pb::Region, field: &str) -> Result<Vec<u32>, Error> {
        self.bench.faces(self.sheet, self.shape, Some(region), 1, field)
    }

    /// Which primitives have hard edges where a cap meets a wall: those with normals.
    fn hard(&self) -> Vec<bool> {
        self.sheet.primitives.iter().map(|p| p.has_normals).collect()
    }
}

fn cut(scene: &EditContext<'_>, cut: &wire::Cut, progress: &dyn Progress) -> Result<SurfacePatch, Error> {
    let keep = match enumerated(cut.keep, "cut.keep")? {
        wire::cut::Keep::Both => KeptSide::Both,
        wire::cut::Keep::Above => KeptSide::Above,
        wire::cut::Keep::Below => KeptSide::Below,
    };
    let surface = scene.sheet.surface();
    let hard = scene.hard();
    let options = CutOptions {
        keep,
        fill: cut.fill,
        hard_caps: &hard,
    };
    let ways = [cut.plane.is_some(), !cut.polyline.is_empty(), !cut.path.is_empty()];
    if ways.iter().filter(|w| **w).count() != 1 {
        let seen = ways.iter().filter(|w| **w).count();
        return Err(Error::invalid(
            "cut",
            format!("names {seen} of plane, polyline and path, needed is one"),
        ));
    }
    if let Some(wanted) = &cut.plane {
        let (normal, point) = plane(wanted, "cut.plane")?;
        let cutter = CutPlane {
            normal,
            offset: normal.dot(point),
        };
        return edit::cut_by_plane(&surface, &cutter, &options, progress).map_err(refused);
    }
    if !cut.polyline.is_empty() {
        let line = line(&cut.polyline, "cut.polyline", cut.closed)?;
        let curve = SurfaceCurve::Drawn(&line);
        return edit::cut_along_curve(&surface, &curve, cut.closed, &options, progress).map_err(refused);
    }
    let mut path = Vec::with_capacity(cut.path.len());
    for (k, &vertex) in cut.path.iter().enumerate() {
        let point = surface.point_of.get(vertex as usize).copied();
        match point.filter(|p| *p != NONE) {
            Some(point) => path.push(point),
            None => {
                let count = surface.positions.len();
                let problem =
                    format!("is {vertex}, no vertex of a triangle; the model has {count} vertices, counted from 0");
                return Err(Error::invalid(format!("cut.path[{k}]"), problem));
            }
        }
    }
    edit::cut_along_curve(&surface, &SurfaceCurve::Along(&path), cut.closed, &options, progress).map_err(refused)
}

fn line(values: &[f64], field: &str, closed: bool) -> Result<Vec<DVec3>, Error> {
    let least = if closed { 3 } else { 2 };
    let count = values.len() / 3;
    if !values.len().is_multiple_of(3) || count < least || count > MOST_POINTS {
        let seen = values.len();
        let problem = format!("has {seen} numbers, allowed are three for each of {least} to {MOST_POINTS} points");
        return Err(Error::invalid(field, problem));
    }
    for (k, v) in values.iter().enumerate() {
        number(*v, &format!("{field}[{k}]"))?;
    }
    Ok(values.chunks_exact(3).map(DVec3::from_slice).collect())
}

fn remesh(scene: &EditContext<'_>, remesh: &wire::Remesh, progress: &dyn Progress) -> Result<SurfacePatch, Error> {
    let faces = scene.faces(remesh.region.as_ref(), "remesh.region")?;
    let rest = Arc::clone(scene.bench.rest());
    let target = match (remesh.auto, remesh.edge_length) {
        (true, 0.0) => RemeshTarget::Auto { rest: &rest },
        (true, seen) => {
            let problem = format!("is {seen}, but auto takes its lengths from the rest shape; leave one of them out");
            return Err(Error::invalid("remesh.edgeLength", problem));
        }
        (false, 0.0) => {
            return Err(Error::invalid(
                "remesh.edgeLength",
                "is missing; give a length or set auto",
            ));
        }
        (false, length) => RemeshTarget::Length(positive(length, "remesh.edgeLength")?),
    };
    edit::remesh_region(&scene.sheet.surface(), &faces, target, progress).map_err(refused)
}

/// Appends the other model to sheet and origins, and plans how they are joined.
fn merge(scene: &mut EditContext<'_>, merge: &wire::Merge, progress: &dyn Progress) -> Result<PlannedEdit, Error> {
    let how = enumerated(merge.how, "merge.how")?;
    let placement = placement(&merge.transform)?;
    let files = match (&merge.source, scene.other) {
        (None, _) => {
            return Err(Error::invalid(
                "merge",
                "names no other model, allowed is one of model, session or, in a job, file",
            ));
        }
        (Some(wire::merge::Source::Model(bytes)), _) => FileSet::single("", bytes.clone()),
        (Some(wire::merge::Source::File(name)), _) => {
            let problem = format!("names \"{name}\", but files are read where a job file is run; give the model");
            return Err(Error::invalid("merge.file", problem));
        }
        (Some(wire::merge::Source::Session(_)), Some(files)) => files.clone(),
        (Some(wire::merge::Source::Session(_)), None) => {
            return Err(Error::invalid(
                "merge.session",
                "can only be named where there are sessions; give the model",
            ));
        }
    };
    let format = match merge.format.as_str() {
        "" => None,
        name => Some(Format::from_name(name).ok_or_else(|| {
            let problem = format!("is \"{name}\", allowed are {}", Format::name_list("and"));
            Error::invalid("merge.format", problem)
        })?),
    };
    let source = match merge.source {
        Some(wire::merge::Source::Session(_)) => "merge.session",
        _ => "merge.model",
    };
    let unfit = |e: Error| match e {
        Error::Asset(asset::Error::TooLarge { .. }) | Error::TooLarge { .. } | Error::Cancelled => e,
        other => Error::invalid(source, format!("cannot be taken: {other}")),
    };
    let model = Model::read(files, format, &scene.bench.limits.model).map_err(|e| unfit(e.into()))?;
    let model = Arc::new(model);
    let other = ModelTopology::of(Arc::clone(&model));
    let mesh = other.mesh(Weld::Exact).map_err(unfit)?;
    let place = |p: &DVec3| placement.transform_point3(*p);
    let positions: Vec<DVec3> = other.rest.iter().map(place).collect();
    check_sizes(scene.shape, &positions)?;
    let normals_to = DMat3::from_mat4(placement).inverse().transpose();
    let turned: Vec<Vec3> = (model.normals.iter())
        .map(|n| (normals_to * n.as_dvec3()).normalize_or_zero().as_vec3())
        .collect();
    let tangents = (model.tangents.iter())
        .map(|t| {
            let along = placement.transform_vector3(t.truncate().as_dvec3());
            along.normalize_or_zero().as_vec3().extend(t.w)
        })
        .collect();
    let mut sheet = EditSurface::new(&mesh, other.geometry(), &positions, turned, tangents);
    if placement.determinant() < 0.0 {
        sheet.triangles.iter_mut().for_each(|t| t.swap(1, 2));
    }
    let first_point = scene.sheet.points;
    scene.sheet.append(&sheet);
    let affine = DAffine3::from_mat4(placement);
    scene.origins.append(&model, affine, &mesh.source_triangle);
    let surface = scene.sheet.surface();
    let tolerance = match merge.tolerance {
        0.0 => {
            0.5 * mean_edge_length(
                &mesh.positions,
                &Adjacency::build(mesh.positions.len(), &mesh.triangles).edges,
            )
        }
        given => positive(given, "merge.tolerance")?,
    };
    let patch = match how {
        wire::merge::How::Loose => SurfacePatch::default(),
        wire::merge::How::Weld => edit::weld_boundaries(&surface, first_point, tolerance, progress).map_err(refused)?,
        wire::merge::How::Stitch => {
            edit::stitch_boundaries(&surface, LoopPair::Appended(first_point), progress).map_err(refused)?
        }
    };
    Ok(PlannedEdit {
        patch,
        curve: Vec::new(),
        parts: false,
    })
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

/// Sixteen numbers, column by column; none is the identity.
fn placement(values: &[f64]) -> Result<DMat4, Error> {
    if values.is_empty() {
        return Ok(DMat4::IDENTITY);
    }
    let field = "merge.transform";
    let Ok(columns) = <[f64; 16]>::try_from(values) else {
        let problem = format!("has {} numbers, a transform has 16, column by column", values.len());
        return Err(Error::invalid(field, problem));
    };
    for (k, v) in columns.iter().enumerate() {
        number(*v, &format!("{field}[{k}]"))?;
    }
    let matrix = DMat4::from_cols_array(&columns);
    let affine = matrix.row(3) == glam::DVec4::W;
    let volume = DMat3::from_mat4(matrix).determinant();
    if !(affine && volume.abs() > 1e-30 && volume.is_finite()) {
        let problem = "must be affine (last row 0, 0, 0, 1) and not flatten the model";
        return Err(Error::invalid(field, problem));
    }
    Ok(matrix)
}
