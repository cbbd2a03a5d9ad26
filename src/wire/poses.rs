//! Poses as messages and as values of the engine.

use super::check::vector;
use super::{Error, pb};
use crate::engine::{Deformer, HandlePose, HandlePoses, HandleRotation, HandleScale};
use glam::{DQuat, DVec3};
use std::collections::BTreeMap;

/// Returns `poses` with those that a message names replaced.
///
/// # Errors
/// [`Error::Precondition`] without handles, [`Error::Invalid`] with the field.
pub fn change_poses(deformer: &Deformer, poses: &HandlePoses, change: &pb::Pose) -> Result<HandlePoses, Error> {
    let changes = pose_changes(change)?;
    Ok(deformer.change_poses(poses, changes.iter().map(|(id, pose)| (id.as_str(), *pose)))?)
}

/// Reads the poses that a message names, by handle.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub fn pose_changes(message: &pb::Pose) -> Result<Vec<(String, HandlePose)>, Error> {
    let change = |(id, pose): (String, Result<HandlePose, Error>)| Ok((id, pose?));
    pose_entries(message).into_iter().map(change).collect()
}

/// Reads the handles that a pose names, each with its pose, or with the error that is reported later; the default is the rest
/// pose. An entry that names a handle again is an error.
pub(super) fn pose_entries(pose: &pb::Pose) -> Vec<(String, Result<HandlePose, Error>)> {
    let mut named: BTreeMap<&str, usize> = BTreeMap::new();
    let mut entries = Vec::with_capacity(pose.handles.len());
    for (k, entry) in pose.handles.iter().enumerate() {
        let pose = match (named.insert(&entry.id, k), &entry.pose) {
            (Some(before), _) => {
                let problem = format!("names the handle of handles[{before}] again; each handle has one pose");
                Err(Error::invalid(format!("pose.handles[{k}].id"), problem))
            }
            (None, Some(pose)) => handle_pose(pose, &format!("pose.handles[{k}].pose")),
            (None, None) => Ok(HandlePose::default()),
        };
        entries.push((entry.id.clone(), pose));
    }
    entries
}

/// Refuses a pose of more than `max_entries` entries, and entries that are too large to be right.
///
/// # Errors
/// [`Error::Invalid`] with the field.
pub(super) fn check_pose_size(pose: &pb::Pose, max_entries: usize) -> Result<(), Error> {
    if pose.handles.len() > max_entries {
        let problem = format!("has {} entries, at most {max_entries} are allowed", pose.handles.len());
        return Err(Error::invalid("pose.handles", problem));
    }
    for (k, entry) in pose.handles.iter().enumerate() {
        if entry.id.len() > 128 {
            let problem = "is longer than the 128 bytes of any handle";
            return Err(Error::invalid(format!("pose.handles[{k}].id"), problem));
        }
        let Some(p) = &entry.pose else { continue };
        let lists = [
            ("translation", &p.translation),
            ("rotation", &p.rotation),
            ("rotationVector", &p.rotation_vector),
            ("scale", &p.scale),
            ("pivot", &p.pivot),
        ];
        if let Some((name, list)) = lists.into_iter().find(|(_, list)| list.len() > 4) {
            let field = format!("pose.handles[{k}].pose.{name}");
            let problem = format!("has {} numbers, at most 4 are allowed", list.len());
            return Err(Error::invalid(field, problem));
        }
    }
    Ok(())
}

/// Reads the pose of a handle.
///
/// # Errors
/// [`Error::Invalid`] with the path of the value below `field`.
pub fn handle_pose(pose: &pb::HandlePose, field: &str) -> Result<HandlePose, Error> {
    let optional = |values: &[f64], name: &str| match values {
        [] => Ok(None),
        values => vector(values, &format!("{field}.{name}")).map(Some),
    };
    let translation = optional(&pose.translation, "translation")?;
    let pivot = optional(&pose.pivot, "pivot")?;
    let turned = optional(&pose.rotation_vector, "rotationVector")?;
    if turned.is_some_and(|v| v.length() > 1e6) {
        return Err(Error::invalid(
            format!("{field}.rotationVector"),
            "is longer than 1e6 radians",
        ));
    }
    let rotation = match (quaternion(&pose.rotation, &format!("{field}.rotation"))?, turned) {
        (Some(_), Some(_)) => {
            return Err(Error::invalid(
                field,
                "has both rotation and rotationVector, only one of them is allowed",
            ));
        }
        (Some(q), None) => Some(HandleRotation::Quaternion(q)),
        (None, v) => v.map(HandleRotation::Vector),
    };
    Ok(HandlePose {
        translation,
        rotation,
        scale: scale(&pose.scale, &format!("{field}.scale"))?,
        pivot,
    })
}

/// Writes the pose of a handle; numbers are as they were read.
pub fn handle_pose_message(pose: &HandlePose) -> pb::HandlePose {
    let vector = |v: Option<DVec3>| v.map_or_else(Vec::new, |v| v.to_array().to_vec());
    let (rotation, rotation_vector) = match pose.rotation {
        None => Default::default(),
        Some(HandleRotation::Quaternion(q)) => (q.to_array().to_vec(), Vec::new()),
        Some(HandleRotation::Vector(v)) => (Vec::new(), v.to_array().to_vec()),
    };
    pb::HandlePose {
        translation: vector(pose.translation),
        rotation,
        rotation_vector,
        scale: match pose.scale {
            None => Vec::new(),
            Some(HandleScale::Uniform(s)) => vec![s],
            Some(HandleScale::PerAxis(s)) => s.to_array().to_vec(),
        },
        pivot: vector(pose.pivot),
    }
}

fn quaternion(values: &[f64], field: &str) -> Result<Option<DQuat>, Error> {
    if values.is_empty() {
        return Ok(None);
    }
    let [x, y, z, w] = values else {
        let problem = format!("has {} numbers, a quaternion has 4 [x, y, z, w]", values.len());
        return Err(Error::invalid(field, problem));
    };
    let q = DQuat::from_xyzw(*x, *y, *z, *w);
    let length = q.length();
    if !(0.99..=1.01).contains(&length) {
        let problem = format!("has length {length}, a rotation needs a unit quaternion [x, y, z, w]");
        return Err(Error::invalid(field, problem));
    }
    Ok(Some(q))
}

fn scale(values: &[f64], field: &str) -> Result<Option<HandleScale>, Error> {
    for (k, s) in values.iter().enumerate().filter(|_| matches!(values.len(), 1 | 3)) {
        if !(1e-6..=1e6).contains(s) {
            let place = if values.len() == 1 {
                field.to_owned()
            } else {
                format!("{field}[{k}]")
            };
            return Err(Error::invalid(place, format!("is {s}, allowed are 1e-6 to 1e6")));
        }
    }
    match values {
        [] => Ok(None),
        [s] => Ok(Some(HandleScale::Uniform(*s))),
        [x, y, z] => Ok(Some(HandleScale::PerAxis(DVec3::new(*x, *y, *z)))),
        more => {
            let problem = format!("has {} numbers, allowed are 1 or 3", more.len());
            Err(Error::invalid(field, problem))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_poses_are_refused_with_their_field() {
        let refused = |pose: pb::HandlePose, field: &str| match handle_pose(&pose, "p") {
            Err(Error::Invalid { field: f, .. }) => assert_eq!(f, field),
            other => panic!("{field}: {other:?}"),
        };
        let pose = pb::HandlePose::default;
        refused(
            pb::HandlePose {
                translation: vec![1.0],
                ..pose()
            },
            "p.translation",
        );
        refused(
            pb::HandlePose {
                translation: vec![1.0, f64::NAN, 0.0],
                ..pose()
            },
            "p.translation[1]",
        );
        refused(
            pb::HandlePose {
                rotation: vec![0.0, 0.0, 0.0, 2.0],
                ..pose()
            },
            "p.rotation",
        );
        refused(
            pb::HandlePose {
                rotation: vec![f64::NAN, 0.0, 0.0, 1.0],
                ..pose()
            },
            "p.rotation",
        );
        refused(
            pb::HandlePose {
                scale: vec![1.0, 2.0],
                ..pose()
            },
            "p.scale",
        );
        refused(
            pb::HandlePose {
                scale: vec![0.0],
                ..pose()
            },
            "p.scale",
        );
        refused(
            pb::HandlePose {
                scale: vec![1.0, -1.0, 1.0],
                ..pose()
            },
            "p.scale[1]",
        );
        let both = pb::HandlePose {
            rotation: vec![0., 0., 0., 1.],
            rotation_vector: vec![0., 0., 0.],
            ..pose()
        };
        refused(both, "p");
    }
}
