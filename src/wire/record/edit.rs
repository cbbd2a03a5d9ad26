//! Edits as messages, for the store: reading one again gives the same edit. The files of a merge are kept apart.

use crate::edit::{KeptSide, SubdivisionScheme};
use crate::engine::{CutLine, Edit, EditedShape, MergeJoin, ModelMerge, Plane, Region};
use crate::wire::{pb, region_message};
use glam::{DMat4, DVec3};
use pb::edit_request::{self as message, Operation};

/// Writes an edit and the shape that it works on. A merge names a session, whose files the reader has to bring.
pub(super) fn edit_message(edit: &Edit, on: EditedShape) -> pb::EditRequest {
    let operation = match edit {
        Edit::Cut { along, keep, fill } => Operation::Cut(cut_message(along, *keep, *fill)),
        Edit::Subdivide { region, scheme } => Operation::Subdivide(message::Subdivide {
            region: optional(region.as_ref()),
            scheme: match scheme {
                SubdivisionScheme::Loop => message::subdivide::Scheme::Loop,
                SubdivisionScheme::Midpoint => message::subdivide::Scheme::Midpoint,
            }
            .into(),
            auto: false,
        }),
        Edit::SubdivideForPose { region } => Operation::Subdivide(message::Subdivide {
            region: optional(region.as_ref()),
            auto: true,
            ..Default::default()
        }),
        Edit::Decimate { region, ratio } => Operation::Decimate(message::Decimate {
            region: optional(region.as_ref()),
            ratio: *ratio,
        }),
        Edit::Delete { region, fill } => Operation::Delete(message::Delete {
            region: Some(region_message(region)),
            fill: *fill,
        }),
        Edit::Fill { region } => Operation::Fill(message::Fill {
            region: optional(region.as_ref()),
        }),
        Edit::Remesh(remesh) => Operation::Remesh(message::Remesh {
            region: optional(remesh.region.as_ref()),
            edge_length: remesh.edge_length.unwrap_or(0.0),
            auto: remesh.edge_length.is_none(),
            max_deviation: remesh.max_deviation.unwrap_or(0.0),
            sharp_degrees: remesh.sharp_degrees.unwrap_or(0.0),
        }),
        Edit::Merge(merge) => Operation::Merge(merge_message(merge)),
        Edit::InsertCurve { points, closed } => Operation::InsertCurve(message::InsertCurve {
            points: flat(points),
            closed: *closed,
        }),
        Edit::Weld { tolerance } => Operation::Weld(message::Weld { tolerance: *tolerance }),
    };
    pb::EditRequest {
        session_id: String::new(),
        on: match on {
            EditedShape::Current => message::On::Current,
            EditedShape::Rest => message::On::Rest,
        }
        .into(),
        operation: Some(operation),
    }
}

fn optional(region: Option<&Region>) -> Option<pb::Region> {
    region.map(region_message)
}

fn flat(points: &[DVec3]) -> Vec<f64> {
    points.iter().flat_map(|p| p.to_array()).collect()
}

fn cut_message(along: &CutLine, keep: KeptSide, fill: bool) -> message::Cut {
    let cut = message::Cut {
        keep: match keep {
            KeptSide::Both => message::cut::Keep::Both,
            KeptSide::Above => message::cut::Keep::Above,
            KeptSide::Below => message::cut::Keep::Below,
        }
        .into(),
        fill,
        ..Default::default()
    };
    match along {
        CutLine::Plane(Plane { normal, offset }) => message::Cut {
            plane: Some(pb::Plane {
                normal: normal.to_array().to_vec(),
                offset: *offset,
            }),
            ..cut
        },
        CutLine::Polyline { points, closed } => message::Cut {
            polyline: flat(points),
            closed: *closed,
            ..cut
        },
        CutLine::Path { vertices, closed } => message::Cut {
            path: vertices.clone(),
            closed: *closed,
            ..cut
        },
    }
}

fn merge_message(merge: &ModelMerge) -> message::Merge {
    message::Merge {
        source: Some(message::merge::Source::Session(String::new())),
        transform: match merge.own_from_other == DMat4::IDENTITY {
            true => Vec::new(),
            false => merge.own_from_other.to_cols_array().to_vec(),
        },
        how: match merge.join {
            MergeJoin::Weld => message::merge::How::Weld,
            MergeJoin::Stitch => message::merge::How::Stitch,
            MergeJoin::Loose => message::merge::How::Loose,
        }
        .into(),
        tolerance: merge.tolerance.unwrap_or(0.0),
        format: merge.format.map_or_else(String::new, |f| f.name().into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::FileSet;

    #[test]
    fn every_edit_comes_back_as_it_was_written() {
        let region = r#"{"sphere": {"center": [1, 2, 3], "radius": 0.25}}"#;
        let texts = [
            r#"{"cut": {"plane": {"normal": [0, 0, 1], "offset": 0.5}, "keep": "ABOVE", "fill": true}}"#.to_owned(),
            r#"{"on": "REST", "cut": {"polyline": [0, 0, 0, 1, 0, 0, 1, 1, 0], "closed": true, "keep": "BELOW"}}"#
                .into(),
            r#"{"cut": {"path": [4, 5, 9]}}"#.into(),
            format!(r#"{{"subdivide": {{"region": {region}, "scheme": "MIDPOINT"}}}}"#),
            r#"{"subdivide": {}}"#.into(),
            r#"{"subdivide": {"auto": true}}"#.into(),
            format!(r#"{{"decimate": {{"ratio": 0.3, "region": {region}}}}}"#),
            format!(r#"{{"delete": {{"fill": true, "region": {region}}}}}"#),
            format!(r#"{{"fill": {{"region": {region}}}}}"#),
            r#"{"fill": {}}"#.into(),
            format!(r#"{{"remesh": {{"edgeLength": 0.1, "region": {region}}}}}"#),
            r#"{"remesh": {"auto": true}}"#.into(),
            r#"{"remesh": {"auto": true, "maxDeviation": 0.01, "sharpDegrees": 25}}"#.into(),
            r#"{"merge": {"session": "x", "how": "LOOSE", "tolerance": 0.1, "format": "obj"}}"#.into(),
            r#"{"merge": {"session": "x", "how": "STITCH", "transform": [1,0,0,0, 0,2,0,0, 0,0,3,0, 4,5,6,1]}}"#.into(),
            r#"{"insertCurve": {"points": [0, 0, 0, 1, 0, 0], "closed": false}}"#.into(),
            r#"{"weld": {"tolerance": 0.001}}"#.into(),
        ];
        for text in texts {
            let request: pb::EditRequest = crate::wire::json::from_json(text.as_bytes()).expect(&text);
            let files = FileSet::single("a", &b"abc"[..]);
            let (edit, on) = crate::wire::edit(&request, Some(&files)).expect(&text);
            let (again, on_again) = crate::wire::edit(&edit_message(&edit, on), Some(&files)).expect(&text);
            assert_eq!(format!("{edit:?} {on:?}"), format!("{again:?} {on_again:?}"), "{text}");
        }
    }
}
