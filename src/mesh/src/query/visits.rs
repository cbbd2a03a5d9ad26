//! What queries cost, and a bound for the cost of many.
//!
//! A tree answers in a few steps where faces are of about one size and lie beside each other. A model whose faces are as long
//! as the model makes each query look at each face, so that as many queries as vertices cost the square of their number.
//! Structures count what long queries look at, and a [`VisitBudget`] ends the work before it has cost too much. What a query
//! counts depends on the query alone, so whether a budget suffices does not depend on threads.

use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use std::sync::atomic::{AtomicU64, Ordering};

/// Visits after which the progress is asked: far less than a millisecond.
const STRIDE: u64 = 4096;
/// Queries that look at less are not counted: they are as good as free, and threads would wait for each other to count them.
const LONG: u64 = 64;

/// How many nodes, faces or points the long queries of one structure have looked at.
#[derive(Debug, Default)]
pub struct VisitCount(AtomicU64);

impl VisitCount {
    /// Counts a query that has looked at `visits`.
    #[inline]
    pub(crate) fn add(&self, visits: u64) {
        if visits >= LONG {
            self.0.fetch_add(visits, Ordering::Relaxed);
        }
    }

    /// All that was counted.
    pub fn total(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

impl Clone for VisitCount {
    /// A copy has answered nothing yet.
    fn clone(&self) -> Self {
        Self::default()
    }
}

/// Why queries under a budget end early.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum QueryStop {
    /// The caller cancelled.
    Cancelled,
    /// They look at more than so much together.
    TooMany {
        /// What was allowed.
        limit: u64,
    },
}

impl From<Cancelled> for QueryStop {
    fn from(_: Cancelled) -> Self {
        Self::Cancelled
    }
}

/// What many queries may look at together, on whatever threads they run.
pub struct VisitBudget<'a> {
    /// The threads, and the way to cancel.
    pub(crate) exec: &'a Exec<'a>,
    limit: u64,
    /// What all structures that are asked have counted.
    seen: &'a (dyn Fn() -> u64 + Sync),
}

impl<'a> VisitBudget<'a> {
    /// A budget of `limit` visits of the structures whose counts `seen` adds.
    pub fn new(limit: u64, seen: &'a (dyn Fn() -> u64 + Sync), exec: &'a Exec<'a>) -> Self {
        Self { exec, limit, seen }
    }

    /// Asks `ask` about each item in order, on the thread of the caller.
    ///
    /// # Errors
    /// [`QueryStop`], soon after a cancel or when the budget is spent.
    pub(crate) fn ask_each<T, R>(
        &self,
        items: impl ExactSizeIterator<Item = T>,
        mut ask: impl FnMut(T, &[R]) -> R,
    ) -> Result<Vec<R>, QueryStop> {
        let mut answers = Vec::with_capacity(items.len());
        let mut checked = self.check()?;
        for item in items {
            answers.push(ask(item, &answers));
            if (self.seen)().saturating_sub(checked) >= STRIDE {
                checked = self.check()?;
            }
        }
        self.check()?;
        Ok(answers)
    }

    /// Ends work that has visited more than is allowed, or is cancelled; returns the visits so far.
    ///
    /// # Errors
    /// As [`VisitBudget::ask_each`].
    pub(crate) fn check(&self) -> Result<u64, QueryStop> {
        self.exec.check()?;
        let seen = (self.seen)();
        match seen > self.limit {
            true => Err(QueryStop::TooMany { limit: self.limit }),
            false => Ok(seen),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::{CancelFlag, Progress, Silent};

    #[test]
    fn a_budget_suffices_for_what_it_allows_and_not_for_one_visit_more() {
        let pool = Pool::new(1).expect("a thread");
        let exec = Exec::new(&pool, &Silent);
        let costs = [LONG, STRIDE, LONG - 1, 700];
        let total: u64 = LONG + STRIDE + 700;
        let ask = |limit: u64| {
            let count = VisitCount::default();
            let seen = || count.total();
            VisitBudget::new(limit, &seen, &exec).ask_each(costs.iter(), |&cost, _| {
                count.add(cost);
                cost
            })
        };
        assert_eq!(ask(total), Ok(costs.to_vec()));
        assert_eq!(ask(total - 1), Err(QueryStop::TooMany { limit: total - 1 }));
    }

    /// Gives the work up when it is asked for the second time.
    #[derive(Default)]
    struct GivenUp(CancelFlag);

    impl Progress for GivenUp {
        fn cancelled(&self) -> bool {
            let is_over = self.0.cancelled();
            self.0.cancel();
            is_over
        }
    }

    #[test]
    fn long_queries_stop_early_when_cancelled() {
        let pool = Pool::new(1).expect("a thread");
        let given_up = GivenUp::default();
        let exec = Exec::new(&pool, &given_up);
        let count = VisitCount::default();
        let seen = || count.total();
        let mut asked = 0;
        let answers = VisitBudget::new(u64::MAX, &seen, &exec).ask_each(0..100, |_, _: &[()]| {
            asked += 1;
            count.add(STRIDE / 2);
        });
        assert_eq!((answers, asked), (Err(QueryStop::Cancelled), 2));
    }
}
