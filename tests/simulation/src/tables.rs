//! The tables of the model database: what `src/session/src/store` says in SQL, on maps. A transaction is carried out as a whole or not.

use pliant_session::Tenant;
use pliant_session::store::{
    Commit, Generation, HeldSession, LoggedKey, NewCommit, NewSession, NodeLoad, SessionRecord, StoreError,
    StoredObject, StoredSession, StoredSnapshot, UncertainCommit, UncertainCommits, WriteOrder, Written,
};
use pliant_wire::record::{LoggedCommit, RecordedModel};
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// How long an object without a name stays, in milliseconds. PostgreSQL's rows stay an hour; a run lasts minutes.
const GRACE_MS: u64 = 60_000;
/// How long the lock of a node holds that removes an object.
const LOCKED_MS: u64 = 15_000;

/// A commit as its row has it.
#[derive(Debug, Clone)]
pub struct CommitRow {
    facts: Commit,
    payload: Arc<[u8]>,
    at_ms: u64,
}

/// A session's row with its commits.
#[derive(Debug, Clone)]
pub struct SessionRow {
    pub record: SessionRecord,
    model: Arc<[u8]>,
    pub used_ms: u64,
    pub owner: String,
    pub generation: u64,
    pub commits: Vec<CommitRow>,
    snapshot: Option<StoredSnapshot>,
}

/// A node's row.
#[derive(Debug, Clone)]
pub struct NodeRow {
    pub name: String,
    pub address: String,
    pub lapses: i64,
    pub lease_until_ms: u64,
    pub load: NodeLoad,
}

/// A bug that the store had, or would have without one of its rules, put back.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub enum OldBug {
    /// Until ae910f50 (2026-11-25) a key was read before the refused commit that it named was taken back.
    KeyOfRefusedCommit,
    /// Until 833ac277 (2026-11-24) no write was compared with the generation of its session.
    NoFence,
    /// Until c244f734 (2026-11-23) commits of streams had no key: one whose answer was lost was recorded twice.
    NoKeyOfCommit,
}

/// All rows.
#[derive(Debug, Clone, Default)]
pub struct Tables {
    pub sessions: BTreeMap<String, SessionRow>,
    pub keys: BTreeMap<(Tenant, String), LoggedKey>,
    pub nodes: BTreeMap<String, NodeRow>,
    pub newest_number: u64,
    pub audited: BTreeSet<Tenant>,
    /// Objects that no session names, with the time since when.
    loose: BTreeMap<String, u64>,
    /// Objects that are being removed, with the end of the lock.
    locked: BTreeMap<String, u64>,
    /// Which session uses which object, with its bytes.
    pub uses: BTreeMap<(String, String), u64>,
}

/// The database: its rows, and what it has seen.
#[derive(Debug, Default)]
pub struct Database {
    pub tables: Tables,
    /// The connection of each node that may write.
    pub connections: BTreeMap<String, u64>,
    /// Which node got a session with which generation.
    granted: BTreeMap<(String, u64), String>,
    /// What must not be.
    pub violations: Vec<String>,
    /// Transactions so far.
    pub transactions: u64,
    bug: Option<OldBug>,
}

impl SessionRow {
    /// The numbers, revisions and digests of its commits.
    pub fn commits(&self) -> impl Iterator<Item = &Commit> {
        self.commits.iter().map(|row| &row.facts)
    }

    /// A commit as it is read.
    pub fn read_commit(&self, sequence: u64) -> Option<Result<(Commit, Vec<u8>), StoreError>> {
        let row = self.commits.iter().find(|row| row.facts.sequence == sequence)?;
        let unread = |e| StoreError::Damaged(format!("commit {sequence} cannot be read: {e}"));
        let read = LoggedCommit::read(&row.payload).map_err(unread);
        Some(read.map(|record| {
            let commit = Commit {
                record,
                ..row.facts.clone()
            };
            (commit, row.payload.to_vec())
        }))
    }

    /// The session as it is read.
    pub fn read(&self) -> Result<StoredSession, StoreError> {
        let mut commits = Vec::new();
        for (k, row) in self.commits.iter().enumerate() {
            if row.facts.sequence != k as u64 {
                return Err(StoreError::Damaged(format!("commit {k} is missing")));
            }
            let read = self.read_commit(row.facts.sequence);
            commits.push(read.unwrap_or_else(|| Err(StoreError::Damaged("it is gone".into())))?.0);
        }
        Ok(StoredSession {
            record: SessionRecord {
                label: self.read_model()?.label,
                created_ms: self.commits.first().map_or(0, |row| row.at_ms),
                ..self.record.clone()
            },
            used_ms: self.used_ms,
            model: self.read_model()?,
            commits,
            snapshot: self.snapshot.clone(),
        })
    }

    fn read_model(&self) -> Result<RecordedModel, StoreError> {
        RecordedModel::read(&self.model).map_err(|e| StoreError::Damaged(e.to_string()))
    }

    /// Bytes of its records.
    pub fn record_bytes(&self) -> u64 {
        let commits: usize = self.commits.iter().map(|row| row.payload.len()).sum();
        (commits + self.model.len()) as u64
    }
}

impl Database {
    /// An empty one, with an old bug put back.
    pub fn with(bug: Option<OldBug>) -> Self {
        Self { bug, ..Self::default() }
    }

    /// Carries out a transaction of a node on a connection of that number.
    pub fn transact(
        &mut self,
        node: (&str, u64),
        uncertain: &UncertainCommits,
        orders: &[WriteOrder],
        now_ms: u64,
    ) -> Result<Vec<Written>, StoreError> {
        let (node, connection) = node;
        // What a lost connection had begun ends before the next one begins.
        if self.connections.get(node) != Some(&connection) {
            return Err(StoreError::Unavailable("the connection was given up".into()));
        }
        self.transactions += 1;
        let mut tables = self.tables.clone();
        let only_undo = orders.iter().all(|order| matches!(order, WriteOrder::UndoUncertain));
        if !(only_undo && self.bug == Some(OldBug::KeyOfRefusedCommit)) {
            for doubt in uncertain.values() {
                tables.undo(doubt);
            }
        }
        let mut answers = Vec::new();
        for order in orders {
            match self.carry_out(&mut tables, node, order, now_ms) {
                Err(StoreError::Unavailable(problem)) => return Err(StoreError::Unavailable(problem)),
                answer => answers.push(answer),
            }
        }
        self.tables = tables;
        Ok(answers)
    }

    fn carry_out(&mut self, tables: &mut Tables, node: &str, order: &WriteOrder, now_ms: u64) -> Written {
        match order {
            WriteOrder::Create {
                session,
                model,
                objects,
                owner,
            } => {
                tables.create(session, model, owner, now_ms)?;
                self.grant(&session.record.id, 1, owner);
                self.append(tables, node, &session.first, objects, now_ms)?;
            }
            WriteOrder::Append { commit, objects } => self.append(tables, node, commit, objects, now_ms)?,
            WriteOrder::SaveSnapshot {
                session,
                sequence,
                shape,
            } => {
                if self.may_write(tables, node, session) {
                    tables.save_snapshot(&session.id, *sequence, shape, now_ms);
                } else {
                    tables.loose.insert(shape.name.clone(), now_ms);
                }
            }
            WriteOrder::RerecordDigests { session, .. } => {
                if !self.may_write(tables, node, session) {
                    return Err(StoreError::Moved);
                }
            }
            WriteOrder::Delete { audit, generation } => {
                let session = HeldSession {
                    id: audit.session.clone(),
                    generation: *generation,
                };
                if !self.may_write(tables, node, &session) {
                    return Err(StoreError::Moved);
                }
                tables.delete(&audit.session, now_ms);
            }
            WriteOrder::NoteUse { sessions } => {
                for used in sessions {
                    let row = tables.sessions.get_mut(&used.session.id);
                    if let Some(row) = row.filter(|row| row.generation == used.session.generation.0) {
                        row.used_ms = row.used_ms.max(used.used_ms);
                    }
                }
            }
            WriteOrder::ForgetKeys { before_ms } => tables.keys.retain(|_, key| key.at_ms >= *before_ms),
            WriteOrder::Audit { entry } => drop(tables.audited.insert(entry.tenant.clone())),
            WriteOrder::ForgetAudit { .. }
            | WriteOrder::Measure { .. }
            | WriteOrder::UndoUncertain
            | WriteOrder::Touch => {}
        }
        Ok(Vec::new())
    }

    /// Notes that a node has a session; of two with one generation none may write.
    fn grant(&mut self, session: &str, generation: u64, node: &str) {
        let before = self.granted.insert((session.to_owned(), generation), node.to_owned());
        if before.is_some_and(|before| before != node) {
            let text = format!("two nodes have {session} with generation {generation}");
            self.violations.push(text);
        }
    }

    /// Whether a session is still its writer's.
    fn may_write(&mut self, tables: &Tables, node: &str, session: &HeldSession) -> bool {
        let Some(row) = tables.sessions.get(&session.id) else {
            return false;
        };
        let may = row.generation == session.generation.0 || self.bug == Some(OldBug::NoFence);
        if may && row.owner != node {
            self.violations
                .push(format!("{node} writes {}, which \"{}\" has", session.id, row.owner));
        }
        may
    }

    fn append(
        &mut self,
        tables: &mut Tables,
        node: &str,
        new: &NewCommit,
        objects: &[StoredObject],
        now_ms: u64,
    ) -> Result<(), StoreError> {
        if !self.may_write(tables, node, &new.session) {
            return Err(StoreError::Moved);
        }
        let id = &new.session.id;
        let Some(row) = tables.sessions.get_mut(id) else {
            return Err(StoreError::Moved);
        };
        if row.commits().any(|there| there.sequence == new.commit.sequence) {
            return Err(StoreError::Unavailable("a commit of this number is there".into()));
        }
        row.used_ms = now_ms;
        row.commits.push(CommitRow {
            facts: new.commit.clone(),
            payload: new.commit.record.write().into(),
            at_ms: now_ms,
        });
        for object in objects {
            tables.use_object(id, object);
        }
        tables.audited.insert(new.audit.tenant.clone());
        if let Some((tenant, key, fingerprint)) = &new.key
            && self.bug != Some(OldBug::NoKeyOfCommit)
        {
            let logged = LoggedKey {
                tenant: tenant.clone(),
                key: key.clone(),
                fingerprint: *fingerprint,
                session: id.clone(),
                sequence: new.commit.sequence,
                at_ms: now_ms,
            };
            tables.keys.insert((tenant.clone(), key.clone()), logged);
        }
        Ok(())
    }

    /// Gives a node a session whose owner is as it was seen.
    pub fn take(&mut self, node: &str, session: &str, seen: (&str, Generation), now_ms: u64) -> Option<Generation> {
        let (owner, generation) = seen;
        let is_others = !owner.is_empty() && owner != node;
        if is_others && self.tables.has_lease(owner, now_ms) {
            return None;
        }
        let row = self.tables.sessions.get_mut(session)?;
        if row.generation != generation.0 {
            return None;
        }
        row.generation += 1;
        node.clone_into(&mut row.owner);
        let generation = row.generation;
        self.grant(session, generation, node);
        Some(Generation(generation))
    }

    /// Gives a session back.
    pub fn release(&mut self, session: &HeldSession, used_ms: u64) {
        let row = self.tables.sessions.get_mut(&session.id);
        if let Some(row) = row.filter(|row| row.generation == session.generation.0) {
            row.owner.clear();
            row.generation += 1;
            row.used_ms = row.used_ms.max(used_ms);
        }
    }

    /// Renews a lease; returns how often it has run out.
    pub fn renew(&mut self, id: &str, row: NodeRow, lease_ms: u64, now_ms: u64) -> i64 {
        let known = self.tables.nodes.get(id);
        let lapses = match known {
            None => row.lapses + 1,
            Some(there) => there.lapses + i64::from(there.lease_until_ms < now_ms),
        };
        let renewed = NodeRow {
            lapses,
            lease_until_ms: now_ms + lease_ms,
            ..row
        };
        self.tables.nodes.insert(id.to_owned(), renewed);
        lapses
    }

    /// Gives back everything that a node has.
    pub fn leave(&mut self, id: &str) {
        for row in self.tables.sessions.values_mut().filter(|row| row.owner == id) {
            row.owner.clear();
            row.generation += 1;
        }
        self.tables.nodes.remove(id);
    }
}

impl Tables {
    /// Whether a node has a lease.
    pub fn has_lease(&self, node: &str, now_ms: u64) -> bool {
        self.nodes.get(node).is_some_and(|row| row.lease_until_ms > now_ms)
    }

    fn create(&mut self, session: &NewSession, model: &[u8], owner: &str, now_ms: u64) -> Result<(), StoreError> {
        if let Some((tenant, key, _)) = &session.first.key
            && self.keys.contains_key(&(tenant.clone(), key.clone()))
        {
            return Err(StoreError::Repeated);
        }
        let row = SessionRow {
            record: session.record.clone(),
            model: model.into(),
            used_ms: now_ms,
            owner: owner.to_owned(),
            generation: 1,
            commits: Vec::new(),
            snapshot: None,
        };
        self.sessions.insert(session.record.id.clone(), row);
        Ok(())
    }

    fn undo(&mut self, doubt: &UncertainCommit) {
        let id = &doubt.session.id;
        let Some(row) = self.sessions.get_mut(id) else { return };
        if row.generation != doubt.session.generation.0 {
            return;
        }
        if doubt.sequence == 0 {
            self.remove(id);
            return;
        }
        row.commits.retain(|row| row.facts.sequence < doubt.sequence);
        self.keys
            .retain(|_, key| key.session != *id || key.sequence < doubt.sequence);
    }

    fn use_object(&mut self, session: &str, object: &StoredObject) {
        self.uses
            .insert((session.to_owned(), object.name.clone()), object.bytes);
        self.loose.remove(&object.name);
    }

    fn save_snapshot(&mut self, session: &str, sequence: u64, shape: &StoredObject, now_ms: u64) {
        let Some(row) = self.sessions.get_mut(session) else {
            return;
        };
        let object = shape.name.clone();
        let older = row.snapshot.replace(StoredSnapshot { sequence, object });
        if let Some(older) = older.filter(|older| older.object != shape.name) {
            self.uses.remove(&(session.to_owned(), older.object.clone()));
            self.loose.insert(older.object, now_ms);
        }
        self.use_object(session, shape);
    }

    fn delete(&mut self, session: &str, now_ms: u64) {
        for object in self.remove(session) {
            self.loose.insert(object, now_ms);
        }
    }

    /// Removes a session; returns the objects that it used.
    fn remove(&mut self, session: &str) -> Vec<String> {
        self.sessions.remove(session);
        self.keys.retain(|_, key| key.session != session);
        let used: Vec<_> = self
            .uses
            .keys()
            .filter(|(whose, _)| whose == session)
            .cloned()
            .collect();
        self.uses.retain(|(whose, _), _| whose != session);
        used.into_iter().map(|(_, object)| object).collect()
    }

    /// Notes an object that is about to be named; false while a node removes it.
    pub fn note_loose(&mut self, object: &str, now_ms: u64) -> bool {
        let is_locked = self.locked.get(object).is_some_and(|until| *until > now_ms);
        if !is_locked {
            self.loose.insert(object.to_owned(), now_ms);
        }
        !is_locked
    }

    /// Locks the objects that no session has named for long.
    pub fn lock_loose(&mut self, now_ms: u64) -> Vec<String> {
        let is_old = |since: &u64| since + GRACE_MS < now_ms;
        let old: Vec<String> = self
            .loose
            .iter()
            .filter(|(_, since)| is_old(since))
            .map(|(name, _)| name.clone())
            .collect();
        let is_used = |name: &String| self.uses.keys().any(|(_, used)| used == name);
        let is_locked = |name: &String| self.locked.get(name).is_some_and(|until| *until > now_ms);
        let unused: Vec<String> = (old.into_iter())
            .filter(|name| !is_used(name) && !is_locked(name))
            .collect();
        for name in &unused {
            self.locked.insert(name.clone(), now_ms + LOCKED_MS);
        }
        unused
    }

    /// Ends the lock of a removed object.
    pub fn unlock_loose(&mut self, object: &str) {
        self.locked.remove(object);
        self.loose.remove(object);
    }
}
