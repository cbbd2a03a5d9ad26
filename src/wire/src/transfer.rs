//! Transfers: the checked request, and what came.

use super::other_model::{OtherSource, other_model};
use super::wrap::{landmarks, wrap_report};
use super::{Error, pb};
use pb::transfer_request::Source;
use pliant_asset::{FileSet, Format};
use pliant_core::engine::{OutfitFit, TransferCommand, TransferReport};

/// What is to come to a session's model from another one. Made by [`transfer_order`].
#[derive(Debug, Clone)]
pub struct TransferOrder {
    /// What is to be done. The files of another session are empty until that session is asked for them.
    pub command: TransferCommand,
    /// The other session.
    pub other_session: Option<String>,
}

/// Reads a request for a transfer, whose answer is asked for in a format.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn transfer_order(request: &pb::TransferRequest, format: Option<Format>) -> Result<TransferOrder, Error> {
    let source = request.source.as_ref().map(|source| match source {
        Source::Model(bytes) => OtherSource::Model(bytes),
        Source::Session(id) => OtherSource::Session(id),
    });
    let none = FileSet::default();
    let shape = match request.shape.is_empty() {
        true => None,
        false => {
            let bytes = Some(OtherSource::Model(&request.shape));
            let shape = other_model(bytes, &request.shape_format, "shape", None);
            Some(shape.map_err(|e| renamed(e, "shape.format", "shapeFormat"))?)
        }
    };
    let fit = request.fit.as_ref().map(outfit_fit).transpose()?;
    if fit.is_some() && shape.is_none() {
        return Err(Error::invalid(
            "shape",
            "is missing: with fit, the body that the outfit is to fit",
        ));
    }
    if shape.is_none() && format.is_some_and(|format| format != Format::GLB) {
        return Err(Error::invalid(
            "output",
            "names another format than glb, which alone takes blend shapes",
        ));
    }
    Ok(TransferOrder {
        command: TransferCommand {
            source: (other_model(source, &request.format, "model", Some(&none)))
                .map_err(|e| renamed(e, "model.format", "format"))?,
            shape,
            fit,
            landmarks: landmarks(&request.landmarks, "landmarks")?,
            format,
        },
        other_session: match &request.source {
            Some(Source::Session(id)) => Some(id.clone()),
            _ => None,
        },
    })
}

fn outfit_fit(fit: &pb::transfer_request::Fit) -> Result<OutfitFit, Error> {
    match fit.clearance {
        Some(clearance) if !(clearance.is_finite() && clearance >= 0.0) => {
            Err(Error::invalid("fit.clearance", "must be a length, 0 or more"))
        }
        clearance => Ok(OutfitFit { clearance }),
    }
}

/// An error about a field by the name that it has in the request.
fn renamed(error: Error, seen: &str, name: &str) -> Error {
    match error {
        Error::Invalid { field, problem } if field == seen => Error::invalid(name, problem),
        other => other,
    }
}

/// Writes what came.
pub fn transfer_report(report: &TransferReport) -> pb::TransferReport {
    let shapes = report.shapes.iter().map(|shape| pb::transfer_report::Shape {
        name: shape.name.clone(),
        moved_vertices: shape.moved_vertices,
        largest_move: shape.largest_move,
        flipped_triangles: shape.flipped_triangles,
        flipped_in_source: shape.flipped_in_source,
    });
    let fit = report.fit.map(|fit| pb::transfer_report::Fit {
        vertices: fit.vertices,
        inside_at_rest: fit.inside_at_rest,
        inside_carried: fit.inside_carried,
        inside: fit.inside,
        crossings_carried: fit.crossings_carried,
        crossings: fit.crossings,
        edge_distortion: fit.edge_distortion,
    });
    pb::TransferReport {
        fit,
        shapes: shapes.collect(),
        clips: report.clips,
        wrap: report.wrap.as_ref().map(wrap_report),
    }
}
