//! The list of commits, in shared pieces: each change of the session publishes its history, and must not copy ten
//! thousand commits for one.

use crate::session::answers::CommitFacts;
use std::collections::VecDeque;
use std::sync::Arc;

/// Commits of one piece.
const PIECE: usize = 128;

/// A list that grows and shrinks at its end and loses its beginning. A clone shares all pieces; a change copies one at most.
#[derive(Debug, Clone, Default)]
pub(in crate::session) struct CommitList {
    pieces: VecDeque<Arc<Vec<CommitFacts>>>,
    /// How many of the first piece are gone.
    gone: usize,
    length: usize,
}

impl CommitList {
    /// The commits, oldest first.
    pub fn iter(&self) -> impl Iterator<Item = &CommitFacts> {
        self.pieces.iter().flat_map(|piece| piece.iter()).skip(self.gone)
    }

    pub(super) fn push(&mut self, commit: CommitFacts) {
        match self.pieces.back_mut().filter(|piece| piece.len() < PIECE) {
            Some(piece) => Arc::make_mut(piece).push(commit),
            None => self.pieces.push_back(Arc::new(vec![commit])),
        }
        self.length += 1;
    }

    /// Forgets the newest commits until so many are left.
    pub(super) fn truncate(&mut self, length: usize) {
        while self.length > length {
            let Some(piece) = self.pieces.back_mut() else { return };
            let kept = piece.len() - (self.length - length).min(piece.len());
            self.length -= piece.len() - kept;
            if kept == 0 {
                self.pieces.pop_back();
            } else {
                Arc::make_mut(piece).truncate(kept);
            }
        }
    }

    /// Replaces the digest of the commit at `index`.
    pub(super) fn set_digest(&mut self, index: usize, digest: &str) {
        let mut at = index + self.gone;
        for piece in &mut self.pieces {
            if at < piece.len() {
                digest.clone_into(&mut Arc::make_mut(piece)[at].digest);
                return;
            }
            at -= piece.len();
        }
    }

    /// Forgets the oldest commit.
    pub(super) fn forget_first(&mut self) {
        let Some(first) = self.pieces.front() else { return };
        self.gone += 1;
        self.length -= 1;
        if self.gone == first.len() {
            self.pieces.pop_front();
            self.gone = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn commit(revision: u64) -> CommitFacts {
        CommitFacts {
            revision,
            kind: "pose",
            digest: revision.to_string(),
        }
    }

    proptest! {
        /// Against a plain list.
        #[test]
        fn it_is_a_list(steps in prop::collection::vec((0u8..4, 1usize..400), 0..40)) {
            let (mut list, mut plain) = (CommitList::default(), VecDeque::<CommitFacts>::new());
            let mut revision = 0;
            for (kind, count) in steps {
                match kind {
                    0 => for _ in 0..count {
                        revision += 1;
                        list.push(commit(revision));
                        plain.push_back(commit(revision));
                    },
                    1 => {
                        let kept = plain.len().saturating_sub(count);
                        // The first commit of a history is never undone.
                        let kept = kept.max(plain.len().min(1));
                        list.truncate(kept);
                        plain.truncate(kept);
                    }
                    2 => if !plain.is_empty() {
                        let at = count % plain.len();
                        list.set_digest(at, "other");
                        plain[at].digest = "other".into();
                    },
                    _ => for _ in 0..count.min(plain.len()) {
                        list.forget_first();
                        plain.pop_front();
                    },
                }
                prop_assert!(list.iter().eq(plain.iter()), "{} and {}", list.length, plain.len());
            }
        }
    }

    #[test]
    fn what_was_shown_stays_and_nearly_all_of_it_is_shared() {
        let mut list = CommitList::default();
        (0..10_000).for_each(|k| list.push(commit(k)));
        let shown = list.clone();
        list.push(commit(10_000));
        list.forget_first();
        let same = shown
            .pieces
            .iter()
            .zip(&list.pieces)
            .filter(|(a, b)| Arc::ptr_eq(a, b))
            .count();
        assert!(same + 1 >= shown.pieces.len(), "{same} of {}", shown.pieces.len());
        assert!(shown.iter().map(|c| c.revision).eq(0..10_000));
        assert!(list.iter().map(|c| c.revision).eq(1..=10_000));
    }
}
