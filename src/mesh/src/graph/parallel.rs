//! Many independent queries on a thread budget, with the answers in the order of the questions.

use crate::query::{QueryStop, VisitBudget};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use rayon::prelude::*;

/// Questions whose answers are collected before the next ones are asked.
const BLOCK: usize = 1 << 14;
/// Questions that one thread asks in a row.
const RUN: usize = 16;
/// The same where an answer may lean on the one before it.
const LONG_RUN: usize = 64;

/// `ask(item)` for each item, in order, whatever the number of threads.
pub fn map<T: Sync, R: Send>(
    items: &[T],
    budget: &VisitBudget<'_>,
    ask: impl Fn(&T) -> R + Sync + Send,
) -> Result<Vec<R>, QueryStop> {
    map_runs(items, RUN, budget, |item, _| ask(item))
}

/// As [`map`], but each answer may lean on the one before it in its run of items, which the caller has put next to each other for
/// that. The answer must not depend on it.
pub(super) fn map_along<T: Sync, R: Send>(
    items: &[T],
    budget: &VisitBudget<'_>,
    ask: impl Fn(&T, Option<&R>) -> R + Sync + Send,
) -> Result<Vec<R>, QueryStop> {
    map_runs(items, LONG_RUN, budget, |item, before| ask(item, before.last()))
}

fn map_runs<T: Sync, R: Send>(
    items: &[T],
    run: usize,
    budget: &VisitBudget<'_>,
    ask: impl Fn(&T, &[R]) -> R + Sync + Send,
) -> Result<Vec<R>, QueryStop> {
    let mut answers = Vec::with_capacity(items.len());
    for block in items.chunks(BLOCK) {
        let runs = block.par_chunks(run);
        let asked = runs.map(|run| budget.ask_each(run.iter(), &ask));
        let found: Vec<Vec<R>> = budget.exec.pool.install(|| asked.collect::<Result<_, _>>())?;
        answers.extend(found.into_iter().flatten());
        // All threads have counted by now, so that the same budgets are spent whatever their number.
        budget.check()?;
    }
    Ok(answers)
}

/// As [`map`], for items that are much work each and look at the progress themselves.
pub(super) fn map_few<T: Sync, R: Send, E: From<Cancelled> + Send>(
    items: &[T],
    exec: &Exec<'_>,
    ask: impl Fn(&T) -> Result<R, E> + Sync + Send,
) -> Result<Vec<R>, E> {
    exec.check()?;
    exec.pool.install(|| items.par_iter().map(&ask).collect())
}

/// As [`map`], for numbers that rise. Many are asked about in the order of `space`, which the numbers of near things stand next to
/// each other in, so that one query finds in the cache what the last one read; `space` has all of them, each once.
pub(super) fn map_in_space<R: Send>(
    numbers: &[u32],
    space: impl FnOnce() -> Vec<u32>,
    budget: &VisitBudget<'_>,
    ask: impl Fn(&u32) -> R + Sync + Send,
) -> Result<Vec<R>, QueryStop> {
    let Some(&last) = numbers.last().filter(|_| numbers.len() > BLOCK) else {
        return map(numbers, budget, ask);
    };
    let mut place = vec![u32::MAX; last as usize + 1];
    (0u32..).zip(numbers).for_each(|(k, &n)| place[n as usize] = k);
    let place_of = |n: u32| place.get(n as usize).copied().filter(|&k| k != u32::MAX);
    let order: Vec<u32> = space().into_iter().filter_map(place_of).collect();
    debug_assert_eq!(order.len(), numbers.len());
    let found = map(&order, budget, |&k| ask(&numbers[k as usize]))?;
    let mut answers: Vec<Option<R>> = numbers.iter().map(|_| None).collect();
    for (k, answer) in order.into_iter().zip(found) {
        answers[k as usize] = Some(answer);
    }
    Ok(answers.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant_exec::pool::Pool;
    use pliant_exec::progress::Silent;

    #[test]
    fn answers_stand_in_the_order_of_the_questions_whatever_order_they_are_asked_in() {
        let pool = Pool::new(2).expect("threads");
        let exec = Exec::new(&pool, &Silent);
        let budget = VisitBudget::new(u64::MAX, &|| 0, &exec);
        let numbers: Vec<u32> = (0..2 * BLOCK as u32).map(|k| 3 * k + 1).collect();
        let backwards = || (0..6 * BLOCK as u32 + 9).rev().collect();
        let answers = map_in_space(&numbers, backwards, &budget, |n| n + 5).expect("not cancelled");
        assert!(answers.into_iter().eq(numbers.iter().map(|n| n + 5)));
    }
}
