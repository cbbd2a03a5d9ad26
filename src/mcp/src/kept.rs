//! What is remembered of a session for its agent: which way the model stands, named regions, joints that were looked for.
//!
//! All of it can be made again: a region that an edit has changed is resolved again from its words.

use crate::words::Joints;
use glam::DVec3;
use pliant_core::engine::TopologyId;
use pliant_motion::humanoid::BodyAxes;
use pliant_session::{Error, Manager, MemoryReservation, MemoryUse, Tenant};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most names in a session, and most sessions that something is remembered of.
pub(crate) const MOST_NAMES: usize = 256;
const MOST_SESSIONS: usize = 4096;

/// A region with a name.
#[derive(Debug, Clone)]
pub(crate) struct NamedRegion {
    /// What it was resolved from.
    pub words: String,
    /// Its render vertices, ascending.
    pub vertices: Arc<Vec<u32>>,
    /// What it turns about.
    pub pivot: Option<DVec3>,
    /// The state of the model that the vertices belong to.
    pub topology: TopologyId,
}

/// What is remembered of one session.
#[derive(Debug, Clone)]
pub(crate) struct Notes {
    pub axes: BodyAxes,
    /// By names in plain words.
    pub regions: BTreeMap<String, NamedRegion>,
    /// The joints of a state of the model; the inner value is `None` where it has none.
    pub joints: Option<(TopologyId, Option<Arc<Joints>>)>,
}

impl Default for Notes {
    fn default() -> Self {
        Self {
            axes: BodyAxes::USUAL,
            regions: BTreeMap::new(),
            joints: None,
        }
    }
}

impl Notes {
    fn byte_size(&self) -> u64 {
        let regions = self.regions.iter().map(|(name, region)| {
            (name.len() + region.words.len() + size_of::<NamedRegion>() + 4 * region.vertices.len()) as u64
        });
        let joints = self
            .joints
            .iter()
            .filter_map(|(_, joints)| joints.as_ref())
            .map(|joints| joints.byte_size());
        regions.chain(joints).sum()
    }
}

/// By tenant and session.
type SessionKey = (Tenant, String);

/// What is remembered of all sessions.
#[derive(Debug, Default)]
pub(crate) struct Kept {
    sessions: Mutex<BTreeMap<SessionKey, (Notes, MemoryReservation)>>,
}

impl Kept {
    fn lock(&self) -> MutexGuard<'_, BTreeMap<SessionKey, (Notes, MemoryReservation)>> {
        self.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is remembered of a session.
    pub fn notes(&self, tenant: &Tenant, id: &str) -> Notes {
        let key = (tenant.clone(), id.to_owned());
        self.lock().get(&key).map(|kept| kept.0.clone()).unwrap_or_default()
    }

    /// Remembers notes, within the memory of server and tenant.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` where there is no room.
    pub fn keep(&self, manager: &Manager, tenant: &Tenant, id: &str, notes: Notes) -> Result<(), Error> {
        let account = manager.account(tenant)?;
        let mut sessions = self.lock();
        let key = (tenant.clone(), id.to_owned());
        if sessions.len() >= MOST_SESSIONS && !sessions.contains_key(&key) {
            sessions.pop_first();
        }
        let (own, held) = sessions.entry(key).or_insert_with(|| {
            let held = manager.ledger().reserve_later(MemoryUse::Sessions, Some(&account));
            (Notes::default(), held)
        });
        let no_room = |shortage| Error::exhausted(format!("the names of regions: {shortage}"), 5);
        held.grow_to(notes.byte_size()).map_err(no_room)?;
        *own = notes;
        let _ = held.resize(own.byte_size());
        Ok(())
    }

    /// Forgets a session that is gone.
    pub fn forget(&self, tenant: &Tenant, id: &str) {
        self.lock().remove(&(tenant.clone(), id.to_owned()));
    }
}
