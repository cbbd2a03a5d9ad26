//! Handles and regions as messages and as values of the engine.
//!
//! Changes of single fields of one handle.

use super::anchors::{anchors, anchors_message};
use super::check::{enumerated, number, optional_within, plane, points, positive, vector};
use super::guides::{guide, guide_message};
use super::poses::{handle_pose, handle_pose_message};
use super::{Error, pb};
use glam::DVec3;
use pliant_core::engine::{
    DefaultPivot, Falloff, FalloffCurve, Guide, Handle, HandleConstrains, HandlePose, HandleSet, MOST_TUBE_POINTS,
    Plane, Region, Stiff, StiffnessPer, VertexRange,
};
use std::collections::BTreeSet;
use std::sync::Arc;

/// Reads a set of handles.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn handle_set(request: &pb::SetHandlesRequest) -> Result<HandleSet, Error> {
    let symmetry_plane = request.symmetry_plane.as_ref();
    let symmetry_plane = symmetry_plane.map(|p| plane(p, "symmetryPlane")).transpose()?;
    let mut ids = BTreeSet::new();
    let mut handles = Vec::with_capacity(request.handles.len());
    for (k, message) in request.handles.iter().enumerate() {
        let field = format!("handles[{k}]");
        check_handle_id(&message.id, &field)?;
        if !ids.insert(message.id.as_str()) {
            let problem = format!("\"{}\" is used twice", message.id);
            return Err(Error::invalid(format!("{field}.id"), problem));
        }
        handles.push(handle(message, &field)?);
    }
    let interest = request.region_of_interest.as_ref();
    Ok(HandleSet {
        handles,
        symmetry_plane,
        region_of_interest: interest.map(|r| region(Some(r), "regionOfInterest")).transpose()?,
        stiff: request.stiff.as_ref().map(stiff).transpose()?,
        default_pivot: DefaultPivot::Joint,
    })
}

/// Reads which parts are stiff.
fn stiff(message: &pb::Stiff) -> Result<Stiff, Error> {
    let strength = message.strength.unwrap_or(1.0);
    if !(strength > 0.0 && strength <= 1.0) {
        return Err(Error::invalid(
            "stiff.strength",
            format!("is {strength}, allowed are above 0 to 1"),
        ));
    }
    let listed = [
        message.primitives.len(),
        message.components.len(),
        message.regions.len(),
    ];
    if !message.all && !message.auto && listed == [0; 3] {
        let problem = "names nothing, allowed are primitives, components, regions, all or auto";
        return Err(Error::invalid("stiff", problem));
    }
    let kinds = ["primitives", "components", "regions"];
    let most = [MOST_STIFF, MOST_STIFF, MOST_STIFF_REGIONS];
    let mut lists = kinds.into_iter().zip(listed).zip(most);
    if let Some(((kind, count), most)) = lists.find(|((_, count), most)| count > most) {
        let problem = format!("has {count} entries, at most {most} are allowed; all and auto take any number of parts");
        return Err(Error::invalid(format!("stiff.{kind}"), problem));
    }
    let regions = message.regions.iter().enumerate();
    Ok(Stiff {
        primitives: message.primitives.clone(),
        components: message.components.clone(),
        regions: regions
            .map(|(k, r)| region(Some(r), &format!("stiff.regions[{k}]")))
            .collect::<Result<_, _>>()?,
        all: message.all,
        auto: message.auto,
        strength,
    })
}

fn stiff_message(stiff: &Stiff) -> pb::Stiff {
    pb::Stiff {
        primitives: stiff.primitives.clone(),
        components: stiff.components.clone(),
        regions: stiff.regions.iter().map(region_message).collect(),
        all: stiff.all,
        auto: stiff.auto,
        strength: (stiff.strength < 1.0).then_some(stiff.strength),
    }
}

/// Most primitives and components that are listed as stiff, and most regions: each is looked for in all vertices.
const MOST_STIFF: usize = 4096;
const MOST_STIFF_REGIONS: usize = 256;

fn handle(handle: &pb::Handle, field: &str) -> Result<Handle, Error> {
    let region = region(handle.region.as_ref(), &format!("{field}.region"))?;
    let pose = handle.pose.as_ref();
    let pose = pose.map(|p| handle_pose(p, &format!("{field}.pose"))).transpose()?;
    Ok(Handle {
        id: handle.id.clone(),
        region,
        constrains: match &handle.constrains[..] {
            [] if handle.targets.is_some() || handle.guide.is_some() => POSITION_ALONE,
            named => handle_constrains(named, &format!("{field}.constrains"))?,
        },
        stiffness: handle_stiffness(handle.stiffness, &format!("{field}.stiffness"))?,
        rigid: handle.rigid,
        pose,
        falloff: handle_falloff(handle.falloff.as_ref(), &format!("{field}.falloff"))?,
        targets: handle_targets(handle.targets.as_ref(), &format!("{field}.targets"))?
            .or(handle.guide.as_ref().map(|_| StiffnessPer::Vertex)),
        tangential: handle_tangential(handle.targets.as_ref(), &format!("{field}.targets"))?,
        guide: guide(handle.guide.as_ref(), &format!("{field}.guide"))?,
    })
}

/// What a handle with targets fixes that names nothing.
const POSITION_ALONE: HandleConstrains = HandleConstrains {
    position: true,
    rotation: false,
    scale: false,
};

/// Reads whether a handle has targets, and what its stiffness is for then.
fn handle_targets(targets: Option<&pb::handle::Targets>, field: &str) -> Result<Option<StiffnessPer>, Error> {
    let per = |targets: &pb::handle::Targets| {
        Ok(
            match enumerated(targets.stiffness_per, &format!("{field}.stiffnessPer"))? {
                pb::handle::targets::StiffnessPer::Vertex => StiffnessPer::Vertex,
                pb::handle::targets::StiffnessPer::Area => StiffnessPer::Area,
            },
        )
    };
    targets.map(per).transpose()
}

/// Reads how far targets leave the pull along the surface out.
fn handle_tangential(targets: Option<&pb::handle::Targets>, field: &str) -> Result<f64, Error> {
    match targets.map_or(0.0, |targets| targets.tangential) {
        share if (0.0..=1.0).contains(&share) => Ok(share),
        share => {
            let problem = format!("is {share}, allowed are 0 to 1");
            Err(Error::invalid(format!("{field}.tangential"), problem))
        }
    }
}

/// Refuses the id of a handle that is empty or too long.
pub(super) fn check_handle_id(id: &str, field: &str) -> Result<(), Error> {
    if id.is_empty() || id.len() > 128 {
        let problem = format!("has {} bytes, allowed are 1 to 128", id.len());
        return Err(Error::invalid(format!("{field}.id"), problem));
    }
    Ok(())
}

/// Reads what a handle fixes; an empty list is everything.
pub(super) fn handle_constrains(named: &[i32], field: &str) -> Result<HandleConstrains, Error> {
    if named.is_empty() {
        return Ok(HandleConstrains::ALL);
    }
    let mut constrains = HandleConstrains {
        position: false,
        rotation: false,
        scale: false,
    };
    for (k, &c) in named.iter().enumerate() {
        match enumerated(c, &format!("{field}[{k}]"))? {
            pb::handle::Constrains::Position => constrains.position = true,
            pb::handle::Constrains::Rotation => constrains.rotation = true,
            pb::handle::Constrains::Scale => constrains.scale = true,
        }
    }
    Ok(constrains)
}

/// Reads the stiffness of a handle; none is a hard one.
pub(super) fn handle_stiffness(stiffness: Option<f64>, field: &str) -> Result<Option<f64>, Error> {
    if let Some(s) = stiffness {
        positive(s, field)?;
        optional_within(s, 1e-6, 1e6, field)?;
    }
    Ok(stiffness)
}

/// Reads a falloff.
pub(super) fn handle_falloff(falloff: Option<&pb::Falloff>, field: &str) -> Result<Option<Falloff>, Error> {
    let Some(falloff) = falloff else { return Ok(None) };
    let curve = match enumerated(falloff.kind, &format!("{field}.kind"))? {
        pb::falloff::Kind::None => None,
        pb::falloff::Kind::Linear => Some(FalloffCurve::Linear),
        pb::falloff::Kind::Smooth => Some(FalloffCurve::Smooth),
    };
    let at = format!("{field}.radius");
    let radius = number(falloff.radius, &at)?;
    if curve.is_some() {
        positive(radius, &at)?;
    }
    Ok(curve.map(|curve| Falloff { radius, curve }))
}

/// Reads a region.
///
/// # Errors
/// [`Error::Invalid`] with the path of the value below `field`, also for a region that is missing.
pub(super) fn region(region: Option<&pb::Region>, field: &str) -> Result<Region, Error> {
    use pb::region::Region as Message;
    const KINDS: &str = "vertices, halfSpace, sphere, box, capsule, tube, component, primitive, weights or anchors";
    let Some(region) = region.and_then(|r| r.region.as_ref()) else {
        return Err(Error::invalid(field, format!("is missing, allowed is one of {KINDS}")));
    };
    let vector = |values: &[f64], name: &str| vector(values, &format!("{field}.{name}"));
    let positive = |value: f64, name: &str| positive(value, &format!("{field}.{name}"));
    Ok(match region {
        Message::Vertices(list) => Region::Vertices {
            indices: list.indices.clone(),
            ranges: (list.ranges.iter())
                .map(|&pb::region::Range { first, count }| VertexRange { first, count })
                .collect(),
        },
        Message::Component(part) => Region::Component(part.index),
        Message::Primitive(part) => Region::Primitive(part.index),
        Message::Weights(weights) => Region::Weights(weights.values.clone()),
        Message::Anchors(list) => Region::Anchors(anchors(list, &format!("{field}.anchors"))?),
        Message::HalfSpace(half) => {
            let message = pb::Plane {
                normal: half.normal.clone(),
                offset: half.offset,
            };
            Region::HalfSpace(plane(&message, &format!("{field}.halfSpace"))?)
        }
        Message::Sphere(sphere) => Region::Sphere {
            center: vector(&sphere.center, "sphere.center")?,
            radius: positive(sphere.radius, "sphere.radius")?,
        },
        Message::Box(corners) => {
            let min = vector(&corners.min, "box.min")?;
            let max = vector(&corners.max, "box.max")?;
            if !min.cmple(max).all() {
                let problem = format!("min {min} is above max {max}");
                return Err(Error::invalid(format!("{field}.box"), problem));
            }
            Region::Box { min, max }
        }
        Message::Capsule(capsule) => Region::Capsule {
            from: vector(&capsule.from, "capsule.from")?,
            to: vector(&capsule.to, "capsule.to")?,
            radius: positive(capsule.radius, "capsule.radius")?,
        },
        Message::Tube(tube) => {
            let problem =
                |seen| format!("has {seen} numbers, a polyline has three for each of 2 to {MOST_TUBE_POINTS} points");
            Region::Tube {
                points: points(
                    &tube.points,
                    2..=MOST_TUBE_POINTS,
                    &format!("{field}.tube.points"),
                    problem,
                )?,
                radius: positive(tube.radius, "tube.radius")?,
            }
        }
    })
}

/// Writes a set of handles; reading it again gives an equal one.
pub fn handle_set_message(set: &HandleSet) -> pb::SetHandlesRequest {
    pb::SetHandlesRequest {
        session_id: String::new(),
        handles: set.handles.iter().map(handle_message).collect(),
        symmetry_plane: set.symmetry_plane.as_ref().map(plane_message),
        region_of_interest: set.region_of_interest.as_ref().map(region_message),
        stiff: set.stiff.as_ref().map(stiff_message),
    }
}

fn handle_message(handle: &Handle) -> pb::Handle {
    let HandleConstrains {
        position,
        rotation,
        scale,
    } = handle.constrains;
    let named = [
        (position, pb::handle::Constrains::Position),
        (rotation, pb::handle::Constrains::Rotation),
        (scale, pb::handle::Constrains::Scale),
    ];
    let all = handle.constrains == HandleConstrains::ALL;
    let named = named.into_iter().filter(|(is_fixed, _)| *is_fixed && !all);
    pb::Handle {
        id: handle.id.clone(),
        region: Some(region_message(&handle.region)),
        constrains: named.map(|(_, c)| c.into()).collect(),
        stiffness: handle.stiffness,
        rigid: handle.rigid,
        pose: handle.pose.as_ref().map(handle_pose_message),
        falloff: handle.falloff.map(|f| pb::Falloff {
            radius: f.radius,
            kind: match f.curve {
                FalloffCurve::Linear => pb::falloff::Kind::Linear.into(),
                FalloffCurve::Smooth => pb::falloff::Kind::Smooth.into(),
            },
        }),
        guide: handle.guide.as_deref().map(guide_message),
        targets: handle.targets.map(|per| pb::handle::Targets {
            stiffness_per: match per {
                StiffnessPer::Vertex => pb::handle::targets::StiffnessPer::Vertex.into(),
                StiffnessPer::Area => pb::handle::targets::StiffnessPer::Area.into(),
            },
            tangential: handle.tangential,
        }),
    }
}

fn plane_message(plane: &Plane) -> pb::Plane {
    pb::Plane {
        normal: plane.normal.to_array().to_vec(),
        offset: plane.offset,
    }
}

/// Writes a region.
pub fn region_message(region: &Region) -> pb::Region {
    use pb::region::Region as Message;
    let vector = |v: DVec3| v.to_array().to_vec();
    let message = match region {
        Region::Vertices { indices, ranges } => Message::Vertices(pb::region::Vertices {
            indices: indices.clone(),
            ranges: (ranges.iter())
                .map(|&VertexRange { first, count }| pb::region::Range { first, count })
                .collect(),
        }),
        &Region::Component(index) => Message::Component(pb::region::Part { index }),
        &Region::Primitive(index) => Message::Primitive(pb::region::Part { index }),
        Region::Weights(values) => Message::Weights(pb::region::Weights { values: values.clone() }),
        Region::Anchors(anchors) => Message::Anchors(anchors_message(anchors)),
        Region::HalfSpace(plane) => {
            let pb::Plane { normal, offset } = plane_message(plane);
            Message::HalfSpace(pb::region::HalfSpace { normal, offset })
        }
        &Region::Sphere { center, radius } => Message::Sphere(pb::region::Sphere {
            center: vector(center),
            radius,
        }),
        &Region::Box { min, max } => Message::Box(pb::region::Box {
            min: vector(min),
            max: vector(max),
        }),
        &Region::Capsule { from, to, radius } => Message::Capsule(pb::region::Capsule {
            from: vector(from),
            to: vector(to),
            radius,
        }),
        Region::Tube { points, radius } => Message::Tube(pb::region::Tube {
            points: points.iter().flat_map(|p| p.to_array()).collect(),
            radius: *radius,
        }),
    };
    pb::Region { region: Some(message) }
}

/// New values for some fields of one handle; `None` leaves a field as it is. Made by [`handle_patch`].
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HandlePatch {
    /// The name of the handle; one that is not set yet is added.
    pub id: String,
    /// The vertices.
    pub region: Option<Region>,
    /// What the handle fixes.
    pub constrains: Option<HandleConstrains>,
    /// How hard it holds; the inner `None` is a hard handle.
    pub stiffness: Option<Option<f64>>,
    /// Whether the region keeps its shape.
    pub rigid: Option<bool>,
    /// The pose; the inner `None` is the rest pose.
    pub pose: Option<Option<HandlePose>>,
    /// How it fades out; the inner `None` is not at all.
    pub falloff: Option<Option<Falloff>>,
    /// Whether it has targets, and what its stiffness is for then; the inner `None` is none.
    pub targets: Option<Option<StiffnessPer>>,
    /// How far they leave the pull along the surface out.
    pub tangential: Option<f64>,
    /// What gives their places; the inner `None` is nothing.
    pub guide: Option<Option<Arc<Guide>>>,
}

/// Reads the fields of `message` that `fields` names in JSON names. `current` are the handles in force: an error names the
/// handle by its number among them.
///
/// # Errors
/// [`Error::Invalid`] with the field, also for a handle that is not set yet and has no region.
pub fn handle_patch(message: &pb::Handle, fields: &[String], current: &HandleSet) -> Result<HandlePatch, Error> {
    // Without `..`, so that a field added to the schema cannot be forgotten here.
    let pb::Handle {
        id,
        region: new_region,
        constrains: new_constrains,
        stiffness: new_stiffness,
        rigid,
        pose,
        falloff: new_falloff,
        targets,
        guide: new_guide,
    } = message;
    let index = current.handles.iter().position(|h| h.id == *id);
    let old = index.and_then(|k| current.handles.get(k));
    let field = format!("handles[{}]", index.unwrap_or(current.handles.len()));
    check_handle_id(id, &field)?;
    let at = |name: &str| format!("{field}.{name}");
    let named = |name: &str| fields.iter().any(|f| f == name);
    let mut patch = HandlePatch {
        id: id.clone(),
        ..HandlePatch::default()
    };
    if named("region") || old.is_none() {
        patch.region = Some(region(new_region.as_ref(), &at("region"))?);
    }
    if named("pose") {
        patch.pose = Some(pose.as_ref().map(|p| handle_pose(p, &at("pose"))).transpose()?);
    }
    if named("constrains") {
        patch.constrains = Some(handle_constrains(new_constrains, &at("constrains"))?);
    }
    if named("stiffness") {
        patch.stiffness = Some(handle_stiffness(*new_stiffness, &at("stiffness"))?);
    }
    if named("rigid") {
        patch.rigid = Some(*rigid);
    }
    if named("falloff") {
        patch.falloff = Some(handle_falloff(new_falloff.as_ref(), &at("falloff"))?);
    }
    if named("targets") {
        patch.targets = Some(handle_targets(targets.as_ref(), &at("targets"))?);
        patch.tangential = Some(handle_tangential(targets.as_ref(), &at("targets"))?);
    }
    if named("guide") {
        patch.guide = Some(guide(new_guide.as_ref(), &at("guide"))?);
        if new_guide.is_some() && old.is_none_or(|old| old.targets.is_none()) && patch.targets.is_none() {
            patch.targets = Some(Some(StiffnessPer::Vertex));
        }
    }
    let has_targets = patch.targets.unwrap_or(old.and_then(|old| old.targets)).is_some();
    if has_targets && (old.is_none() || named("constrains")) && new_constrains.is_empty() {
        patch.constrains = Some(POSITION_ALONE);
    }
    Ok(patch)
}

impl HandlePatch {
    /// Gives the fields of `handle` that the patch names their new values.
    pub fn apply_to(self, handle: &mut Handle) {
        // Without `..`, so that no field can be forgotten here.
        let Self {
            id: _,
            region,
            constrains,
            stiffness,
            rigid,
            pose,
            falloff,
            targets,
            tangential,
            guide,
        } = self;
        if let Some(region) = region {
            handle.region = region;
        }
        handle.constrains = constrains.unwrap_or(handle.constrains);
        handle.stiffness = stiffness.unwrap_or(handle.stiffness);
        handle.rigid = rigid.unwrap_or(handle.rigid);
        if let Some(pose) = pose {
            handle.pose = pose;
        }
        handle.falloff = falloff.unwrap_or(handle.falloff);
        handle.targets = targets.unwrap_or(handle.targets);
        handle.tangential = tangential.unwrap_or(handle.tangential);
        if let Some(guide) = guide {
            handle.guide = guide;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::json::from_json;

    #[test]
    fn every_kind_of_region_comes_back_as_it_was_written() {
        let regions = [
            r#"{"vertices": {"indices": [3, 1], "ranges": [{"first": 7, "count": 2}]}}"#,
            r#"{"halfSpace": {"normal": [0, 0, 1], "offset": 0.5}}"#,
            r#"{"sphere": {"center": [1, 2, 3], "radius": 0.25}}"#,
            r#"{"box": {"min": [0, 0, 0], "max": [1, 2, 3]}}"#,
            r#"{"capsule": {"from": [0, 0, 0], "to": [0, 1, 0], "radius": 0.5}}"#,
            r#"{"tube": {"points": [0, 0, 0, 1, 0, 0, 1, 1, 0], "radius": 0.125}}"#,
            r#"{"component": {"index": 2}}"#,
            r#"{"primitive": {"index": 1}}"#,
            r#"{"weights": {"values": [0, 0.5, 1]}}"#,
            r#"{"anchors": {"corners": [4, 2, 9], "weights": [0.25, 0.25, 0.5]}}"#,
        ];
        let handles = regions.iter().enumerate().map(|(k, region)| {
            let text = format!(r#"{{"id": "h{k}", "region": {region}}}"#);
            from_json::<pb::Handle>(text.as_bytes()).expect(region)
        });
        let request = pb::SetHandlesRequest {
            handles: handles.collect(),
            ..Default::default()
        };
        let set = handle_set(&request).expect("all are right");
        let mut kinds: Vec<_> = set.handles.iter().map(|h| std::mem::discriminant(&h.region)).collect();
        kinds.dedup();
        assert_eq!(kinds.len(), regions.len(), "one handle of each kind");
        let again = handle_set_message(&set);
        assert_eq!(handle_set(&again).expect("what was written is right"), set);
        for (was, now) in request.handles.iter().zip(&again.handles) {
            assert_eq!(was.region, now.region, "{}", was.id);
        }
    }
}

#[cfg(test)]
mod handle_patch_tests {
    use super::*;

    fn patch(json: &str) -> Result<HandlePatch, Error> {
        let current = HandleSet::from([
            Handle::new("a", Region::Component(0)),
            Handle::new("b", Region::Component(0)).soft(2.0),
        ]);
        let message: pb::Handle = super::super::json::from_json(json.as_bytes())?;
        let fields: serde_json::Map<String, serde_json::Value> = serde_json::from_str(json).expect("an object");
        let fields: Vec<String> = fields.into_iter().map(|(name, _)| name).collect();
        handle_patch(&message, &fields, &current)
    }

    #[test]
    fn what_is_not_named_stays_and_null_is_the_default() {
        let read = patch(r#"{"id": "b", "stiffness": null, "rigid": false}"#).expect("right");
        let expected = HandlePatch {
            id: "b".into(),
            stiffness: Some(None),
            rigid: Some(false),
            ..HandlePatch::default()
        };
        assert_eq!(read, expected);
        let mut handle = Handle::new("b", Region::Component(3)).soft(2.0);
        read.apply_to(&mut handle);
        assert_eq!(handle, Handle::new("b", Region::Component(3)));
    }

    #[test]
    fn an_error_names_the_handle_by_its_number_in_force() {
        for (json, field) in [
            (r#"{"id": "b", "region": null}"#, "handles[1].region"),
            (r#"{"id": "c", "rigid": true}"#, "handles[2].region"),
            (r#"{"id": "a", "pose": {"scale": [0]}}"#, "handles[0].pose.scale"),
            (r#"{"id": "b", "stiffness": -1}"#, "handles[1].stiffness"),
            (
                r#"{"id": "b", "falloff": {"kind": "LINEAR"}}"#,
                "handles[1].falloff.radius",
            ),
            (
                r#"{"id": "a", "falloff": {"kind": "LINEAR"}}"#,
                "handles[0].falloff.radius",
            ),
        ] {
            assert!(
                matches!(patch(json), Err(Error::Invalid { field: f, .. }) if f == field),
                "{json}"
            );
        }
    }
}
