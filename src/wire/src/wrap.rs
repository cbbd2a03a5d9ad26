//! A wrap as messages and as values of the engine.

use super::check::vector;
use super::handles::region;
use super::other_model::{OtherSource, other_model};
use super::{Error, pb};
use pliant_asset::FileSet;
use pliant_core::engine::{LandmarkPlace, WrapCommand, WrapDistances, WrapLandmark, WrapReport};

/// Most landmarks of a wrap.
const MOST_LANDMARKS: usize = 4096;

/// Reads a wrap; `session` is the model of the session that it names.
pub(super) fn wrap_command(wrap: &pb::edit_request::Wrap, session: Option<&FileSet>) -> Result<WrapCommand, Error> {
    Ok(WrapCommand {
        landmarks: landmarks(&wrap.landmarks, "wrap.landmarks")?,
        mask: (wrap.mask.as_ref())
            .map(|mask| region(Some(mask), "wrap.mask"))
            .transpose()?,
        in_place: wrap.in_place,
        target: other_model(OtherSource::of_wrap(wrap), &wrap.format, "wrap", session)?,
    })
}

/// Reads the landmarks of a field.
pub(super) fn landmarks(all: &[pb::edit_request::wrap::Landmark], field: &str) -> Result<Vec<WrapLandmark>, Error> {
    if all.len() > MOST_LANDMARKS {
        let problem = format!("has {} landmarks, at most {MOST_LANDMARKS} are allowed", all.len());
        return Err(Error::invalid(field, problem));
    }
    let landmarks = all.iter().enumerate().map(|(k, landmark)| {
        let field = format!("{field}[{k}]");
        Ok(WrapLandmark {
            own: place(landmark.own_vertex, &landmark.own_point, &field, "own")?,
            target: place(landmark.target_vertex, &landmark.target_point, &field, "target")?,
        })
    });
    landmarks.collect()
}

fn place(vertex: Option<u32>, point: &[f64], field: &str, side: &str) -> Result<LandmarkPlace, Error> {
    match (vertex, point) {
        (Some(vertex), []) => Ok(LandmarkPlace::Vertex(vertex)),
        (None, [_, ..]) => Ok(LandmarkPlace::Point(vector(point, &format!("{field}.{side}Point"))?)),
        (seen, _) => {
            let names = if seen.is_some() { "both" } else { "neither" };
            let problem = format!("names {names} of {side}Vertex and {side}Point, needed is one");
            Err(Error::invalid(field, problem))
        }
    }
}

/// Writes how well a wrapped surface lies on its target.
pub(super) fn wrap_report(report: &WrapReport) -> pb::WrapReport {
    let distances = |d: &WrapDistances| pb::wrap_report::Distances {
        p50: d.p50,
        p95: d.p95,
        max: d.max,
    };
    let WrapReport {
        to_target,
        from_target,
        landmarks,
        vertices,
        unpulled_vertices,
        flipped_triangles,
        edge_distortion,
        crossings_before,
        crossings,
    } = report;
    pb::WrapReport {
        to_target: Some(distances(to_target)),
        from_target: Some(distances(from_target)),
        landmarks: Some(distances(landmarks)),
        vertices: *vertices,
        unpulled_vertices: *unpulled_vertices,
        flipped_triangles: *flipped_triangles,
        edge_distortion: *edge_distortion,
        crossings_before: *crossings_before,
        crossings: *crossings,
    }
}
