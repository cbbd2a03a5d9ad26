//! Edits as messages and as values of the engine: their names in JSON, what they did, and what a job expects of a result.

use super::check::{enumerated, number, plane, points, positive};
use super::facts::warning_message;
use super::handles::region;
use super::other_model::{OtherSource, other_model};
use super::vertex_targets::float_points_from;
use super::wrap::{wrap_command, wrap_report};
use super::{Error, pb};
use glam::{DMat3, DMat4, DVec3, DVec4};
use pb::edit_request::{self as message, Operation};
use pliant_asset::FileSet;
use pliant_core::engine::{
    CleanCommand, Creases, CutLine, Edit, EditKind, EditReport, EditedShape, MergeJoin, MeshCounts, ModelMerge, OwnCap,
    Region, RemeshCommand, SmoothCommand, SmoothKind, UnintersectCommand, UnintersectReport,
};
use pliant_edit::{KeptSide, MOST_POINTS, SubdivisionScheme};

/// Reads an edit and the shape that it works on. `other` is the model of the session that a merge names.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn edit(request: &pb::EditRequest, other: Option<&FileSet>) -> Result<(Edit, EditedShape), Error> {
    let on = match enumerated(request.on, "on")? {
        message::On::Current => EditedShape::Current,
        message::On::Rest => EditedShape::Rest,
    };
    let edit = match &request.operation {
        None => {
            let allowed = "cut, subdivide, decimate, delete, fill, remesh, smooth, merge, insertCurve, weld, clean, adopt, wrap or unintersect";
            let problem = format!("is missing, allowed is one of {allowed}");
            return Err(Error::invalid("operation", problem));
        }
        Some(Operation::Cut(cut)) => self::cut(cut)?,
        Some(Operation::Subdivide(subdivide)) => self::subdivide(subdivide)?,
        Some(Operation::Decimate(decimate)) => Edit::Decimate {
            ratio: number(decimate.ratio, "decimate.ratio")?,
            region: optional_region(decimate.region.as_ref(), "decimate.region")?,
        },
        Some(Operation::Delete(delete)) => match &delete.region {
            None => return Err(Error::invalid("delete.region", "is missing; say what is to be deleted")),
            some => Edit::Delete {
                region: region(some.as_ref(), "delete.region")?,
                fill: delete.fill,
            },
        },
        Some(Operation::Fill(fill)) => Edit::Fill {
            region: optional_region(fill.region.as_ref(), "fill.region")?,
            cap: own_cap(fill.cap, &fill.material, "fill")?,
        },
        Some(Operation::Remesh(remesh)) => self::remesh(remesh)?,
        Some(Operation::Smooth(smooth)) => self::smooth(smooth)?,
        Some(Operation::Merge(merge)) => Edit::Merge(Box::new(self::merge(merge, other)?)),
        Some(Operation::Wrap(wrap)) => Edit::Wrap(Box::new(wrap_command(wrap, other)?)),
        Some(Operation::Unintersect(unintersect)) => Edit::Unintersect(UnintersectCommand {
            fixed: optional_region(unintersect.fixed.as_ref(), "unintersect.fixed")?,
            clearance: unless_zero(unintersect.clearance, "unintersect.clearance")?,
        }),
        Some(Operation::InsertCurve(curve)) => Edit::InsertCurve {
            points: line(&curve.points, "insertCurve.points", curve.closed)?,
            closed: curve.closed,
        },
        Some(Operation::Weld(weld)) => Edit::Weld {
            tolerance: positive(weld.tolerance, "weld.tolerance")?,
        },
        Some(Operation::Clean(clean)) => Edit::Clean(self::clean(clean)?),
        Some(Operation::Adopt(adopt)) => self::adopt(adopt)?,
    };
    Ok((edit, on))
}

/// Returns the JSON name of an edit's operation.
pub fn edit_name(edit: &pb::EditRequest) -> &'static str {
    match &edit.operation {
        Some(Operation::Cut(_)) => EditKind::Cut.name(),
        Some(Operation::Subdivide(_)) => EditKind::Subdivide.name(),
        Some(Operation::Decimate(_)) => EditKind::Decimate.name(),
        Some(Operation::Delete(_)) => EditKind::Delete.name(),
        Some(Operation::Fill(_)) => EditKind::Fill.name(),
        Some(Operation::Remesh(_)) => EditKind::Remesh.name(),
        Some(Operation::Smooth(_)) => EditKind::Smooth.name(),
        Some(Operation::Merge(_)) => EditKind::Merge.name(),
        Some(Operation::InsertCurve(_)) => EditKind::InsertCurve.name(),
        Some(Operation::Weld(_)) => EditKind::Weld.name(),
        Some(Operation::Clean(_)) => EditKind::Clean.name(),
        Some(Operation::Adopt(_)) => EditKind::Adopt.name(),
        Some(Operation::Wrap(_)) => EditKind::Wrap.name(),
        Some(Operation::Unintersect(_)) => EditKind::Unintersect.name(),
        None => "none",
    }
}

/// Writes what an edit did; revision and times are the caller's.
pub fn edit_result(report: &EditReport) -> pb::EditResult {
    let counts = |c: MeshCounts| pb::edit_result::Counts {
        vertices: c.vertices,
        faces: c.faces,
    };
    pb::EditResult {
        before: Some(counts(report.before)),
        after: Some(counts(report.after)),
        handles_kept: report.handles_kept.clone(),
        warnings: report.warnings.iter().map(warning_message).collect(),
        kept: (report.kept.iter())
            .map(|run| pb::edit_result::Run {
                was: run.was,
                now: run.now,
                count: run.count,
            })
            .collect(),
        curve: report.curve.clone(),
        creases: report.creases.as_flattened().to_vec(),
        deviation: report.deviation,
        volume_change: report.volume_change,
        digest: report.digest.clone(),
        wrap: report.wrap.as_ref().map(wrap_report),
        unintersect: report.unintersect.as_ref().map(unintersect_report),
        repaired: report.repaired,
        ..Default::default()
    }
}

fn unintersect_report(report: &UnintersectReport) -> pb::UnintersectReport {
    let UnintersectReport {
        crossings_before,
        crossings,
        moved_vertices,
        largest_move,
        rms_move,
        largest_move_in_edges,
        rms_move_in_edges,
    } = *report;
    pb::UnintersectReport {
        crossings_before,
        crossings,
        moved_vertices,
        largest_move,
        rms_move,
        largest_move_in_edges,
        rms_move_in_edges,
    }
}

/// Longest name of a shape that comes in parts.
const MOST_NAME_BYTES: usize = 64;

/// Reads a shape that is given, or a part of one; whether there are as many vertices as the model has depends on that.
fn adopt(adopt: &message::Adopt) -> Result<Edit, Error> {
    if adopt.positions.is_empty() && (adopt.first > 0 || adopt.more) {
        let problem = "is empty; positions are needed beside first and more";
        return Err(Error::invalid("adopt.positions", problem));
    }
    if (adopt.first > 0 || adopt.more) && !(1..=MOST_NAME_BYTES).contains(&adopt.shape.len()) {
        let problem = format!(
            "has {} bytes; a shape in parts needs a name that the caller makes up, of 1 to {MOST_NAME_BYTES} bytes, the same in all parts",
            adopt.shape.len()
        );
        return Err(Error::invalid("adopt.shape", problem));
    }
    let positions = float_points_from(&adopt.positions, "adopt.positions", adopt.first)?;
    Ok(Edit::Adopt { positions })
}

fn optional_region(message: Option<&pb::Region>, field: &str) -> Result<Option<Region>, Error> {
    message.map(|r| region(Some(r), field)).transpose()
}

fn cut(cut: &message::Cut) -> Result<Edit, Error> {
    let keep = match enumerated(cut.keep, "cut.keep")? {
        message::cut::Keep::Both => KeptSide::Both,
        message::cut::Keep::Above => KeptSide::Above,
        message::cut::Keep::Below => KeptSide::Below,
    };
    let ways = [cut.plane.is_some(), !cut.polyline.is_empty(), !cut.path.is_empty()];
    let seen = ways.iter().filter(|w| **w).count();
    if seen != 1 {
        let problem = format!("names {seen} of plane, polyline and path, needed is one");
        return Err(Error::invalid("cut", problem));
    }
    let along = if let Some(wanted) = &cut.plane {
        CutLine::Plane(plane(wanted, "cut.plane")?)
    } else if !cut.polyline.is_empty() {
        CutLine::Polyline {
            points: line(&cut.polyline, "cut.polyline", cut.closed)?,
            closed: cut.closed,
        }
    } else {
        CutLine::Path {
            vertices: cut.path.clone(),
            closed: cut.closed,
        }
    };
    let cap = own_cap(cut.cap, &cut.material, "cut")?;
    if cap.is_some() && !cut.fill {
        return Err(Error::invalid("cut.cap", "is FLAT, but there is no cap without fill"));
    }
    Ok(Edit::Cut {
        along,
        keep,
        fill: cut.fill,
        cap,
    })
}

/// The cap that is asked for, when it is to have a material of its own.
fn own_cap(cap: i32, material: &str, place: &str) -> Result<Option<OwnCap>, Error> {
    match enumerated(cap, &format!("{place}.cap"))? {
        message::Cap::Continued if !material.is_empty() => {
            let problem = format!("is \"{material}\", but only a FLAT cap has a material of its own");
            Err(Error::invalid(format!("{place}.material"), problem))
        }
        message::Cap::Continued => Ok(None),
        message::Cap::Flat if material.len() > MOST_NAME || material.chars().any(char::is_control) => {
            let problem = format!("allowed are names of up to {MOST_NAME} bytes without control characters");
            Err(Error::invalid(format!("{place}.material"), problem))
        }
        message::Cap::Flat => Ok(Some(OwnCap {
            material: if material.is_empty() { "cap" } else { material }.to_owned(),
        })),
    }
}

/// The longest name of a material, bytes.
const MOST_NAME: usize = 256;

fn line(values: &[f64], field: &str, closed: bool) -> Result<Vec<DVec3>, Error> {
    let least = if closed { 3 } else { 2 };
    points(values, least..=MOST_POINTS, field, |seen| {
        format!("has {seen} numbers, allowed are three for each of {least} to {MOST_POINTS} points")
    })
}

fn remesh(remesh: &message::Remesh) -> Result<Edit, Error> {
    let field = "remesh.edgeLength";
    let region = optional_region(remesh.region.as_ref(), "remesh.region")?;
    let edge_length = match (remesh.auto, remesh.edge_length) {
        (true, 0.0) => None,
        (true, seen) => {
            let problem = format!("is {seen}, but auto takes its lengths from the rest shape; leave one of them out");
            return Err(Error::invalid(field, problem));
        }
        (false, 0.0) => return Err(Error::invalid(field, "is missing; give a length or set auto")),
        (false, length) => Some(positive(length, field)?),
    };
    Ok(Edit::Remesh(RemeshCommand {
        region,
        edge_length,
        max_deviation: unless_zero(remesh.max_deviation, "remesh.maxDeviation")?,
        sharp_degrees: unless_zero(remesh.sharp_degrees, "remesh.sharpDegrees")?,
    }))
}

fn subdivide(subdivide: &message::Subdivide) -> Result<Edit, Error> {
    let region = optional_region(subdivide.region.as_ref(), "subdivide.region")?;
    let scheme = match enumerated(subdivide.scheme, "subdivide.scheme")? {
        message::subdivide::Scheme::Loop => SubdivisionScheme::Loop,
        message::subdivide::Scheme::Midpoint => SubdivisionScheme::Midpoint,
    };
    let (pairs, rest) = subdivide.creases.as_chunks();
    if !rest.is_empty() {
        let seen = subdivide.creases.len();
        let problem = format!("has {seen} vertices, two are needed for each edge");
        return Err(Error::invalid("subdivide.creases", problem));
    }
    let creases = Creases {
        degrees: unless_zero(subdivide.crease_degrees, "subdivide.creaseDegrees")?,
        edges: pairs.to_vec(),
        between_primitives: subdivide.crease_primitives,
        sharpness: unless_zero(subdivide.sharpness, "subdivide.sharpness")?,
    };
    if subdivide.auto || scheme != SubdivisionScheme::Loop {
        let given = [
            (creases.degrees.is_some(), "creaseDegrees"),
            (!creases.edges.is_empty(), "creases"),
            (creases.between_primitives, "creasePrimitives"),
            (creases.sharpness.is_some(), "sharpness"),
        ];
        if let Some((_, field)) = given.iter().find(|(is_given, _)| *is_given) {
            let problem = "says what stays sharp, but without LOOP every edge stays as it is; leave it out";
            return Err(Error::invalid(format!("subdivide.{field}"), problem));
        }
    }
    Ok(match subdivide.auto {
        true => Edit::SubdivideForPose { region },
        false => Edit::Subdivide {
            region,
            scheme,
            creases,
        },
    })
}

/// A positive number; 0 is none.
fn unless_zero(value: f64, field: &str) -> Result<Option<f64>, Error> {
    match value {
        0.0 => Ok(None),
        given => positive(given, field).map(Some),
    }
}

fn clean(clean: &message::Clean) -> Result<CleanCommand, Error> {
    let smallest_share = unless_zero(clean.smallest_share, "clean.smallestShare")?;
    if let Some(share) = smallest_share.filter(|share| *share > 1.0) {
        let problem = format!("is {share}, allowed is a share of the largest part's area, up to 1");
        return Err(Error::invalid("clean.smallestShare", problem));
    }
    let command = CleanCommand {
        keep_largest: (clean.keep_largest > 0).then_some(clean.keep_largest),
        smallest_share,
        smallest_size: unless_zero(clean.smallest_size, "clean.smallestSize")?,
        duplicates_within: unless_zero(clean.duplicates_within, "clean.duplicatesWithin")?,
    };
    if command == CleanCommand::default() {
        let problem = "takes nothing away, give one of keepLargest, smallestShare, smallestSize and duplicatesWithin";
        return Err(Error::invalid("clean", problem));
    }
    Ok(command)
}

fn smooth(smooth: &message::Smooth) -> Result<Edit, Error> {
    Ok(Edit::Smooth(SmoothCommand {
        region: optional_region(smooth.region.as_ref(), "smooth.region")?,
        kind: match enumerated(smooth.kind, "smooth.kind")? {
            message::smooth::Kind::Smooth => SmoothKind::Smooth,
            message::smooth::Kind::Relax => SmoothKind::Relax,
        },
        iterations: (smooth.iterations > 0).then_some(smooth.iterations),
        // The edit itself knows the ranges.
        strength: (smooth.strength != 0.0).then_some(smooth.strength),
        sharp_degrees: (smooth.sharp_degrees != 0.0).then_some(smooth.sharp_degrees),
    }))
}

fn merge(merge: &message::Merge, other: Option<&FileSet>) -> Result<ModelMerge, Error> {
    let join = match enumerated(merge.how, "merge.how")? {
        message::merge::How::Weld => MergeJoin::Weld,
        message::merge::How::Stitch => MergeJoin::Stitch,
        message::merge::How::Loose => MergeJoin::Loose,
    };
    let own_from_other = placement(&merge.transform)?;
    Ok(ModelMerge {
        other: other_model(OtherSource::of_merge(merge), &merge.format, "merge", other)?,
        own_from_other,
        join,
        tolerance: match merge.tolerance {
            0.0 => None,
            given => Some(positive(given, "merge.tolerance")?),
        },
    })
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
    let affine = matrix.row(3) == DVec4::W;
    let volume = DMat3::from_mat4(matrix).determinant();
    if !(affine && volume.abs() > 1e-30 && volume.is_finite()) {
        let problem = "must be affine (last row 0, 0, 0, 1) and not flatten the model";
        return Err(Error::invalid(field, problem));
    }
    Ok(matrix)
}

impl pb::Job {
    /// How the job's poses are solved: its options, with a count of crossings where the job expects few.
    pub fn pose_options(&self) -> pb::Options {
        let mut options = self.options.unwrap_or_default();
        if self.expect.as_ref().is_some_and(|e| e.new_self_intersections.is_some()) {
            options.output.get_or_insert_default().self_intersections = true;
        }
        options
    }
}

impl pb::Expect {
    /// Refuses bounds that nothing could exceed, or everything, and a digest that no positions have. `place` is where the
    /// expectations stand.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the bound's path.
    pub fn check(&self, place: &str) -> Result<(), Error> {
        let bounds = [
            ("maxDistance", self.max_distance),
            ("meanDistance", self.mean_distance),
            ("normalDegrees", self.normal_degrees),
            ("volumeChange", self.volume_change),
        ];
        for (name, most) in bounds.into_iter().filter_map(|(name, most)| Some((name, most?))) {
            if !(most.is_finite() && most >= 0.0) {
                let problem = format!("is {most:?}, a finite number of at least 0 is needed");
                return Err(Error::invalid(format!("{place}.{name}"), problem));
            }
        }
        if !(self.digest.is_empty() || can_be_digest(&self.digest)) {
            let problem = format!(
                "is {:?}, \"xxh3:\" and 16 hexadecimal digits in small letters are needed, as reports print it",
                self.digest
            );
            return Err(Error::invalid(format!("{place}.digest"), problem));
        }
        Ok(())
    }
}

/// Whether positions can have this digest.
fn can_be_digest(text: &str) -> bool {
    let is_digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
    text.strip_prefix("xxh3:")
        .is_some_and(|digits| digits.len() == 16 && digits.bytes().all(is_digit))
}
