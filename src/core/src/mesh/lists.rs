//! Lists of numbers, one list per row, stored back to back (compressed rows).

/// One list of `u32` per row; rows are counted from 0.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Lists {
    offsets: Vec<u32>,
    items: Vec<u32>,
}

impl Lists {
    /// Gathers `(row, item)` pairs: each row gets its items in the order in which `pairs` yields them. `pairs` is
    /// called twice and must yield the same both times.
    ///
    /// # Panics
    /// When a row is not below `rows`, or there are more than `u32::MAX` pairs.
    pub fn gather<I: Iterator<Item = (u32, u32)>>(rows: usize, pairs: impl Fn() -> I) -> Self {
        let mut offsets = vec![0u32; rows + 1];
        let mut total = 0u64;
        for (row, _) in pairs() {
            offsets[row as usize + 1] += 1;
            total += 1;
        }
        assert!(
            total <= u64::from(u32::MAX),
            "{total} list entries cannot be numbered with 32 bits"
        );
        for row in 0..rows {
            offsets[row + 1] += offsets[row];
        }
        let mut next = offsets.clone();
        let mut items = vec![0u32; total as usize];
        for (row, item) in pairs() {
            let slot = &mut next[row as usize];
            items[*slot as usize] = item;
            *slot += 1;
        }
        Self { offsets, items }
    }

    /// Takes rows that are already laid out: row `i` is `items[offsets[i]..offsets[i + 1]]`.
    ///
    /// # Panics
    /// When `offsets` is empty, does not start at 0, falls, or does not end at the number of items.
    pub fn from_parts(offsets: Vec<u32>, items: Vec<u32>) -> Self {
        assert!(
            offsets.first() == Some(&0) && offsets.windows(2).all(|w| w[0] <= w[1]),
            "offsets rise from 0"
        );
        assert_eq!(
            offsets.last().map(|&o| o as usize),
            Some(items.len()),
            "offsets end at the items"
        );
        Self { offsets, items }
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.offsets.len().saturating_sub(1)
    }

    /// The list of `row`.
    ///
    /// # Panics
    /// When `row` is out of range.
    pub fn of(&self, row: u32) -> &[u32] {
        &self.items[self.offsets[row as usize] as usize..self.offsets[row as usize + 1] as usize]
    }

    /// Where each row starts, and one past the end of the last.
    pub fn offsets(&self) -> &[u32] {
        &self.offsets
    }

    /// All items, row after row.
    pub fn items(&self) -> &[u32] {
        &self.items
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        (self.offsets.capacity() + self.items.capacity()) * size_of::<u32>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_keep_the_order_of_the_pairs() {
        let pairs = [(2, 7), (0, 1), (2, 5), (2, 9)];
        let lists = Lists::gather(4, || pairs.into_iter());
        let rows: Vec<&[u32]> = (0..4).map(|r| lists.of(r)).collect();
        assert_eq!(rows, [&[1][..], &[], &[7, 5, 9], &[]]);
        assert_eq!(
            Lists::from_parts(lists.offsets().to_vec(), lists.items().to_vec()),
            lists
        );
    }
}
