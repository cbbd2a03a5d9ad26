//! A node: a manager of sessions on the model database, in a loop of starting, serving and leaving.

use crate::bucket::Bucket;
use crate::connection::{Connection, SharedDatabase};
use crate::engine::OpenPoints;
use crate::faults::Faults;
use crate::post::Post;
use crate::random::Random;
use crate::report::Report;
use crate::time::now_ms;
use object_store::memory::InMemory;
use pliant_session::store::{NodeIdentity, SimulatedDatabase, Store};
use pliant_session::{Error, Manager, MemoryUse, SessionConfig, Surroundings};
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::Notify;

/// How long a node has its sessions without a heartbeat.
const LEASE: Duration = Duration::from_secs(2);
/// How often it sends one.
const HEARTBEAT: Duration = Duration::from_millis(500);
/// How long a node that leaves waits for its calls.
const LEAVING: Duration = Duration::from_secs(5);
/// How long it waits for its memory: calls that wait for the database wait ten seconds for it, or twice that behind another one.
const EMPTY: Duration = Duration::from_secs(40);
/// Before a node that did not reach the database tries again.
const BETWEEN_STARTS: Duration = Duration::from_millis(300);

/// What all nodes have in common, and the seed of one.
#[derive(Clone)]
pub struct NodeParts {
    pub name: String,
    pub calls: Arc<Post<Manager>>,
    pub database: Arc<Post<SharedDatabase>>,
    pub objects: Arc<InMemory>,
    pub random: Random,
    pub faults: Faults,
    /// Asks the node to leave.
    pub leave: Arc<Notify>,
    pub report: Report,
}

/// A machine whose calendar is the simulation's, and whose random bits follow from the seed.
#[derive(Debug)]
struct SimulatedSurroundings(Random);

impl Surroundings for SimulatedSurroundings {
    fn now_ms(&self) -> u64 {
        now_ms()
    }

    fn random(&self) -> Result<u128, Error> {
        Ok(u128::from(self.0.number()) << 64 | u128::from(self.0.number()))
    }

    fn computes_inline(&self) -> bool {
        true
    }
}

/// Limits so low that sessions make room for each other all the time.
fn config() -> SessionConfig {
    SessionConfig {
        sessions: 3,
        memory_bytes: 12 << 20,
        compute_threads: 1,
        idle: Duration::from_secs(4),
        ..SessionConfig::default()
    }
}

impl NodeParts {
    /// Starts, serves and leaves until the simulation ends.
    pub async fn run(self) -> turmoil::Result {
        loop {
            let (manager, store) = self.start().await;
            self.report.count_start();
            let served = Arc::clone(&self.calls).serve(manager.clone(), self.faults.split());
            tokio::select! {
                biased;
                failed = served => return failed,
                () = self.leave.notified() => {}
            }
            manager.start_drain();
            let _ = tokio::time::timeout(LEAVING, manager.drained()).await;
            manager.abort();
            self.check_memory(&manager).await;
            drop(manager);
            store.close().await;
        }
    }

    async fn start(&self) -> (Manager, Arc<Store>) {
        loop {
            match self.try_start().await {
                Ok(started) => return started,
                Err(_) => tokio::time::sleep(BETWEEN_STARTS).await,
            }
        }
    }

    async fn try_start(&self) -> Result<(Manager, Arc<Store>), Error> {
        let id = format!("{}-{:016x}", self.name, self.random.number());
        let connection = Connection {
            node: id.clone(),
            post: Arc::clone(&self.database),
            writing: None,
        };
        let database = SimulatedDatabase {
            sessions: Arc::new(connection.clone()),
            nodes: Arc::new(connection.clone()),
            transactions: Box::new(connection),
            objects: Arc::new(Bucket {
                objects: Arc::clone(&self.objects),
                faults: self.faults.split(),
            }),
        };
        let node = NodeIdentity {
            name: self.name.clone(),
            address: format!("http://{}", self.name),
            lease: LEASE,
            heartbeat: HEARTBEAT,
        };
        let surroundings = Arc::new(SimulatedSurroundings(self.random.split()));
        let store = Arc::new(Store::simulated(database, node, id, surroundings).await?);
        let opener = OpenPoints(self.faults.split());
        let manager = Manager::with_store(config(), opener, Arc::clone(&store)).await?;
        Ok((manager, store))
    }

    /// A node that has left holds no bytes of sessions, uploads or answers.
    async fn check_memory(&self, manager: &Manager) {
        let held = || {
            let uses = [MemoryUse::Sessions, MemoryUse::Uploads, MemoryUse::Answers];
            uses.map(|what| manager.metrics().held_bytes(what).get())
        };
        let empty = async {
            while manager.metrics().sessions.get() != 0 || held() != [0; 3] {
                tokio::time::sleep(Duration::from_millis(50)).await;
            }
        };
        if tokio::time::timeout(EMPTY, empty).await.is_err() {
            let (sessions, held) = (manager.metrics().sessions.get(), held());
            self.report.violation(format!(
                "{} left with {sessions} sessions and {held:?} bytes",
                self.name
            ));
        }
    }
}
