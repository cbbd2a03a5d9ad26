//! Work that only reads a session's shape: pictures, and words for its regions.

use crate::calls::command::{CallOrigin, ReadShape};
use crate::capacity::work_watch::WorkKind;
use crate::error::Error;
use crate::task::commands::{FEW_TRIANGLES, RunCall, lane_of_work, reserve_more};
use crate::task::session_task::SessionTask;
use std::any::Any;
use std::sync::Arc;

impl RunCall for ReadShape {
    async fn run(self, task: &mut SessionTask, origin: &CallOrigin) -> Result<Box<dyn Any + Send>, Error> {
        let positions = Arc::clone(&task.session.view().positions);
        let topology = task.history.current().topology.clone();
        let lane = lane_of_work(task.history.current().triangles() <= FEW_TRIANGLES);
        let limit = task.shared.config.build;
        let needed = (positions.len() as u64).saturating_mul(self.bytes_per_vertex);
        reserve_more(task, needed, "looking at the model")?;
        let (read, watch) = task
            .compute(origin.order(WorkKind::Look, lane, limit), move |deformer, work| {
                let exec = work.exec();
                deformer.go_to_topology(topology.as_ref(), &exec)?;
                (self.read)(deformer.deformer("looking at models")?, &positions, &exec)
            })
            .await?;
        read.map_err(|e| task.failure(e, &watch))
    }
}
