//! The one task that writes: orders that come while a transaction is synced go into the next one together, so that
//! commits of several sessions share a sync.
//!
//! A transaction whose end is unknown, because the database went away, may be on disk or not. Its caller got an error,
//! so what it may have left is removed with the next transaction, before anything of its session is read.
//!
//! After a failed write the store counts as unable to take writes until a small one works. The task also checks that
//! the files are those that were opened: a folder that was moved away still takes writes, which are then lost.

use super::database::{TransactionWriter, WriteFailure, Written};
use super::session_store::StoreError;
use super::write_order::{UncertainCommits, WriteOrder};
use std::io;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use tokio::sync::{mpsc, oneshot};
use tokio_util::sync::{CancellationToken, DropGuard};

/// Whether a store takes writes.
#[derive(Debug)]
pub(super) struct StoreHealth {
    /// Files and folders of the store, and which they are: device and number.
    places: Vec<(PathBuf, (u64, u64))>,
    /// What the last write failed for.
    problem: Mutex<Option<String>>,
}

fn number_of(path: &Path) -> io::Result<(u64, u64)> {
    let facts = std::fs::metadata(path)?;
    Ok((facts.dev(), facts.ino()))
}

impl StoreHealth {
    /// The health of a store that lies in these files and folders, all of which are there.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] for one that is not.
    pub fn of_places(paths: impl IntoIterator<Item = PathBuf>) -> Result<Self, StoreError> {
        let place = |path: PathBuf| match number_of(&path) {
            Ok(number) => Ok((path, number)),
            Err(error) => Err(StoreError::Unavailable(format!("{}: {error}", path.display()))),
        };
        Ok(Self {
            places: paths.into_iter().map(place).collect::<Result<_, _>>()?,
            problem: Mutex::default(),
        })
    }

    /// Whether files and folders are still those that were opened.
    ///
    /// # Errors
    /// [`StoreError::Unavailable`] for the first that is not.
    pub fn check_places(&self) -> Result<(), StoreError> {
        for (path, number) in &self.places {
            let shown = path.display();
            match number_of(path) {
                Ok(now) if now == *number => {}
                Ok(_) => {
                    let text = format!(
                        "{shown} is another one than was opened; put the first one back, or restart the server"
                    );
                    return Err(StoreError::Unavailable(text));
                }
                Err(error) => {
                    let text = format!("{shown} is not there any more ({error}); put it back, or restart the server");
                    return Err(StoreError::Unavailable(text));
                }
            }
        }
        Ok(())
    }

    /// Remembers that a write failed, and passes its result on.
    pub fn note<T>(&self, result: Result<T, StoreError>) -> Result<T, StoreError> {
        if let Err(StoreError::Unavailable(problem)) = &result {
            let before = self.problem().replace(problem.clone());
            if before.as_ref() != Some(problem) {
                tracing::error!("the store of sessions cannot be written: {problem}");
            }
        }
        result
    }

    /// Whether the last write worked.
    pub fn takes_writes(&self) -> bool {
        self.problem().is_none()
    }

    fn problem(&self) -> MutexGuard<'_, Option<String>> {
        self.problem.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Remembers that a write worked again.
    pub fn recover(&self) {
        if self.problem().take().is_some() {
            tracing::info!("the store of sessions can be written again");
        }
    }
}

/// Orders that may wait; one more waits outside.
const QUEUE: usize = 256;
/// Orders of one transaction.
const GROUP: usize = 64;
#[derive(Debug)]
struct WaitingOrder {
    order: WriteOrder,
    done: oneshot::Sender<Written>,
}

/// The way to the task that writes. It ends when this is dropped.
#[derive(Debug)]
pub(super) struct Writer {
    orders: mpsc::Sender<WaitingOrder>,
    uncertain: Arc<Mutex<UncertainCommits>>,
    /// Raised when nothing is to be written any more.
    closing: CancellationToken,
    /// Raised when everything is written and the connection closed.
    closed: CancellationToken,
}

impl Writer {
    /// Starts the task. It writes while the places of the store are there, and notes what fails.
    pub fn start(transactions: Box<dyn TransactionWriter>, health: Arc<StoreHealth>) -> Self {
        let (orders, waiting) = mpsc::channel(QUEUE);
        let uncertain = Arc::default();
        let task = WritingTask {
            transactions,
            health,
            waiting,
            uncertain: Arc::clone(&uncertain),
        };
        let (closing, closed) = (CancellationToken::new(), CancellationToken::new());
        tokio::spawn(task.run(closing.clone(), closed.clone().drop_guard()));
        Self {
            orders,
            uncertain,
            closing,
            closed,
        }
    }

    /// Writes what waits, and closes the connection. Nothing can be written afterwards.
    pub async fn finish(&self) {
        self.closing.cancel();
        self.closed.cancelled().await;
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
    pub async fn undo_uncertain_commits(&self) -> Result<(), StoreError> {
        let is_certain = uncertain_commits(&self.uncertain).is_empty();
        if !is_certain {
            self.write(WriteOrder::UndoUncertain).await?;
        }
        Ok(())
    }

    /// Whether the creation of a session was refused and may have been written.
    pub fn refused_creation(&self, session: &str) -> bool {
        uncertain_commits(&self.uncertain)
            .get(session)
            .is_some_and(|d| d.sequence == 0)
    }
}

struct WritingTask {
    transactions: Box<dyn TransactionWriter>,
    health: Arc<StoreHealth>,
    waiting: mpsc::Receiver<WaitingOrder>,
    uncertain: Arc<Mutex<UncertainCommits>>,
}

fn uncertain_commits(uncertain: &Mutex<UncertainCommits>) -> MutexGuard<'_, UncertainCommits> {
    uncertain.lock().unwrap_or_else(PoisonError::into_inner)
}

impl WritingTask {
    async fn run(mut self, closing: CancellationToken, _closed: DropGuard) {
        loop {
            let first = tokio::select! {
                biased;
                first = self.waiting.recv() => first,
                () = closing.cancelled() => None,
            };
            let Some(first) = first else { break };
            let mut group = vec![first];
            while group.len() < GROUP
                && let Ok(next) = self.waiting.try_recv()
            {
                group.push(next);
            }
            self.carry_out_group(group).await;
        }
        self.transactions.finish().await;
    }

    async fn carry_out_group(&mut self, group: Vec<WaitingOrder>) {
        let orders: Vec<&WriteOrder> = group.iter().map(|w| &w.order).collect();
        match self.carry_out(&orders).await {
            Ok(answers) => {
                for (waiting, answer) in group.into_iter().zip(answers) {
                    let _ = waiting.done.send(answer);
                }
            }
            // One of them may be at fault: each for itself.
            Err(WriteFailure::Transaction(_)) if group.len() > 1 => {
                self.note_uncertain(&group);
                self.carry_out_each(group).await;
            }
            Err(failure) => {
                if let WriteFailure::Transaction(_) = failure {
                    self.note_uncertain(&group);
                }
                refuse_all(group, &failure);
            }
        }
    }

    async fn carry_out_each(&mut self, group: Vec<WaitingOrder>) {
        let mut waiting = group.into_iter();
        while let Some(next) = waiting.next() {
            match self.carry_out(&[&next.order]).await {
                Ok(mut answers) => {
                    let _ = next.done.send(answers.pop().unwrap_or_else(|| Ok(Vec::new())));
                }
                Err(failure @ WriteFailure::Transaction(_)) => {
                    self.note_uncertain(std::slice::from_ref(&next));
                    refuse_all([next], &failure);
                }
                // The others would only wait for it too.
                Err(failure @ WriteFailure::NoConnection(_)) => {
                    refuse_all(std::iter::once(next).chain(waiting.by_ref()), &failure);
                }
            }
        }
    }

    fn note_uncertain(&mut self, orders: &[WaitingOrder]) {
        let mut uncertain = uncertain_commits(&self.uncertain);
        for doubt in orders.iter().filter_map(|w| w.order.uncertain_commit()) {
            let first = uncertain
                .entry(doubt.session.id.clone())
                .or_insert_with(|| doubt.clone());
            // What was begun under an earlier ownership is another's by now.
            if doubt.session.generation > first.session.generation || doubt.sequence < first.sequence {
                *first = doubt;
            }
        }
    }

    async fn carry_out(&mut self, orders: &[&WriteOrder]) -> Result<Vec<Written>, WriteFailure> {
        let uncertain = uncertain_commits(&self.uncertain).clone();
        self.health
            .note(self.health.check_places())
            .map_err(WriteFailure::NoConnection)?;
        match self.transactions.write(&uncertain, orders).await {
            Ok(answers) => {
                // This task alone adds to them.
                uncertain_commits(&self.uncertain).clear();
                Ok(answers)
            }
            Err(WriteFailure::NoConnection(error)) => self.health.note(Err(error)).map_err(WriteFailure::NoConnection),
            Err(WriteFailure::Transaction(error)) => {
                self.transactions.give_up().await;
                self.health.note(Err(error)).map_err(WriteFailure::Transaction)
            }
        }
    }
}

fn refuse_all(orders: impl IntoIterator<Item = WaitingOrder>, failure: &WriteFailure) {
    let (WriteFailure::NoConnection(error) | WriteFailure::Transaction(error)) = failure;
    for waiting in orders {
        let _ = waiting.done.send(Err(error.clone()));
    }
}
