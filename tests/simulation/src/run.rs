//! A run: three nodes, five clients, one database, and what goes wrong.

use crate::client::{Client, KnownCommit, KnownSession};
use crate::connection::{DATABASE, SharedDatabase};
use crate::faults::Faults;
use crate::node::NodeParts;
use crate::post::Post;
use crate::random::Random;
use crate::report::{Outcome, Report};
use crate::tables::{Database, OldBug};
use object_store::ObjectStoreExt as _;
use object_store::memory::InMemory;
use object_store::path::Path;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use turmoil::{Builder, Sim};

const NODES: usize = 3;
const CLIENTS: usize = 4;
/// The step of simulated time.
const TICK: Duration = Duration::from_millis(10);
/// Nothing goes wrong after this time.
const FAULTS_END: Duration = Duration::from_secs(40);
/// A run that is not over by then makes no progress.
const LONGEST: Duration = Duration::from_secs(400);
/// Of a thousand steps so many begin a fault of a host or a way.
const FAULTY_STEPS: u64 = 2;

/// A fault that lasts.
#[derive(Debug, Clone)]
enum LastingFault {
    Crash(String),
    Partition(String, String),
    /// What is sent meanwhile arrives afterwards.
    Hold(String, String),
}

/// What a run consists of.
struct World {
    random: Random,
    faults: Faults,
    report: Report,
    database: SharedDatabase,
    objects: Arc<InMemory>,
    nodes: Vec<NodeParts>,
    lasting: Vec<(Duration, LastingFault)>,
    known: Arc<Mutex<Vec<KnownSession>>>,
}

/// Held by the run of this process.
static ALONE: Mutex<()> = Mutex::new(());
/// Tokio ends the tasks of a runtime in an order that follows from their numbers modulo a power of two below this one.
const TASKS: u64 = 256;

/// Makes the next task of this process one whose number is a multiple of [`TASKS`].
fn align_tasks() {
    let runtime = tokio::runtime::Builder::new_current_thread().build();
    let Ok(runtime) = runtime else { return };
    let number = || runtime.spawn(async {}).id().to_string().parse::<u64>();
    while number().is_ok_and(|number| number % TASKS != TASKS - 1) {}
}

/// Runs a seed, with an old bug of the store put back where one is named. One run at a time in a process.
pub fn run(seed: u64, bug: Option<OldBug>) -> Outcome {
    let _alone = ALONE.lock().unwrap_or_else(PoisonError::into_inner);
    align_tasks();
    let random = Random::of(seed);
    let mut sim = Builder::new()
        .rng_seed(random.number())
        .tick_duration(TICK)
        .simulation_duration(LONGEST * 2)
        .min_message_latency(Duration::from_millis(1))
        .max_message_latency(Duration::from_millis(20))
        .build();
    let mut world = World::new(random, bug);
    world.build(&mut sim);
    let ended = world.go(&mut sim);
    let elapsed = sim.elapsed();
    drop(sim);
    if let Err(problem) = ended {
        world.report.violation(problem);
    }
    world.check_stored();
    let database = world.database.lock().unwrap_or_else(PoisonError::into_inner);
    let mut outcome = Outcome {
        faults: world.faults.injected(),
        milliseconds: u64::try_from(elapsed.as_millis()).unwrap_or(u64::MAX),
        transactions: database.transactions,
        ..world.report.outcome()
    };
    outcome.violations.extend(database.violations.iter().cloned());
    outcome
}

impl World {
    fn new(random: Random, bug: Option<OldBug>) -> Self {
        let (faults, report) = (Faults::of(random.split()), Report::default());
        let database = Arc::new(Mutex::new(Database::with(bug)));
        let (calls, way, objects) = (
            Arc::new(Post::default()),
            Arc::new(Post::default()),
            Arc::new(InMemory::new()),
        );
        let part = |k: usize| NodeParts {
            name: format!("node-{k}"),
            calls: Arc::clone(&calls),
            database: Arc::clone(&way),
            objects: Arc::clone(&objects),
            random: random.split(),
            faults: faults.split(),
            leave: Arc::default(),
            report: report.clone(),
        };
        Self {
            nodes: (0..NODES).map(part).collect(),
            random,
            faults,
            report,
            database,
            objects,
            lasting: Vec::new(),
            known: Arc::default(),
        }
    }

    fn build(&self, sim: &mut Sim<'_>) {
        let (way, database, faults) = (
            Arc::clone(&self.nodes[0].database),
            Arc::clone(&self.database),
            self.faults.split(),
        );
        sim.host(DATABASE, move || {
            Arc::clone(&way).serve(Arc::clone(&database), faults.clone())
        });
        for node in self.nodes.clone() {
            sim.host(node.name.clone(), move || node.clone().run());
        }
        let names: Vec<String> = self.nodes.iter().map(|node| node.name.clone()).collect();
        for k in 0..CLIENTS {
            let client = Client {
                name: format!("client-{k}"),
                nodes: names.clone(),
                calls: Arc::clone(&self.nodes[0].calls),
                random: self.random.split(),
                faults: self.faults.clone(),
                report: self.report.clone(),
                node: names[k % NODES].clone(),
                session: KnownSession::default(),
            };
            let known = Arc::clone(&self.known);
            sim.client(format!("client-{k}"), async move {
                let session = client.run().await;
                known.lock().unwrap_or_else(PoisonError::into_inner).push(session);
                Ok(())
            });
        }
    }

    /// Steps until all clients have ended.
    fn go(&mut self, sim: &mut Sim<'_>) -> Result<(), String> {
        loop {
            let is_over = sim.step().map_err(|e| format!("a host failed: {e}"))?;
            let is_wrong = || {
                !self
                    .database
                    .lock()
                    .unwrap_or_else(PoisonError::into_inner)
                    .violations
                    .is_empty()
            };
            if is_over || self.report.is_violated() || is_wrong() {
                return Ok(());
            }
            let now = sim.elapsed();
            if now > LONGEST {
                return Err(format!("no end after {LONGEST:?}"));
            }
            if self.faults.are_active() && now > FAULTS_END {
                self.faults.end();
            }
            self.end_faults(sim, now);
            if self.faults.happens(FAULTY_STEPS) {
                self.begin_fault(sim, now);
            }
        }
    }

    fn end_faults(&mut self, sim: &mut Sim<'_>, now: Duration) {
        let is_over = |(until, _): &(Duration, LastingFault)| *until <= now || !self.faults.are_active();
        let (over, lasting) = self.lasting.drain(..).partition(is_over);
        self.lasting = lasting;
        for (_, fault) in over {
            match fault {
                LastingFault::Crash(node) => sim.bounce(node),
                LastingFault::Partition(a, b) => sim.repair(a, b),
                LastingFault::Hold(a, b) => sim.release(a, b),
            }
        }
    }

    fn begin_fault(&mut self, sim: &mut Sim<'_>, now: Duration) {
        let node = &self.nodes[self.random.below(0..NODES as u64) as usize];
        let name = node.name.clone();
        let is_down = |name: &String| {
            self.lasting
                .iter()
                .any(|(_, fault)| matches!(fault, LastingFault::Crash(down) if down == name))
        };
        if is_down(&name) {
            return;
        }
        let until = now + self.random.span(50..9000);
        match self.random.below(0..6) {
            0 | 1 => {
                sim.crash(name.clone());
                self.report.line_at(now, format_args!("{name} crashes"));
                self.lasting.push((until, LastingFault::Crash(name)));
            }
            2 => {
                self.report.line_at(now, format_args!("{name} is to leave"));
                node.leave.notify_one();
            }
            3 => {
                let client = format!("client-{}", self.random.below(0..CLIENTS as u64));
                sim.partition(name.clone(), client.clone());
                self.lasting.push((until, LastingFault::Partition(name, client)));
            }
            4 => {
                sim.partition(name.clone(), DATABASE);
                self.report.line_at(now, format_args!("{name} loses the database"));
                self.lasting
                    .push((until, LastingFault::Partition(name, DATABASE.into())));
            }
            _ => {
                sim.hold(name.clone(), DATABASE);
                self.report.line_at(
                    now,
                    format_args!("{name} and the database do not hear each other in time"),
                );
                self.lasting.push((until, LastingFault::Hold(name, DATABASE.into())));
            }
        }
    }

    /// What was acknowledged is stored, once, and nothing else is; objects that are named are whole.
    fn check_stored(&self) {
        if self.report.is_violated() {
            return;
        }
        let database = self.database.lock().unwrap_or_else(PoisonError::into_inner);
        let known = self.known.lock().unwrap_or_else(PoisonError::into_inner);
        for session in known.iter() {
            let row = database.tables.sessions.get(&session.id);
            let stored: Vec<KnownCommit> = row.map_or_else(Vec::new, |row| {
                row.commits().map(|c| (c.revision, c.digest.clone())).collect()
            });
            let fits = |(known, there): (&KnownCommit, &KnownCommit)| {
                known.0 == there.0 && (known.1.is_empty() || known.1 == there.1)
            };
            let is_same =
                stored.len() == session.acknowledged.len() && session.acknowledged.iter().zip(&stored).all(fits);
            if !is_same {
                self.report.violation(format!(
                    "{}: acknowledged {:?}, stored {stored:?}",
                    session.id, session.acknowledged
                ));
            }
        }
        for ((session, object), bytes) in &database.tables.uses {
            let path = Path::from(format!("{}/{object}", &object[..2]));
            let size = futures::executor::block_on(self.objects.head(&path)).map(|facts| facts.size);
            if size.as_ref().ok() != Some(bytes) {
                self.report
                    .violation(format!("object {object} of {session} is {size:?}, not {bytes} bytes"));
            }
        }
    }
}
