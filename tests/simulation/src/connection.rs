//! A node's connections to the model database: each call is a question across the simulated network.

use crate::post::{NoAnswer, Post};
use crate::tables::{Database, NodeRow, SessionRow};
use crate::time::now_ms;
use async_trait::async_trait;
use futures::FutureExt as _;
use pliant_session::store::{
    Commit, Generation, HeldSession, ListedSession, LoggedKey, NodeIdentity, NodeLoad, NodeTables, RemoveObject,
    SessionOwner, SessionTables, StoreError, StoredFacts, StoredSession, TransactionWriter, UncertainCommits,
    WriteFailure, WriteOrder, Written,
};
use pliant_session::{OwnerAddress, Tenant};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The host of the database.
pub const DATABASE: &str = "database";
/// How long a read waits.
const READ: Duration = Duration::from_secs(5);
/// How long a transaction waits.
const WRITE: Duration = Duration::from_secs(10);
/// Between two tries for an object that another node removes.
const BETWEEN_TRIES: Duration = Duration::from_millis(20);

/// The database as its host has it.
pub type SharedDatabase = Arc<Mutex<Database>>;

/// A node's way to the database.
#[derive(Clone)]
pub struct Connection {
    /// The id of the node.
    pub node: String,
    /// The way.
    pub post: Arc<Post<SharedDatabase>>,
    /// The number of the connection that writes, while there is one.
    pub writing: Option<u64>,
}

impl std::fmt::Debug for Connection {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Connection({})", self.node)
    }
}

/// What a caller learns when no answer comes.
pub fn away(_: NoAnswer) -> StoreError {
    StoreError::Unavailable("the database does not answer".into())
}

impl Connection {
    async fn ask<T: Send + 'static>(
        &self,
        patience: Duration,
        question: impl FnOnce(&mut Database) -> T + Send + 'static,
    ) -> Result<T, StoreError> {
        let asked = move |database: SharedDatabase| {
            let mut open = database.lock().unwrap_or_else(PoisonError::into_inner);
            let answer = question(&mut open);
            async move { answer }.boxed()
        };
        self.post.ask(DATABASE, patience, asked).await.map_err(away)
    }

    async fn read<T: Send + 'static>(
        &self,
        question: impl FnOnce(&mut Database) -> T + Send + 'static,
    ) -> Result<T, StoreError> {
        self.ask(READ, question).await
    }
}

fn of_tenant<'a>(database: &'a Database, tenant: &Tenant, id: &str) -> Option<&'a SessionRow> {
    database
        .tables
        .sessions
        .get(id)
        .filter(|row| row.record.tenant == *tenant)
}

fn listed(row: &SessionRow) -> Option<ListedSession> {
    let read = row.read().ok()?;
    let newest = read.commits.last()?.clone();
    let record_of = |sequence: u64| {
        read.commits
            .iter()
            .find(|c| c.sequence == sequence)
            .map(|c| c.record.clone())
    };
    Some(ListedSession {
        facts: record_of(newest.facts_at)?,
        poses: record_of(newest.poses_at)?,
        record: read.record.clone(),
        used_ms: read.used_ms,
        newest,
    })
}

fn is_expired(row: &SessionRow, since_ms: u64, now_ms: u64) -> bool {
    let ttl = u64::try_from(row.record.ttl.as_millis()).unwrap_or(u64::MAX);
    row.used_ms.saturating_add(ttl) < now_ms && since_ms.saturating_add(ttl) < now_ms
}

#[async_trait]
impl SessionTables for Connection {
    async fn session(&self, tenant: &Tenant, id: &str) -> Result<Option<StoredSession>, StoreError> {
        let (tenant, id) = (tenant.clone(), id.to_owned());
        let found = self.read(move |db| of_tenant(db, &tenant, &id).map(SessionRow::read));
        found.await?.transpose()
    }

    async fn commit(&self, session: &str, sequence: u64) -> Result<Option<(Commit, Vec<u8>)>, StoreError> {
        let id = session.to_owned();
        let found = self.read(move |db| db.tables.sessions.get(&id).and_then(|row| row.read_commit(sequence)));
        found.await?.transpose()
    }

    async fn holds(&self, tenant: &Tenant, id: &str) -> Result<bool, StoreError> {
        let (tenant, id) = (tenant.clone(), id.to_owned());
        self.read(move |db| of_tenant(db, &tenant, &id).is_some()).await
    }

    async fn list(
        &self,
        tenant: &Tenant,
        after: u64,
        most: usize,
    ) -> Result<Vec<(u64, Option<ListedSession>)>, StoreError> {
        let tenant = tenant.clone();
        self.read(move |db| {
            let rows = db.tables.sessions.values();
            let mut rows: Vec<&SessionRow> = rows
                .filter(|row| row.record.tenant == tenant && row.record.number > after)
                .collect();
            rows.sort_unstable_by_key(|row| row.record.number);
            rows.truncate(most);
            rows.into_iter().map(|row| (row.record.number, listed(row))).collect()
        })
        .await
    }

    async fn expired(&self, since_ms: u64, now_ms: u64) -> Result<Vec<(Tenant, String)>, StoreError> {
        self.read(move |db| {
            let rows = db.tables.sessions.values();
            rows.filter(|row| is_expired(row, since_ms, now_ms))
                .map(|row| (row.record.tenant.clone(), row.record.id.clone()))
                .collect()
        })
        .await
    }

    async fn count_sessions(&self, tenant: &Tenant) -> Result<u64, StoreError> {
        let tenant = tenant.clone();
        self.read(move |db| {
            let rows = db.tables.sessions.values();
            rows.filter(|row| row.record.tenant == tenant).count() as u64
        })
        .await
    }

    async fn sessions_by_tenant(&self) -> Result<Vec<(Tenant, u64)>, StoreError> {
        self.read(|db| {
            let mut counts = BTreeMap::new();
            for row in db.tables.sessions.values() {
                *counts.entry(row.record.tenant.clone()).or_default() += 1;
            }
            counts.into_iter().collect()
        })
        .await
    }

    async fn stored_bytes(&self, tenant: &Tenant) -> Result<u64, StoreError> {
        let tenant = tenant.clone();
        self.read(move |db| {
            let rows = (db.tables.sessions.iter()).filter(|(_, row)| row.record.tenant == tenant);
            let of_objects = |id: &String| -> u64 {
                let uses = db.tables.uses.iter().filter(|((session, _), _)| session == id);
                uses.map(|(_, bytes)| bytes).sum()
            };
            rows.map(|(id, row)| row.record_bytes() + of_objects(id)).sum()
        })
        .await
    }

    async fn highest_number(&self) -> Result<u64, StoreError> {
        self.read(|db| {
            let rows = db.tables.sessions.values();
            rows.map(|row| row.record.number).max().unwrap_or_default()
        })
        .await
    }

    async fn keys(&self) -> Result<Vec<LoggedKey>, StoreError> {
        self.read(|db| {
            let mut keys: Vec<LoggedKey> = db.tables.keys.values().cloned().collect();
            keys.sort_by_key(|key| key.at_ms);
            keys
        })
        .await
    }

    async fn key(&self, tenant: &Tenant, key: &str) -> Result<Option<LoggedKey>, StoreError> {
        let place = (tenant.clone(), key.to_owned());
        self.read(move |db| db.tables.keys.get(&place).cloned()).await
    }

    async fn all_sessions(&self) -> Result<Vec<StoredFacts>, StoreError> {
        Ok(Vec::new())
    }

    async fn audited_tenants(&self) -> Result<Vec<Tenant>, StoreError> {
        self.read(|db| db.tables.audited.iter().cloned().collect()).await
    }

    async fn unmeasured_objects(&self) -> Result<Vec<String>, StoreError> {
        Ok(Vec::new())
    }

    async fn used_objects(&self) -> Result<Vec<String>, StoreError> {
        self.read(|db| db.tables.uses.keys().map(|(_, object)| object.clone()).collect())
            .await
    }

    async fn is_used(&self, object: &str, session: Option<&str>) -> Result<bool, StoreError> {
        let (object, session) = (object.to_owned(), session.map(str::to_owned));
        self.read(move |db| {
            let mut uses = db.tables.uses.keys();
            uses.any(|(whose, used)| *used == object && session.as_ref().is_none_or(|session| whose == session))
        })
        .await
    }

    async fn check_integrity(&self, _folder: Option<&Path>) -> Result<(), StoreError> {
        Ok(())
    }

    async fn close(&self) {}
}

#[async_trait]
impl NodeTables for Connection {
    async fn renew(&self, id: &str, node: &NodeIdentity, load: NodeLoad, known: i64) -> Result<i64, StoreError> {
        let row = NodeRow {
            name: node.name.clone(),
            address: node.address.clone(),
            lapses: known,
            lease_until_ms: 0,
            load,
        };
        let id = id.to_owned();
        let lease_ms = u64::try_from(node.lease.as_millis()).unwrap_or(u64::MAX);
        self.read(move |db| db.renew(&id, row, lease_ms, now_ms())).await
    }

    async fn nodes(&self) -> Result<Vec<(OwnerAddress, NodeLoad)>, StoreError> {
        self.read(|db| {
            let rows = db.tables.nodes.values();
            let rows = rows.filter(|row| row.lease_until_ms > now_ms() && !row.load.is_leaving);
            let mut nodes: Vec<_> = rows.map(|row| (address_of(row), row.load)).collect();
            nodes.sort_by(|(a, _), (b, _)| a.node.cmp(&b.node));
            nodes
        })
        .await
    }

    async fn leave(&self, id: &str) -> Result<(), StoreError> {
        let id = id.to_owned();
        self.read(move |db| db.leave(&id)).await
    }

    async fn owner(&self, tenant: &Tenant, session: &str) -> Result<Option<SessionOwner>, StoreError> {
        let (tenant, id) = (tenant.clone(), session.to_owned());
        self.read(move |db| {
            let row = of_tenant(db, &tenant, &id)?;
            let node = db.tables.nodes.get(&row.owner);
            Some(SessionOwner {
                node: row.owner.clone(),
                generation: Generation(row.generation),
                address: node.map(address_of).unwrap_or_else(|| OwnerAddress {
                    address: String::new(),
                    node: String::new(),
                }),
                is_leaving: node.is_some_and(|node| node.load.is_leaving),
                has_lease: db.tables.has_lease(&row.owner, now_ms()),
            })
        })
        .await
    }

    async fn take(&self, id: &str, session: &str, seen: &SessionOwner) -> Result<Option<Generation>, StoreError> {
        let (id, session, seen) = (id.to_owned(), session.to_owned(), seen.clone());
        self.read(move |db| db.take(&id, &session, (&seen.node, seen.generation), now_ms()))
            .await
    }

    async fn is_expired(&self, session: &str, since_ms: u64, now_ms: u64) -> Result<bool, StoreError> {
        let id = session.to_owned();
        self.read(move |db| {
            let row = db.tables.sessions.get(&id);
            row.is_some_and(|row| is_expired(row, since_ms, now_ms))
        })
        .await
    }

    async fn release(&self, session: &HeldSession, used_ms: u64) -> Result<(), StoreError> {
        let session = session.clone();
        self.read(move |db| db.release(&session, used_ms)).await
    }

    async fn held(&self, id: &str) -> Result<BTreeMap<String, Generation>, StoreError> {
        let id = id.to_owned();
        self.read(move |db| {
            let rows = db.tables.sessions.iter().filter(|(_, row)| row.owner == id);
            rows.map(|(session, row)| (session.clone(), Generation(row.generation)))
                .collect()
        })
        .await
    }

    async fn next_number(&self) -> Result<u64, StoreError> {
        self.read(|db| {
            db.tables.newest_number += 1;
            db.tables.newest_number
        })
        .await
    }

    async fn note_loose(&self, object: &str) -> Result<(), StoreError> {
        loop {
            let object = object.to_owned();
            if self.read(move |db| db.tables.note_loose(&object, now_ms())).await? {
                return Ok(());
            }
            tokio::time::sleep(BETWEEN_TRIES).await;
        }
    }

    async fn remove_loose(&self, remove: &RemoveObject<'_>) -> Result<(), StoreError> {
        for object in self.read(|db| db.tables.lock_loose(now_ms())).await? {
            remove(object.clone()).await?;
            self.read(move |db| db.tables.unlock_loose(&object)).await?;
        }
        Ok(())
    }

    async fn close(&self) {}
}

fn address_of(row: &NodeRow) -> OwnerAddress {
    OwnerAddress {
        address: row.address.clone(),
        node: row.name.clone(),
    }
}

#[async_trait]
impl TransactionWriter for Connection {
    async fn write(
        &mut self,
        uncertain: &UncertainCommits,
        orders: &[&WriteOrder],
    ) -> Result<Vec<Written>, WriteFailure> {
        let node = self.node.clone();
        let number = match self.writing {
            Some(number) => number,
            None => {
                let connected = self.read(move |db| {
                    let number = db.connections.entry(node).or_default();
                    *number += 1;
                    *number
                });
                connected.await.map_err(WriteFailure::NoConnection)?
            }
        };
        self.writing = Some(number);
        let (node, uncertain) = (self.node.clone(), uncertain.clone());
        let orders: Vec<WriteOrder> = orders.iter().map(|&order| order.clone()).collect();
        let written = self.ask(WRITE, move |db| {
            db.transact((&node, number), &uncertain, &orders, now_ms())
        });
        let answers = written.await.and_then(|answers| answers);
        answers.map_err(WriteFailure::Transaction)
    }

    async fn finish(&mut self) {
        self.give_up().await;
    }

    async fn give_up(&mut self) {
        self.writing = None;
    }
}
