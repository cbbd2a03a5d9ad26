//! A set of numbers with ranks.

/// A set of numbers below a bound. Once complete, it knows how many of its numbers lie below each.
#[derive(Debug, Clone)]
pub(super) struct MarkedRows {
    words: Vec<u64>,
    /// Numbers in the words before each.
    ranks: Vec<u32>,
}

impl MarkedRows {
    pub(super) fn new(bound: usize) -> MarkedRows {
        MarkedRows {
            words: vec![0; bound.div_ceil(64)],
            ranks: Vec::new(),
        }
    }

    /// Adds `i`, which is below the bound; false if it was there.
    #[inline]
    pub(super) fn insert(&mut self, i: u32) -> bool {
        let (word, bit) = (&mut self.words[i as usize / 64], 1 << (i % 64));
        let fresh = *word & bit == 0;
        *word |= bit;
        fresh
    }

    pub(super) fn remove(&mut self, i: u32) {
        self.words[i as usize / 64] &= !(1 << (i % 64));
    }

    /// Its numbers, rising.
    pub(super) fn iter(&self) -> impl Iterator<Item = u32> + '_ {
        let of_word = |(k, &word): (u32, &u64)| {
            let next = |w: &u64| Some(w & (w - 1)).filter(|w| *w != 0);
            let words = std::iter::successors(Some(word).filter(|w| *w != 0), next);
            words.map(move |w| 64 * k + w.trailing_zeros())
        };
        (0..).zip(&self.words).flat_map(of_word)
    }

    #[inline]
    pub(super) fn contains(&self, i: u32) -> bool {
        self.words[i as usize / 64] >> (i % 64) & 1 == 1
    }

    /// Counts; [`MarkedRows::rank`] answers for what is in the set now. Returns the size.
    pub(super) fn count(&mut self) -> usize {
        let mut total = 0;
        self.ranks.clear();
        for word in &self.words {
            self.ranks.push(total);
            total += word.count_ones();
        }
        total as usize
    }

    /// How many numbers lie below `i`.
    #[inline]
    pub(super) fn rank(&self, i: u32) -> usize {
        let (word, below) = (i as usize / 64, (1u64 << (i % 64)) - 1);
        (self.ranks[word] + (self.words[word] & below).count_ones()) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranks_count_what_is_below() {
        let mut marks = MarkedRows::new(200);
        for i in [3, 64, 65, 199, 0] {
            assert!(marks.insert(i));
        }
        assert!(!marks.insert(64));
        assert_eq!(marks.count(), 5);
        for (rank, i) in [0, 3, 64, 65, 199].into_iter().enumerate() {
            assert!(marks.contains(i));
            assert_eq!(marks.rank(i), rank);
        }
        assert!(marks.iter().eq([0, 3, 64, 65, 199]));
        marks.remove(64);
        assert!(marks.iter().eq([0, 3, 65, 199]));
        marks.insert(64);
        assert!(!marks.contains(1) && !marks.contains(198));
        assert_eq!(marks.rank(198), 4);
    }
}
