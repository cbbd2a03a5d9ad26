//! Changes of a session's handles: all of them, some fields of one, or one less.

use crate::engine::{Handle, HandlePose, HandlePoses, HandleSet};
use crate::session::error::{Error, ErrorCode};
use crate::wire::HandlePatch;

/// A change of the handles.
#[derive(Debug)]
pub(in crate::session) enum HandleChange {
    /// All are replaced; without a pose: the rest pose.
    Replace(HandleSet),
    /// The named fields of one handle are replaced, or it is added. Everything else stays where it is.
    Put(Box<HandlePatch>),
    /// One is removed. The others stay where they are.
    Remove(String),
}

impl HandleChange {
    /// The handles after the change; `poses` are those in force.
    ///
    /// # Errors
    /// `NOT_FOUND` when the handle to remove does not exist, `INVALID_ARGUMENT` when one to add has no region.
    pub fn apply_to(self, current: &HandleSet, poses: &HandlePoses) -> Result<HandleSet, Error> {
        match self {
            Self::Replace(set) => Ok(set),
            Self::Put(patch) => {
                let mut next = set_at_poses(current, poses);
                let index = next.handles.iter().position(|h| h.id == patch.id);
                match index.and_then(|k| next.handles.get_mut(k)) {
                    Some(handle) => patch.apply_to(handle),
                    None => next.handles.push(new_handle(*patch, next.handles.len())?),
                }
                Ok(next)
            }
            Self::Remove(id) => {
                let mut next = set_at_poses(current, poses);
                next.handles.retain(|h| h.id != id);
                if next.handles.len() == current.handles.len() {
                    let shown: String = id.chars().take(128).collect();
                    return Err(Error::new(ErrorCode::NotFound, format!("no handle \"{shown}\"")));
                }
                Ok(next)
            }
        }
    }
}

/// The set with every handle set where it is now.
fn set_at_poses(current: &HandleSet, poses: &HandlePoses) -> HandleSet {
    let mut next = current.clone();
    for (handle, pose) in next.handles.iter_mut().zip(poses.0.iter()) {
        handle.pose = (*pose != HandlePose::default()).then_some(*pose);
    }
    next
}

/// The handle that a patch adds as number `k`. Its region is missing only when the handle that the patch was meant for has
/// gone since it was read.
fn new_handle(mut patch: HandlePatch, k: usize) -> Result<Handle, Error> {
    let field = format!("handles[{k}].region");
    let region = patch.region.take();
    let region = region.ok_or_else(|| Error::invalid(field, "is missing, and the handle is not set any more"))?;
    let mut handle = Handle::new(patch.id.clone(), region);
    patch.apply_to(&mut handle);
    Ok(handle)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::Region;

    fn handle(id: &str, x: Option<f64>) -> Handle {
        Handle {
            pose: x.map(|x| HandlePose::translation([x, 0.0, 0.0])),
            ..Handle::new(id, Region::Component(0)).soft(2.0)
        }
    }

    fn patch(id: &str) -> HandlePatch {
        HandlePatch {
            id: id.into(),
            ..Default::default()
        }
    }

    fn put(patch: HandlePatch, current: &HandleSet, poses: &HandlePoses) -> Result<HandleSet, Error> {
        HandleChange::Put(Box::new(patch)).apply_to(current, poses)
    }

    fn x_of(handle: &Handle) -> Option<f64> {
        handle.pose.and_then(|p| p.translation).map(|by| by.x)
    }

    #[test]
    fn a_patch_changes_what_it_names_and_moves_nothing_else() {
        let current = HandleSet::from([handle("a", None), handle("b", Some(1.0))]);
        // Since then, a was dragged and committed.
        let dragged = vec![HandlePose::translation([7.0, 0.0, 0.0]), HandlePose::default()];
        let poses = HandlePoses(dragged.into());

        let rigid = HandlePatch {
            rigid: Some(true),
            ..patch("b")
        };
        let next = put(rigid, &current, &poses).expect("known");
        assert_eq!((x_of(&next.handles[0]), x_of(&next.handles[1])), (Some(7.0), None));
        assert_eq!((next.handles[1].rigid, next.handles[1].stiffness), (true, Some(2.0)));

        let moved = HandlePatch {
            stiffness: Some(None),
            pose: Some(Some(HandlePose::translation([3.0, 0.0, 0.0]))),
            ..patch("a")
        };
        let next = put(moved, &current, &poses).expect("known");
        assert_eq!((x_of(&next.handles[0]), next.handles[0].stiffness), (Some(3.0), None));

        let added = HandlePatch {
            region: Some(Region::Component(1)),
            ..patch("c")
        };
        let next = put(added, &current, &poses).expect("added");
        assert_eq!((next.handles.len(), next.handles[2].stiffness), (3, None));
        let nowhere = put(patch("c"), &current, &poses).expect_err("it has no region");
        assert_eq!(nowhere.field.as_deref(), Some("handles[2].region"));

        let next = HandleChange::Remove("b".into())
            .apply_to(&current, &poses)
            .expect("known");
        assert_eq!((next.handles.len(), x_of(&next.handles[0])), (1, Some(7.0)));
        let unknown = HandleChange::Remove("z".into()).apply_to(&current, &poses);
        assert_eq!(unknown.expect_err("unknown").http_status(), 404);
    }
}
