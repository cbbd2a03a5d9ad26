//! Process-wide compute slots: async callers on one side, the thread pools on the other.
//!
//! A caller takes a slot before it moves anything to a pool, so a rejected caller loses nothing. Interactive work
//! (poses, commits and reads of a shape) has its own slots and threads, so it never waits for a long build. Builds,
//! edits and animations have others, whose threads the operating system serves last. Interactive drags come first and
//! have slots that nothing else gets. In a lane tenants take turns, in a tenant its sessions. Work that would wait
//! longer than it may is rejected at once. A build may take minutes: while one tenant has all slots for builds, there
//! is one more for another tenant.
//!
//! Threads that each run one piece of work alone.
//!
//! A solve on the threads of a pool synchronises after every colour and every pass. That makes one solve faster and
//! many slower: when every slot is taken, the threads only steal pieces of each other's solves, and pay for each with a
//! synchronisation and cold caches. Results are bit-identical for any number of threads.

use crate::answers::WorkOwner;
use crate::capacity::fair_line::{FairLine, LinePermit, LinePlace, LineRefusal, LineSlots, TurnClass};
use crate::capacity::work_watch::WorkSpan;
use crate::config::SessionConfig;
use crate::error::{Error, ErrorCode};
use crate::metrics::{GaugeUnit, Metrics};
use pliant_exec::pool::{Pool, PoolError};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::{Semaphore, oneshot};

/// So many slots come with one more that only drags get.
const SLOTS_A_DRAG: usize = 4;

/// Slots for builds that are there for other tenants while one tenant has all, and threads for them.
pub const SLOTS_FOR_ANOTHER_TENANT: usize = 1;

/// Threads that pack answers and drop what is large.
const PACKING_THREADS: usize = 2;

/// Answers that may wait to be packed.
const PACKING_QUEUE: usize = 256;

/// The lane of waiting work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum WorkLane {
    /// A dragged pose: before other interactive work.
    Drags,
    /// Commits and reads of a shape.
    Interactive,
    /// Builds, edits and frames of animations.
    Builds,
}

/// Threads, and the line for them.
#[derive(Debug, Clone)]
struct ComputeLane {
    pool: Pool,
    /// Runs work while the pool has less than two threads for each piece.
    alone: SingleThreads,
    /// Runs work of another tenant while one has all slots, and maybe all threads of the pool.
    for_another: SingleThreads,
    line: Arc<FairLine>,
}

/// The thread pools and the lines for them.
#[derive(Debug, Clone)]
pub(crate) struct ComputeSlots {
    interactive: ComputeLane,
    builds: ComputeLane,
    /// Runs work without a slot, apart from solves.
    packing: Pool,
    packing_seats: Arc<Semaphore>,
    wait: Duration,
    metrics: Arc<Metrics>,
}

/// What a piece of work runs on.
#[derive(Debug)]
enum SlotThreads {
    Shared(Pool),
    Alone(SingleThread),
}

/// The right to run one piece of work.
#[derive(Debug)]
pub(crate) struct ComputeSlot {
    permit: LinePermit,
    threads: SlotThreads,
    metrics: Arc<Metrics>,
    /// How long its owner waited for it.
    pub queued: Duration,
}

/// The work panicked; what it had in hand is lost.
#[derive(Debug)]
pub(crate) struct WorkPanicked(pub String);

impl From<WorkPanicked> for Error {
    fn from(_: WorkPanicked) -> Self {
        Self::new(ErrorCode::Internal, "a defect of the server stopped this work")
    }
}

impl ComputeLane {
    /// So many slots, and `for_drags` more that only drags get. Without threads of their own every piece of work shares the pool.
    fn interactive(all: usize, for_drags: usize, config: &SessionConfig, pool: Pool, alone: SingleThreads) -> Self {
        let slots = LineSlots {
            all,
            for_drags,
            one_for_another_tenant: false,
        };
        Self {
            line: FairLine::new(slots, config.compute_queue),
            pool,
            alone,
            for_another: SingleThreads::default(),
        }
    }

    /// So many slots for work that lasts long: what would run alone would stay alone when the others have ended.
    fn builds(all: usize, config: &SessionConfig, pool: Pool, for_another: SingleThreads) -> Self {
        let slots = LineSlots {
            all,
            for_drags: 0,
            one_for_another_tenant: true,
        };
        Self {
            line: FairLine::new(slots, config.compute_queue),
            pool,
            alone: SingleThreads::default(),
            for_another,
        }
    }

    /// The threads for a piece of work that has its slot already.
    fn threads(&self, permit: &LinePermit) -> SlotThreads {
        let share = self.pool.threads() / self.line.busy().max(1);
        let alone = match share {
            _ if permit.is_reserve() => self.for_another.take(),
            0 | 1 => self.alone.take(),
            _ => None,
        };
        alone.map_or_else(|| SlotThreads::Shared(self.pool.clone()), SlotThreads::Alone)
    }
}

/// How many pieces of work a lane runs at once.
fn slots_of(config: &SessionConfig, pool: &Pool) -> usize {
    if config.compute_slots == 0 {
        pool.threads()
    } else {
        config.compute_slots
    }
}

impl SlotThreads {
    fn pool(&self) -> &Pool {
        match self {
            Self::Shared(pool) => pool,
            Self::Alone(thread) => thread.pool(),
        }
    }
}

impl ComputeSlots {
    /// Starts the threads; with `inline` who asks for work waits until it is done.
    pub fn new(config: &SessionConfig, metrics: Arc<Metrics>, inline: bool) -> Result<Self, Error> {
        let unstarted = |e: pliant_exec::pool::PoolError| Error::new(ErrorCode::Internal, e.to_string());
        let threads = config.compute_threads;
        let started = |threads, role, begin: fn()| {
            let pool = Pool::started_with(threads, role, begin).map_err(unstarted)?;
            Ok::<_, Error>(if inline { pool.inline() } else { pool })
        };
        let builds = started(threads, "build", give_way)?;
        let interactive = started(threads, "compute", || {})?;
        let slots = slots_of(config, &interactive);
        let for_drags = slots.div_ceil(SLOTS_A_DRAG);
        let most = slots + for_drags;
        // With a share of two threads for every slot none would ever run.
        let alone = if interactive.threads() / most < 2 && !inline {
            most
        } else {
            0
        };
        let alone = SingleThreads::start(alone, || {}).map_err(unstarted)?;
        let for_another =
            SingleThreads::start(if inline { 0 } else { SLOTS_FOR_ANOTHER_TENANT }, give_way).map_err(unstarted)?;
        Ok(Self {
            interactive: ComputeLane::interactive(slots, for_drags, config, interactive, alone),
            builds: ComputeLane::builds(slots, config, builds, for_another),
            packing: started(PACKING_THREADS, "pack", || {})?,
            packing_seats: Arc::new(Semaphore::new(PACKING_QUEUE)),
            wait: config.compute_wait,
            metrics,
        })
    }

    fn lane(&self, lane: WorkLane) -> (&ComputeLane, TurnClass) {
        match lane {
            WorkLane::Drags => (&self.interactive, TurnClass::Drag),
            WorkLane::Interactive => (&self.interactive, TurnClass::Other),
            WorkLane::Builds => (&self.builds, TurnClass::Other),
        }
    }

    /// Waits for a slot for a call that arrived then and may take as long as `limit` from then on.
    ///
    /// # Cancel safety
    /// Dropping the future gives up the place in the line.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` at once when too many wait already or the work is not expected to begin in time, and after the longest wait
    /// since the call arrived.
    pub async fn slot(
        &self,
        lane: WorkLane,
        owner: &WorkOwner,
        arrived: Instant,
        limit: Duration,
    ) -> Result<ComputeSlot, Error> {
        let (lane, class) = self.lane(lane);
        let longest = self.wait.min(limit);
        let left = longest.saturating_sub(arrived.elapsed());
        let place = lane
            .line
            .enter(class, owner, Some(left))
            .map_err(|why| self.refuse(why, left))?;
        let permit = match place {
            LinePlace::Free(permit) => permit,
            LinePlace::Waiting(mut place) => {
                let _waiting = GaugeUnit::add_to(&self.metrics.pool_waiting);
                let turn = tokio::time::timeout(left, place.turn()).await.map_err(|_| {
                    self.metrics.refused.inc();
                    let text = format!(
                        "no compute slot came free within {} ms; try again later",
                        longest.as_millis()
                    );
                    Error::exhausted(text, 1)
                })?;
                turn.map_err(|why| self.refuse(why, left))?
            }
        };
        let queued = arrived.elapsed();
        self.metrics.queue.observe(queued.as_secs_f64());
        Ok(self.slot_on(lane, permit, queued))
    }

    /// Refuses a call that arrived then when so many calls before it on its session are expected to take longer than it may wait:
    /// `expected` in all. One alone may be a long edit, which it may wait for.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED`.
    pub fn refuse_long_line(&self, ahead: u64, expected: Duration, arrived: Instant) -> Result<(), Error> {
        if ahead <= 1 || arrived.elapsed().saturating_add(expected) <= self.wait {
            return Ok(());
        }
        self.metrics.refused.inc();
        let (seconds, wait) = (expected.as_secs().saturating_add(1), self.wait.as_millis());
        let text = format!(
            "{ahead} calls wait on this session already, which take about {seconds} s; {wait} ms may be waited"
        );
        Err(Error::exhausted(
            text,
            u32::try_from(seconds).unwrap_or(u32::MAX).min(60),
        ))
    }

    /// The error of a call that cannot run in time.
    fn refuse(&self, why: LineRefusal, left: Duration) -> Error {
        self.metrics.refused.inc();
        match why {
            LineRefusal::Full => Error::exhausted("too much work waits to be computed; try again later", 1),
            LineRefusal::TooLong(expected) => {
                let later = expected.saturating_sub(left).as_secs_f64().ceil().max(1.0);
                let text = format!(
                    "the work that waits is expected to take {:.1} s, and you may wait {:.1} s; try again later",
                    expected.as_secs_f64(),
                    left.as_secs_f64()
                );
                // Saturates.
                Error::exhausted(text, later as u32)
            }
        }
    }

    fn slot_on(&self, lane: &ComputeLane, permit: LinePermit, queued: Duration) -> ComputeSlot {
        ComputeSlot {
            threads: lane.threads(&permit),
            permit,
            metrics: Arc::clone(&self.metrics),
            queued,
        }
    }

    /// Waits for a slot for one frame of an animation, when its turn comes. However long that takes it is not refused: animations have a
    /// limit of their own, and half of one is of no use.
    ///
    /// # Cancel safety
    /// Dropping the future gives up the place in the line.
    ///
    /// # Errors
    /// `UNAVAILABLE` when the slots are gone.
    pub async fn slot_for_frame(&self, owner: &WorkOwner) -> Result<ComputeSlot, Error> {
        let asked = Instant::now();
        let lane = &self.builds;
        let place = lane.line.enter(TurnClass::Other, owner, None);
        let permit = match place.map_err(|_| Error::draining())? {
            LinePlace::Free(permit) => permit,
            LinePlace::Waiting(mut place) => {
                let _waiting = GaugeUnit::add_to(&self.metrics.pool_waiting);
                place.turn().await.map_err(|_| Error::draining())?
            }
        };
        Ok(self.slot_on(lane, permit, asked.elapsed()))
    }

    /// Runs small work that needs no slot, such as packing an answer, where it waits for no solve.
    ///
    /// # Cancel safety
    /// Dropping the future discards the result.
    ///
    /// # Errors
    /// `RESOURCE_EXHAUSTED` when too much of it waits already, `INTERNAL` when it panicked.
    pub async fn offload<R: Send + 'static>(&self, work: impl FnOnce() -> R + Send + 'static) -> Result<R, Error> {
        let session_permit = Arc::clone(&self.packing_seats).try_acquire_owned().map_err(|_| {
            self.metrics.refused.inc();
            Error::exhausted("too many answers wait to be packed; try again later", 1)
        })?;
        let (give, result) = oneshot::channel();
        self.packing.spawn(move || {
            let result = caught(work);
            drop(session_permit);
            let _ = give.send(result);
        });
        let result = result.await;
        result.map_err(|_| Error::draining())?.map_err(Error::from)
    }

    /// Drops what is large without holding up the caller or waiting for a solve.
    pub fn discard(&self, what: impl Send + 'static) {
        self.packing.spawn(move || {
            if let Err(WorkPanicked(text)) = caught(move || drop(what)) {
                tracing::error!(panic = text, "dropping panicked");
            }
        });
    }
}

/// Lets the operating system serve this thread after interactive ones.
fn give_way() {
    #[cfg(target_os = "linux")]
    {
        // Of Linux's threads each has its own; where it is not allowed, both lanes share evenly.
        let _ = rustix::process::nice(10);
    }
}

impl ComputeSlot {
    /// Runs `work` on the pool, inside its span, and counts its time under its kind. The slot is free again when the work has ended,
    /// whether or not anybody waits for it.
    ///
    /// # Cancel safety
    /// Dropping the future discards the result; to stop the work, raise its flag.
    ///
    /// # Errors
    /// [`WorkPanicked`]; the panic goes no further.
    pub async fn run<R: Send + 'static>(
        self,
        WorkSpan { kind, span }: WorkSpan,
        work: impl FnOnce(&Pool) -> R + Send + 'static,
    ) -> Result<R, WorkPanicked> {
        let Self {
            mut permit,
            threads,
            metrics,
            queued,
        } = self;
        span.record("queue_ms", queued.as_secs_f64() * 1e3);
        let (give, result) = oneshot::channel();
        let pool = threads.pool().clone();
        let inside = pool.clone();
        pool.spawn(move || {
            permit.begin();
            let busy = GaugeUnit::add_to(&metrics.pool_busy);
            let begun = Instant::now();
            let result = caught(|| span.in_scope(|| work(&inside)));
            metrics.observe_work(kind.name(), begun.elapsed());
            drop((busy, span));
            // Free before the result is sent, so that the caller finds the slot free.
            drop((threads, permit));
            let _ = give.send(result);
        });
        result
            .await
            .unwrap_or_else(|_| Err(WorkPanicked("the work was dropped".into())))
    }
}

fn caught<R>(work: impl FnOnce() -> R) -> Result<R, WorkPanicked> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|payload| {
        let text = payload.downcast_ref::<&str>().map(|s| (*s).to_owned());
        WorkPanicked(
            text.or_else(|| payload.downcast_ref::<String>().cloned())
                .unwrap_or_else(|| "panic".into()),
        )
    })
}

/// Pools of one thread, and which of them are free.
#[derive(Debug, Clone, Default)]
pub(super) struct SingleThreads {
    free: Arc<Mutex<Vec<Pool>>>,
}

/// A thread that is lent to one piece of work. Free again when dropped.
#[derive(Debug)]
pub(super) struct SingleThread {
    pool: Pool,
    home: SingleThreads,
}

impl SingleThreads {
    /// Starts so many; `begin` is run on each.
    ///
    /// # Errors
    /// [`PoolError`] when the system gives no more threads.
    pub fn start(threads: usize, begin: fn()) -> Result<Self, PoolError> {
        let started: Result<Vec<Pool>, PoolError> = (0..threads)
            .map(|_| Pool::started_with(1, "compute-alone", begin))
            .collect();
        Ok(Self {
            free: Arc::new(Mutex::new(started?)),
        })
    }

    /// A free one, if there is any. The one that was free last comes first: its stack is still in a cache.
    pub fn take(&self) -> Option<SingleThread> {
        let pool = self.free.lock().unwrap_or_else(PoisonError::into_inner).pop()?;
        Some(SingleThread {
            pool,
            home: self.clone(),
        })
    }
}

impl SingleThread {
    /// The thread.
    pub fn pool(&self) -> &Pool {
        &self.pool
    }
}

impl Drop for SingleThread {
    fn drop(&mut self) {
        let mut free = self.home.free.lock().unwrap_or_else(PoisonError::into_inner);
        free.push(self.pool.clone());
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capacity::work_watch::WorkKind;

    fn tried() -> WorkSpan {
        WorkSpan::new(WorkKind::Solve, "", &tracing::Span::none())
    }
    use crate::answers::Tenant;

    fn compute(config: SessionConfig) -> ComputeSlots {
        ComputeSlots::new(&config, Arc::default(), false).expect("threads start")
    }

    /// A slot for a call that may wait long.
    async fn asked(slots: &ComputeSlots) -> Result<ComputeSlot, Error> {
        let owner = WorkOwner {
            tenant: Tenant::default(),
            session: String::new(),
        };
        slots
            .slot(WorkLane::Interactive, &owner, Instant::now(), Duration::MAX)
            .await
    }

    #[tokio::test]
    async fn work_that_cannot_begin_in_time_is_refused_before_it_waits() {
        let one = compute(SessionConfig {
            compute_threads: 1,
            compute_slots: 1,
            ..SessionConfig::default()
        });
        asked(&one)
            .await
            .expect("a slot")
            .run(tried(), |_| ())
            .await
            .expect("runs");
        let held = asked(&one).await.expect("a slot");
        one.interactive
            .line
            .note_service(TurnClass::Other, Duration::from_secs(3600));
        let refused = asked(&one).await.expect_err("too long");
        assert_eq!(refused.http_status(), 429);
        // An eighth of an hour is what is expected by now, and half a minute what may be waited.
        assert_eq!(refused.retry_after_s, Some(421));
        assert!(refused.message.contains("450.0 s"), "{refused}");
        assert_eq!((one.metrics.refused.get(), one.metrics.pool_waiting.get()), (1, 0));
        drop(held);
        asked(&one).await.expect("a free slot is given, whatever is expected");
    }

    #[tokio::test]
    async fn a_panic_ends_the_work_and_frees_the_slot() {
        let one = compute(SessionConfig {
            compute_threads: 1,
            compute_slots: 1,
            ..SessionConfig::default()
        });
        let slot = asked(&one).await.expect("a slot");
        let ended = slot
            .run(tried(), |_| -> u32 { std::panic::panic_any("on purpose") })
            .await;
        assert_eq!(ended.expect_err("panicked").0, "on purpose");
        let slot = asked(&one).await.expect("the slot is free again");
        assert_eq!(slot.run(tried(), |pool| pool.threads()).await.expect("runs"), 1);
    }

    #[tokio::test]
    async fn a_solve_shares_the_threads_until_all_slots_are_taken() {
        let four = compute(SessionConfig {
            compute_threads: 4,
            ..SessionConfig::default()
        });
        let mut held = Vec::new();
        for expected in [4, 4, 1, 1] {
            let slot = asked(&four).await.expect("a slot");
            assert_eq!(slot.threads.pool().threads(), expected, "after {} others", held.len());
            held.push(slot);
        }
        for slot in held {
            slot.run(tried(), |_| ()).await.expect("runs");
        }
        let slot = asked(&four).await.expect("a slot");
        assert_eq!(slot.run(tried(), |pool| pool.threads()).await.expect("runs"), 4);
    }

    #[tokio::test]
    async fn waiting_is_bounded_in_number() {
        let one = compute(SessionConfig {
            compute_threads: 1,
            compute_slots: 1,
            compute_queue: 1,
            ..SessionConfig::default()
        });
        let held = asked(&one).await.expect("a slot");
        let waiter = asked(&one);
        tokio::pin!(waiter);
        assert!(futures::poll!(waiter.as_mut()).is_pending());
        let refused = asked(&one).await.expect_err("no place to wait");
        assert_eq!((refused.http_status(), refused.retry_after_s), (429, Some(1)));
        drop(held);
        waiter.await.expect("its turn");
        assert_eq!((one.metrics.refused.get(), one.metrics.pool_waiting.get()), (1, 0));
    }

    #[tokio::test]
    async fn waiting_is_bounded_in_time() {
        let wait = Duration::from_millis(5);
        let one = compute(SessionConfig {
            compute_threads: 1,
            compute_slots: 1,
            compute_wait: wait,
            ..SessionConfig::default()
        });
        let held = asked(&one).await.expect("a slot");
        assert_eq!(asked(&one).await.expect_err("waited too long").http_status(), 429);
        drop(held);
        asked(&one).await.expect("free again");
    }
}
