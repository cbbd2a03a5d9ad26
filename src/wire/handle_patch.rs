//! Changes of single fields of one handle.

use super::handles::{check_handle_id, handle_constrains, handle_falloff, handle_stiffness, region};
use super::poses::handle_pose;
use super::{Error, pb};
use crate::engine::{Falloff, Handle, HandleConstrains, HandlePose, HandleSet, Region};

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
        let stiffness = patch.stiffness.unwrap_or(old.and_then(|h| h.stiffness));
        patch.falloff = Some(handle_falloff(
            new_falloff.as_ref(),
            stiffness.is_some(),
            &at("falloff"),
        )?);
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
        } = self;
        if let Some(region) = region {
            handle.region = region;
        }
        handle.constrains = constrains.unwrap_or(handle.constrains);
        handle.stiffness = stiffness.unwrap_or(handle.stiffness);
        handle.rigid = rigid.unwrap_or(handle.rigid);
        handle.pose = pose.unwrap_or(handle.pose);
        handle.falloff = falloff.unwrap_or(handle.falloff);
    }
}

#[cfg(test)]
mod tests {
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
        ] {
            assert!(
                matches!(patch(json), Err(Error::Invalid { field: f, .. }) if f == field),
                "{json}"
            );
        }
        // The deformer itself says that a hard handle has no falloff.
        patch(r#"{"id": "a", "falloff": {"kind": "LINEAR"}}"#).expect("right as it stands");
    }
}
