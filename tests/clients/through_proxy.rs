//! Three nodes behind HAProxy, as `deploy/haproxy.cfg` sets it up: sessions are dragged and committed through the proxy by the clients for
//! Python and TypeScript as they are, and by this program, while nodes are killed, drained and stopped past their leases, and the
//! database goes away. What was acknowledged is there once, with the bits of a single server.
//!
//! `PLIANT_FAULTS` says how many faults there are, on 24 sessions; the suite has three, on six.

mod drivers;

use crate::support::bucket::TestBucket;
use crate::support::haproxy::{HaProxy, free_port};
use crate::support::place::StorePlace;
use crate::support::postgres::PostgresServer;
use crate::support::process::needed;
use crate::support::process::show;
use crate::support::program::ServedProgram;
use crate::support::server::{bar_obj, ends, eventually, turn_json};
use drivers::{Driver, OwnDriver};
use pliant::server::grpc::client::DeformerClient;
use pliant::wire::pb;
use serde::Deserialize;
use serde_json::{Value, json};
use std::sync::Arc;
use std::time::{Duration, Instant};

const NAMES: [&str; 3] = ["a", "b", "c"];
const LEASE: Duration = Duration::from_secs(1);
/// How long the database is away.
const AWAY: Duration = Duration::from_secs(10);
/// From the end of one fault to the next.
const BETWEEN: Duration = Duration::from_secs(3);

/// What happens to nodes and database.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Fault {
    /// A node is killed with SIGKILL, and started again.
    Kill,
    /// A node is asked to stop, ends on its own, and is started again.
    Drain,
    /// A node is stopped where it is, past its lease, and wakes up as somebody whose sessions others have; meanwhile another one is killed.
    Stop,
    /// The database crashes and comes back after a while.
    DatabaseAway,
}

/// One round of faults of the long run.
const ROUND: [Fault; 8] = [
    Fault::Kill,
    Fault::Drain,
    Fault::Stop,
    Fault::Kill,
    Fault::Stop,
    Fault::Drain,
    Fault::Kill,
    Fault::DatabaseAway,
];

/// What came back of one session.
#[derive(Debug, Deserialize)]
struct Driven {
    id: String,
    /// Commits: how far the bar was turned, and the revision that this made; 0 where it was refused because the store was away.
    commits: Vec<(f64, u64)>,
    /// Poses that were answered.
    answers: u64,
    /// The longest that its stream owed a frame, in seconds: over a cut, from the pose before it to the frame after it.
    away: f64,
    /// How often its stream was looked for again.
    reconnects: u64,
}

/// The nodes, and the proxy before them.
struct Cluster {
    place: StorePlace,
    database: Arc<PostgresServer>,
    proxy: HaProxy,
    ports: [u16; 3],
    nodes: [Option<ServedProgram>; 3],
    starts: u32,
}

impl Cluster {
    /// `None` where PostgreSQL or HAProxy is missing.
    async fn start() -> Option<Self> {
        let database = PostgresServer::start()?;
        let place = StorePlace::in_database_and(database.database().await, TestBucket::serve().await);
        let ports = [free_port(), free_port(), free_port()];
        let mut cluster = Self {
            proxy: HaProxy::start(place.top(), ports)?,
            place,
            database,
            ports,
            nodes: [None, None, None],
            starts: 0,
        };
        for k in 0..NAMES.len() {
            cluster.start_node(k);
        }
        Some(cluster)
    }

    /// Starts a node on its port, under the proxy's address.
    fn start_node(&mut self, k: usize) {
        let listen = format!("127.0.0.1:{}", self.ports[k]);
        let who = ["--advertise", &self.proxy.url, "--node", NAMES[k], "--listen", &listen];
        let how = ["--lease", "1s", "--heartbeat", "200ms", "--drain-deadline", "5s"];
        let reply = [&who[..], &how[..], &["--history", "10000"]].concat();
        let database = self.place.database().map(|d| d.url.as_str());
        // One that does not come up is started again, as an operator would; ten times are a fault.
        let started = (0..10).find_map(|attempt| {
            self.starts += 1;
            let log = format!("log-{}-{}", NAMES[k], self.starts);
            let started = self.place.start_logged(&log, database, &reply);
            started
                .inspect_err(|why| println!("node {}, start {attempt}: {why}", NAMES[k]))
                .ok()
        });
        self.nodes[k] = Some(started.expect("the node starts"));
    }

    fn take(&mut self, k: usize) -> ServedProgram {
        self.nodes[k].take().expect("a node")
    }

    fn node(&self, k: usize) -> &ServedProgram {
        self.nodes[k].as_ref().expect("a node")
    }

    /// The node that has the most sessions: what happens to it is felt.
    async fn fullest(&self) -> usize {
        let mut most = (0, -1.0);
        for k in 0..NAMES.len() {
            let sessions = metric(self.node(k), "pliant_sessions ").await;
            if sessions > most.1 {
                most = (k, sessions);
            }
        }
        most.0
    }

    async fn suffer(&mut self, fault: Fault) {
        let victim = self.fullest().await;
        match fault {
            Fault::Kill => {
                self.take(victim).kill();
                lasting(LEASE / 2).await;
                self.start_node(victim);
            }
            Fault::Drain => {
                self.take(victim).stop().await;
                self.start_node(victim);
            }
            Fault::Stop => {
                self.node(victim).pause();
                lasting(LEASE * 2).await;
                let other = (victim + 1) % NAMES.len();
                self.take(other).kill();
                self.start_node(other);
                lasting(LEASE).await;
                self.node(victim).signal("-CONT");
                let stale = self.node(victim);
                eventually("it knows that others have its sessions", async || {
                    metric(stale, "pliant_sessions_lost_total").await > 0.0
                })
                .await;
            }
            Fault::DatabaseAway => {
                self.database.crash();
                lasting(AWAY).await;
                self.database.go_on();
            }
        }
    }
}

/// Lets a fault, or the time after it, last: leases and clients go by the clock.
async fn lasting(time: Duration) {
    tokio::time::sleep(time).await;
}

/// A figure of `/metrics`.
async fn metric(node: &ServedProgram, name: &str) -> f64 {
    let asked = node.get("/metrics").send().await;
    let text = asked.expect("an answer").text().await.expect("a text");
    let line = text.lines().find(|line| line.starts_with(name));
    line.and_then(|l| l.rsplit(' ').next()?.parse().ok()).unwrap_or(0.0)
}

/// The id of a session as gRPC reports it: the call goes where its session hashes to, and from there to the node that has it.
async fn reported_by_grpc(url: &str, id: &str) -> String {
    let mut client = DeformerClient::connect(url.to_owned()).await.expect("a connection");
    let mut node = None;
    for _ in 0..4 {
        let mut request = tonic::Request::new(pb::SessionRequest { session_id: id.into() });
        request
            .metadata_mut()
            .insert("x-pliant-session", id.parse().expect("a value"));
        if let Some(node) = node {
            request.metadata_mut().insert("x-pliant-node", node);
        }
        match client.get_session(request).await {
            Ok(session) => return session.into_inner().id,
            Err(sent) => node = Some(sent.metadata().get("x-pliant-node").expect("a node").clone()),
        }
    }
    panic!("sent around");
}

/// What a single server makes of the same commits.
async fn history_alone(single: &ServedProgram, angles: &[f64]) -> Value {
    let id = single.open(bar_obj(12), "").await;
    let path = |rest: &str| format!("/v1/sessions/{id}{rest}");
    let handles = json!({"handles": ends()});
    single.done("PUT", &path("/handles"), Some(&handles)).await;
    for angle in angles {
        single.done("POST", &path("/solve"), Some(&turn_json(*angle))).await;
    }
    single.done("GET", &path("/history"), None).await
}

/// The revisions that poses made.
fn revisions(history: &Value) -> Vec<u64> {
    let commits = history["commits"].as_array().expect("commits").iter();
    let poses = commits.filter(|commit| commit["kind"] == "pose");
    let number = |value: &Value| value.as_u64().or_else(|| value.as_str()?.parse().ok());
    poses
        .map(|commit| number(&commit["revision"]).expect("a number"))
        .collect()
}

/// Faults one after the other, and how many sessions suffer them.
fn plan() -> (Vec<Fault>, usize) {
    let asked = std::env::var("PLIANT_FAULTS").ok();
    let asked: Option<usize> = asked.map(|text| text.parse().expect("PLIANT_FAULTS is a number"));
    match asked {
        Some(faults) => (ROUND.into_iter().cycle().take(faults).collect(), 24),
        None => (ROUND[..3].to_vec(), 6),
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 4)]
async fn sessions_outlive_their_nodes_behind_a_proxy() {
    let mut cluster = needed!(Cluster::start().await);
    let (faults, sessions) = plan();
    let url = cluster.proxy.url.clone();
    // A third each, and what is missing here is left to the others.
    let mut drivers = Vec::new();
    for start in [Driver::python, Driver::typescript] {
        drivers.extend(tokio::task::block_in_place(|| {
            start(&url, cluster.place.top(), sessions / 3)
        }));
    }
    let own = OwnDriver::start(&url, sessions - drivers.len() * (sessions / 3)).await;
    for id in &own.ids {
        assert_eq!(reported_by_grpc(&url, id).await, *id);
    }
    lasting(BETWEEN).await;
    let begun = Instant::now();
    for fault in &faults {
        cluster.suffer(*fault).await;
        lasting(BETWEEN).await;
    }
    let took = begun.elapsed();
    let mut all = own.finish().await;
    for driver in drivers {
        let (name, driven) = tokio::task::block_in_place(|| driver.finish());
        show(&figures(name, &driven));
        all.extend(driven);
    }
    show(&format!(
        "{} faults in {:.0} s: {}",
        faults.len(),
        took.as_secs_f64(),
        figures("all", &all)
    ));
    assert_eq!(all.len(), sessions);
    let alone = StorePlace::folder().await.expect("a folder");
    let single = alone.start(&["--history", "10000"]);
    let mut rows = 0;
    for driven in &all {
        assert!(driven.acknowledged().count() > faults.len(), "{driven:?}");
        let asked = format!("/v1/sessions/{}/history", driven.id);
        let history = drivers::insist(&url, ("GET", &asked), None, "").await;
        let angles = driven.angles_of(&revisions(&history));
        rows += angles.len() + 2;
        assert_eq!(
            history,
            history_alone(&single, &angles).await,
            "with the digests of a single server"
        );
    }
    // Nothing lies beside what histories report, and every shape can be made again.
    for k in 0..NAMES.len() {
        cluster.take(k).stop().await;
    }
    assert_eq!(
        cluster.place.count("commits").await,
        rows as i64,
        "no stale write has landed"
    );
    let checked = cluster.place.store(&["check", "--replay"]);
    assert_eq!(checked.code, 0, "{}{}", checked.out, checked.err);
}

impl Driven {
    fn acknowledged(&self) -> impl Iterator<Item = u64> {
        self.commits
            .iter()
            .map(|(_, revision)| *revision)
            .filter(|revision| *revision > 0)
    }

    /// How far the bar was turned by each of these revisions, which a history reports: every acknowledged commit is there once, and no other
    /// but one that was refused. Such a one may be there where its node has lost the database in the middle of it and then the
    /// session, before it could take it back.
    fn angles_of(&self, revisions: &[u64]) -> Vec<f64> {
        let mut left = revisions.iter().copied().peekable();
        let mut angles = Vec::new();
        for (angle, revision) in &self.commits {
            let is_there = match revision {
                0 => left
                    .peek()
                    .is_some_and(|next| self.acknowledged().all(|known| known != *next)),
                acknowledged => {
                    assert_eq!(left.peek(), Some(acknowledged), "{self:?} of {revisions:?}");
                    true
                }
            };
            if is_there {
                angles.push(*angle);
                left.next();
            }
        }
        assert_eq!(left.next(), None, "{self:?} of {revisions:?}");
        angles
    }
}

/// What came back, in one line.
fn figures(of: &str, driven: &[Driven]) -> String {
    let mut away: Vec<f64> = driven.iter().map(|d| d.away).collect();
    away.sort_by(f64::total_cmp);
    format!(
        "{of}: {} sessions, {} commits acknowledged, {} poses answered, {} looks for a new stream, longest absence of \
         a stream {:.1} s (median of sessions {:.1} s)",
        driven.len(),
        driven.iter().map(|d| d.acknowledged().count()).sum::<usize>(),
        driven.iter().map(|d| d.answers).sum::<u64>(),
        driven.iter().map(|d| d.reconnects).sum::<u64>(),
        away.last().copied().unwrap_or_default(),
        away.get(away.len() / 2).copied().unwrap_or_default(),
    )
}
