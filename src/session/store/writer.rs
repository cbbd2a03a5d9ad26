//! The one task that writes: what comes while a transaction is synced goes into the next one together, so that commits of several
//! sessions share the price of a sync.
//!
//! A transaction whose end is not known, because the database went away, may be on disk or not. Its caller was told that nothing
//! changed, so what it may have left is removed with the next transaction, before anything of its session is read.

use super::session_store::StoreError;
use super::write_order::{WriteOrder, undo_doubtful};
use sqlx::{AnyPool, Connection as _};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;
use tokio::sync::{mpsc, oneshot};

/// Orders that may wait; one more waits outside.
const QUEUE: usize = 256;
/// Orders of one transaction.
const GROUP: usize = 64;
/// Longest transaction. A disk that takes longer does not answer.
const PATIENCE: Duration = Duration::from_secs(10);

type Written = Result<Vec<String>, StoreError>;

#[derive(Debug)]
struct WaitingOrder {
    order: WriteOrder,
    done: oneshot::Sender<Written>,
}

/// The way to the task that writes. It ends when this is dropped.
#[derive(Debug)]
pub(super) struct Writer {
    orders: mpsc::Sender<WaitingOrder>,
    doubtful: Arc<Mutex<BTreeMap<String, u64>>>,
}

impl Writer {
    /// Starts the task.
    pub fn start(pool: AnyPool) -> Self {
        let (orders, waiting) = mpsc::channel(QUEUE);
        let doubtful = Arc::default();
        let task = WritingTask {
            pool,
            waiting,
            doubtful: Arc::clone(&doubtful),
        };
        tokio::spawn(task.run());
        Self { orders, doubtful }
    }

    /// Writes an order; it is on disk when this returns. Returns objects that may have no name any more.
    ///
    /// # Cancel safety
    /// When the future is dropped the order may be carried out or not.
    pub async fn write(&self, order: WriteOrder) -> Written {
        let ended = || StoreError::Unavailable("the store is closed".into());
        let (done, answer) = oneshot::channel();
        let waiting = WaitingOrder { order, done };
        self.orders.send(waiting).await.map_err(|_| ended())?;
        answer.await.map_err(|_| ended())?
    }

    /// Removes what was refused and may have been written; to be called before commits are read.
    pub async fn settle(&self) -> Result<(), StoreError> {
        let is_settled = doubts(&self.doubtful).is_empty();
        if !is_settled {
            self.write(WriteOrder::Settle).await?;
        }
        Ok(())
    }

    /// Whether the creation of a session was refused and may have been written.
    pub fn refused_creation(&self, session: &str) -> bool {
        doubts(&self.doubtful).get(session) == Some(&0)
    }
}

struct WritingTask {
    pool: AnyPool,
    waiting: mpsc::Receiver<WaitingOrder>,
    /// Commits that were refused and may be on disk: sessions, and the first number each.
    doubtful: Arc<Mutex<BTreeMap<String, u64>>>,
}

fn doubts(doubtful: &Mutex<BTreeMap<String, u64>>) -> MutexGuard<'_, BTreeMap<String, u64>> {
    doubtful.lock().unwrap_or_else(PoisonError::into_inner)
}

impl WritingTask {
    async fn run(mut self) {
        while let Some(first) = self.waiting.recv().await {
            let mut group = vec![first];
            while group.len() < GROUP
                && let Ok(next) = self.waiting.try_recv()
            {
                group.push(next);
            }
            let orders: Vec<&WriteOrder> = group.iter().map(|w| &w.order).collect();
            match self.carry_out(&orders).await {
                Ok(answers) => {
                    for (waiting, answer) in group.into_iter().zip(answers) {
                        let _ = waiting.done.send(Ok(answer));
                    }
                }
                // One of them may be at fault: each for itself.
                Err(_) if group.len() > 1 => {
                    self.note_doubts(&group);
                    for waiting in group {
                        self.carry_out_alone(waiting).await;
                    }
                }
                Err(error) => {
                    self.note_doubts(&group);
                    for waiting in group {
                        let _ = waiting.done.send(Err(error.clone()));
                    }
                }
            }
        }
        self.pool.close().await;
    }

    async fn carry_out_alone(&mut self, waiting: WaitingOrder) {
        let answer = self.carry_out(&[&waiting.order]).await;
        if answer.is_err() {
            self.note_doubts(std::slice::from_ref(&waiting));
        }
        let _ = waiting
            .done
            .send(answer.map(|mut lists| lists.pop().unwrap_or_default()));
    }

    fn note_doubts(&mut self, orders: &[WaitingOrder]) {
        let mut doubtful = doubts(&self.doubtful);
        for (session, sequence) in orders.iter().filter_map(|w| w.order.doubtful()) {
            let first = doubtful.entry(session).or_insert(sequence);
            *first = sequence.min(*first);
        }
    }

    async fn carry_out(&mut self, orders: &[&WriteOrder]) -> Result<Vec<Vec<String>>, StoreError> {
        let doubtful = doubts(&self.doubtful).clone();
        let transaction = write_together(&self.pool, &doubtful, orders);
        let written = match tokio::time::timeout(PATIENCE, transaction).await {
            Ok(written) => written,
            Err(_) => Err(StoreError::Unavailable(format!("it took longer than {PATIENCE:?}"))),
        };
        if written.is_ok() {
            // This task alone adds to them.
            doubts(&self.doubtful).clear();
        }
        written
    }
}

/// Writes orders in one transaction, after what is to be removed.
async fn write_together(
    pool: &AnyPool,
    doubtful: &BTreeMap<String, u64>,
    orders: &[&WriteOrder],
) -> Result<Vec<Vec<String>>, StoreError> {
    let failed = |e: sqlx::Error| StoreError::Unavailable(e.to_string());
    let mut connection = pool.acquire().await.map_err(failed)?;
    let written = async {
        let mut transaction = connection.begin().await.map_err(failed)?;
        for (session, sequence) in doubtful {
            undo_doubtful(session, *sequence, &mut transaction).await?;
        }
        let mut answers = Vec::with_capacity(orders.len());
        for order in orders {
            answers.push(order.carry_out(&mut transaction).await?);
        }
        transaction.commit().await.map_err(failed)?;
        Ok(answers)
    };
    let written = written.await;
    if written.is_err() {
        // What state it is in is not known; the next transaction gets a fresh one.
        let _ = connection.detach().close_hard().await;
    }
    written
}
