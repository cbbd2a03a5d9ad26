//! Many independent queries on a thread budget, with the answers in the order of the questions.

use crate::exec::Exec;
use crate::progress::Cancelled;
use rayon::prelude::*;

/// Questions asked between two looks at the progress.
const BLOCK: usize = 1 << 14;

/// `ask(item)` for each item, in order, whatever the number of threads.
pub(super) fn map<T: Sync, R: Send>(
    items: &[T],
    exec: &Exec<'_>,
    ask: impl Fn(&T) -> R + Sync + Send,
) -> Result<Vec<R>, Cancelled> {
    let mut answers = Vec::with_capacity(items.len());
    for block in items.chunks(BLOCK) {
        exec.check()?;
        answers.extend(
            exec.pool
                .install(|| block.par_iter().with_min_len(8).map(&ask).collect::<Vec<R>>()),
        );
    }
    Ok(answers)
}

/// As [`map`], for items that are much work each.
pub(super) fn map_few<T: Sync, R: Send>(
    items: &[T],
    exec: &Exec<'_>,
    ask: impl Fn(&T) -> R + Sync + Send,
) -> Result<Vec<R>, Cancelled> {
    exec.check()?;
    Ok(exec.pool.install(|| items.par_iter().map(&ask).collect()))
}

/// As [`map`], but each answer may lean on the one before it in its run of 64 items, which the caller has put next to
/// each other for that. The answer must not depend on it.
pub(super) fn map_along<T: Sync, R: Send>(
    items: &[T],
    exec: &Exec<'_>,
    ask: impl Fn(&T, Option<&R>) -> R + Sync + Send,
) -> Result<Vec<R>, Cancelled> {
    let runs: Vec<&[T]> = items.chunks(64).collect();
    let answers = map(&runs, exec, |run| {
        let mut answers: Vec<R> = Vec::with_capacity(run.len());
        for item in *run {
            answers.push(ask(item, answers.last()));
        }
        answers
    })?;
    Ok(answers.into_iter().flatten().collect())
}
