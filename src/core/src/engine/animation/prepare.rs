//! An animation before its first frame: the rig's handles on the body, with fields of their own.

use super::held_nodes::{RigHandleFacts, hold_nodes};
use super::settings::{AnimationSettings, FrameTimes};
use crate::deform::{HandleSetup, HandleSystem};
use crate::engine::deformer::Deformer;
use crate::engine::derived_structures::{DerivedStructures, admit_bytes};
use crate::engine::error::Error;
use crate::exec::Exec;
use crate::motion::SceneMotion;
use crate::motion::rig::{MotionRig, RigDriver, RigHandle, rig_handles};
use std::sync::Arc;

/// A clip on a model, ready to be solved frame by frame.
pub struct Animation {
    pub(super) derived: Arc<DerivedStructures>,
    pub(super) system: HandleSystem,
    pub(super) rig: MotionRig,
    pub(super) driver: RigDriver,
    pub(super) handles: Vec<RigHandle>,
    pub(super) times: FrameTimes,
    pub(super) settings: AnimationSettings,
    pub(super) beside: Option<SceneMotion>,
    facts: Vec<RigHandleFacts>,
}

impl Deformer {
    /// Prepares an animation of the rest shape. The deformer's handles, poses and history have no part in it, and may change
    /// while it is solved.
    ///
    /// # Errors
    /// [`Error::Precondition`] when bones lie in no part of the model, [`Error::TooLarge`] for more than the limits allow,
    /// [`Error::Cancelled`].
    pub fn animation(
        &self,
        rig: MotionRig,
        driver: RigDriver,
        times: FrameTimes,
        settings: &AnimationSettings,
        exec: &Exec<'_>,
    ) -> Result<Animation, Error> {
        let body = self.body();
        let handles = rig_handles(&rig);
        if handles.len() > self.limits.handles {
            return Err(Error::TooLarge {
                what: "handles of the rig",
                seen: handles.len() as u64,
                limit: self.limits.handles as u64,
            });
        }
        let (constraints, facts) = hold_nodes(&handles, &body.graph, exec.pool);
        // On a model of few vertices some find nothing that no other holds; a rig that lies elsewhere finds nothing at all.
        let empty = facts.iter().filter(|f| f.nodes == 0);
        if 2 * empty.clone().count() > facts.len() {
            let name = empty.map(|f| f.name.as_str()).next().unwrap_or_default();
            let problem = format!(
                "\"{name}\" of the rig holds nothing; its joints have to lie inside the model, in its rest pose and units"
            );
            return Err(Error::Precondition(problem));
        }
        let field_bytes = (constraints.len() as u64 + 1) * body.nodes() as u64 * 12;
        admit_bytes(self.byte_size() + field_bytes, &self.limits)?;
        let setup = HandleSetup {
            handles: constraints,
            policy: self.options.policy,
            ..Default::default()
        };
        let system = HandleSystem::build(body, setup, exec)?;
        // Blocks that run at the same time find ready what the first one to ask would make.
        system.prepare_shares(exec.pool);
        self.derived.riding_vertices(exec.pool);
        Ok(Animation {
            derived: Arc::clone(&self.derived),
            system,
            rig,
            driver,
            handles,
            times,
            settings: settings.clone(),
            beside: None,
            facts,
        })
    }
}

impl Animation {
    /// Lets what moves in the scene of the model's file beside its skins move along with the clip. An edited model has other
    /// vertices than its file, and no such thing.
    #[must_use]
    pub fn with_beside(mut self, beside: Option<SceneMotion>) -> Self {
        self.beside = beside.filter(|_| self.derived.topology().edited.is_none());
        self
    }

    /// What each handle of the rig came to hold.
    pub fn handle_facts(&self) -> &[RigHandleFacts] {
        &self.facts
    }

    /// When its frames are.
    pub fn times(&self) -> &FrameTimes {
        &self.times
    }

    /// What drives it.
    pub fn driver(&self) -> &RigDriver {
        &self.driver
    }
}
