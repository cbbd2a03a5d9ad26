//! A store of a simulation: one of several nodes on a database and objects that the simulation makes.

use super::build_identity;
use super::database::{NodeTables, SessionTables, TransactionWriter};
use super::database_store::{Store, StoreWriting};
use super::objects::Objects;
use super::opening::watch_store;
use super::session_store::{NodeIdentity, NodeLoad, StoreError};
use super::shared_store::SharedStore;
use super::writer::{StoreHealth, Writer};
use crate::surroundings::Surroundings;
use object_store::ObjectStore;
use std::sync::Arc;
use std::sync::atomic::AtomicI64;

/// What a simulation gives a store in the place of connections.
#[derive(Debug)]
pub struct SimulatedDatabase {
    /// What is read.
    pub sessions: Arc<dyn SessionTables>,
    /// Nodes and their leases.
    pub nodes: Arc<dyn NodeTables>,
    /// What is written.
    pub transactions: Box<dyn TransactionWriter>,
    /// Objects.
    pub objects: Arc<dyn ObjectStore>,
}

impl Store {
    /// The store of one of several nodes, whose id is `id`. To be called inside a runtime, on which the store is looked after.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] where the database does not answer.
    pub async fn simulated(
        database: SimulatedDatabase,
        node: NodeIdentity,
        id: String,
        surroundings: Arc<dyn Surroundings>,
    ) -> Result<Self, StoreError> {
        let objects = Arc::new(Objects::simulated(database.objects));
        let health = Arc::new(StoreHealth::of_places([])?);
        let shared = SharedStore {
            node,
            id,
            tables: database.nodes,
            lapses: AtomicI64::new(0),
            writer: Arc::new(Writer::start(database.transactions, Arc::clone(&health))),
            objects: Arc::clone(&objects),
            health: Arc::clone(&health),
        };
        shared.beat(NodeLoad::default()).await?;
        let writer = Arc::clone(&shared.writer);
        tokio::spawn(watch_store(
            Arc::clone(&health),
            Arc::downgrade(&writer),
            Arc::downgrade(&objects),
        ));
        Ok(Self {
            build: build_identity(),
            tables: database.sessions,
            objects,
            writing: Some(StoreWriting {
                writer,
                health,
                shared: Some(shared),
            }),
            is_written: false,
            folder: None,
            _hold: None,
            faults: None,
            surroundings,
        })
    }
}
