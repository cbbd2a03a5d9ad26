//! The calls of a deformer in the words of messages: what a transport does, in process.

use pliant::engine::{Deformer, EditCommand, HandlePoses, ModelShape, SolveSettings};
use pliant::exec::Exec;
use pliant::wire::{self, Error, json, pb};

/// What an edit came to, as a message.
#[derive(Debug, Clone)]
pub struct EditedByMessage {
    pub result: pb::EditResult,
    pub handles: pb::SetHandlesRequest,
    pub poses: HandlePoses,
    pub solved: Option<SolveSettings>,
    pub shape: ModelShape,
}

/// Calls with messages.
pub trait DeformerMessages {
    fn set_handles_message(&mut self, request: &pb::SetHandlesRequest, exec: &Exec<'_>) -> Result<(), Error>;
    fn change_poses_message(&self, poses: &HandlePoses, change: &pb::Pose) -> Result<HandlePoses, Error>;
    fn facts_message(&self) -> pb::Session;
    fn handles_message(&self) -> pb::SetHandlesRequest;
    fn edit_message(
        &mut self,
        request: &pb::EditRequest,
        shape: &ModelShape,
        poses: &HandlePoses,
        exec: &Exec<'_>,
    ) -> Result<EditedByMessage, Error>;
}

impl DeformerMessages for Deformer {
    fn set_handles_message(&mut self, request: &pb::SetHandlesRequest, exec: &Exec<'_>) -> Result<(), Error> {
        self.set_handles(wire::handle_set(request)?, exec)
    }

    fn change_poses_message(&self, poses: &HandlePoses, change: &pb::Pose) -> Result<HandlePoses, Error> {
        wire::change_poses(self, poses, change)
    }

    fn facts_message(&self) -> pb::Session {
        wire::session_message(&self.facts())
    }

    fn handles_message(&self) -> pb::SetHandlesRequest {
        wire::handle_set_message(self.handles())
    }

    fn edit_message(
        &mut self,
        request: &pb::EditRequest,
        shape: &ModelShape,
        poses: &HandlePoses,
        exec: &Exec<'_>,
    ) -> Result<EditedByMessage, Error> {
        let (edit, on) = wire::edit(request, None)?;
        let command = EditCommand {
            edit: &edit,
            on,
            shape,
            poses,
            settings: None,
        };
        let outcome = self.edit(&command, exec)?;
        Ok(EditedByMessage {
            result: wire::edit_result(&outcome.report),
            handles: wire::handle_set_message(&outcome.handles),
            poses: outcome.poses,
            solved: outcome.solved,
            shape: outcome.shape,
        })
    }
}

/// A message of the schema, from its JSON.
pub fn message<M: prost::Message + Default + prost::Name>(value: &serde_json::Value) -> M {
    json::from_json(value.to_string().as_bytes()).expect("a message")
}

/// Render vertices in no triangle.
pub fn unreferenced(deformer: &Deformer) -> usize {
    let mut used = vec![false; deformer.rest().len()];
    let triangles = deformer.geometry().triangles.iter();
    triangles.flatten().for_each(|&v| used[v as usize] = true);
    used.iter().filter(|u| !**u).count()
}

/// Places that are not manifold.
pub fn broken(deformer: &Deformer) -> usize {
    let report = deformer.report();
    report.non_manifold_edges + report.non_manifold_vertices + report.winding_conflicts
}
