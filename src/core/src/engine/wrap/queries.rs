//! Questions to a tree, many at once: watched, and bounded where faces are as long as the model.

use crate::engine::error::Error;
use crate::exec::Exec;
use crate::mesh::query::TriangleBvh;
use rayon::prelude::*;

/// Questions between two looks at whether the work is still wanted.
const BLOCK: usize = 1 << 14;
/// What questions may look at beside [`VISITS_PER_QUESTION`]: about a second.
const LEAST_VISITS: u64 = 1 << 28;
const VISITS_PER_QUESTION: u64 = 4096;

/// The answers to questions numbered from 0.
///
/// # Errors
/// [`Error::Precondition`] where they look at too much, [`Error::Cancelled`].
pub(in crate::engine) fn answers<T: Send>(
    tree: &TriangleBvh<'_>,
    count: usize,
    exec: &Exec<'_>,
    answer: impl Fn(usize) -> T + Sync,
) -> Result<Vec<T>, Error> {
    let limit = tree.visits.total() + LEAST_VISITS + VISITS_PER_QUESTION * count as u64;
    let mut all = Vec::with_capacity(count);
    for first in (0..count).step_by(BLOCK) {
        exec.check()?;
        if tree.visits.total() > limit {
            let problem = "wrapping looks at too much, because faces are as long as the model; remesh both models to give them \
                           faces of about one size";
            return Err(Error::Precondition(problem.into()));
        }
        let block = first..(first + BLOCK).min(count);
        let found: Vec<T> = (exec.pool).install(|| block.into_par_iter().with_min_len(64).map(&answer).collect());
        all.extend(found);
    }
    Ok(all)
}
