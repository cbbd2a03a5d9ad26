//! Free components that nothing holds: no fixed vertex, no stiffness.
//!
//! Their equations determine the unknowns up to one constant per column, and have a solution only if the right-hand
//! sides sum to zero. The solver solves the projected equations and leaves the mean of the start as it is.

use crate::build::hierarchy::Hierarchy;
use crate::constrain::mask::LevelMask;
use crate::lanes::{Lanes, WIDTH, WideLanes, add_wide};

/// The rows of the finest level that belong to floating components.
#[derive(Debug, Default)]
pub(crate) struct FloatingComponents {
    rows: Vec<u32>,
    /// End of each component in `rows`.
    ends: Vec<u32>,
}

impl FloatingComponents {
    /// Looks at the top of the hierarchy, where each component has shrunk to a few rows, and only expands those found.
    pub(crate) fn find(
        hierarchy: &Hierarchy,
        (masks, stiffness, dense_rows): (&[LevelMask], &[f64], &[u32]),
    ) -> FloatingComponents {
        let mut floating = FloatingComponents::default();
        let last = masks.len() - 1;
        let finest = &hierarchy.levels[0];
        for row in 0..finest.rows() {
            let alone = !finest.connected(row);
            if last > 0 && alone && masks[0].free(row) && stiffness.get(row).is_none_or(|s| *s == 0.0) {
                floating.add(hierarchy, 0, vec![row as u32]);
            }
        }
        for l in 1..=last {
            let (level, mask, below) = (&hierarchy.levels[l], &masks[l], &masks[l - 1]);
            for row in 0..level.rows() {
                let alone = !level.connected(row);
                let members = hierarchy.levels[l - 1].members_of(row);
                if alone && !mask.free(row) && members.iter().any(|&i| below.free(i as usize)) {
                    floating.add(hierarchy, l, vec![row as u32]);
                }
            }
        }
        let (level, mask) = (&hierarchy.levels[last], &masks[last]);
        let mut seen = vec![false; level.rows()];
        for root in dense_rows.iter().copied() {
            if std::mem::replace(&mut seen[root as usize], true) {
                continue;
            }
            let mut part = vec![root];
            let mut held = false;
            let mut head = 0;
            while head < part.len() {
                let i = part[head] as usize;
                head += 1;
                held |= mask.alpha(i) > 0.0 || (last == 0 && stiffness.get(i).is_some_and(|s| *s > 0.0));
                for (j, _) in level.row(i) {
                    if !mask.free(j) {
                        held = true;
                    } else if !std::mem::replace(&mut seen[j], true) {
                        part.push(j as u32);
                    }
                }
            }
            if !held {
                floating.add(hierarchy, last, part);
            }
        }
        floating
    }

    /// Adds the component that `rows` of level `l` stand for.
    fn add(&mut self, hierarchy: &Hierarchy, l: usize, mut rows: Vec<u32>) {
        for level in hierarchy.levels[..l].iter().rev() {
            rows = rows
                .iter()
                .flat_map(|&row| level.members_of(row as usize))
                .copied()
                .collect();
        }
        rows.sort_unstable();
        self.rows.extend(rows);
        self.ends.push(self.rows.len() as u32);
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    pub(crate) fn byte_size(&self) -> usize {
        4 * (self.rows.len() + self.ends.len())
    }

    fn components(&self) -> impl Iterator<Item = &[u32]> {
        let begins = std::iter::once(0).chain(self.ends.iter().copied());
        begins
            .zip(&self.ends)
            .map(|(begin, &end)| &self.rows[begin as usize..end as usize])
    }

    /// How much the squared norm of `v` shrinks when the means are taken out.
    pub(crate) fn mean_norms(&self, v: impl Fn(usize) -> WideLanes) -> WideLanes {
        let mut norms = [0.0; WIDTH];
        for rows in self.components() {
            let mut sum = [0.0; WIDTH];
            for &i in rows {
                add_wide(&mut sum, v(i as usize));
            }
            for c in 0..WIDTH {
                norms[c] += sum[c] * sum[c] / rows.len() as f64;
            }
        }
        norms
    }

    /// Takes the mean over each component out of `v`.
    pub(crate) fn remove_means(&self, v: &mut [Lanes]) {
        for rows in self.components() {
            let mut sum = [0.0; WIDTH];
            for &i in rows {
                add_wide(&mut sum, v[i as usize].wide());
            }
            let mean = Lanes::from_wide(sum.map(|s| s / rows.len() as f64));
            for &i in rows {
                v[i as usize] -= mean;
            }
        }
    }

    /// The same in double precision.
    pub(crate) fn remove_wide_means(&self, v: &mut [WideLanes]) {
        for rows in self.components() {
            let mut sum = [0.0; WIDTH];
            for &i in rows {
                add_wide(&mut sum, v[i as usize]);
            }
            let mean = sum.map(|s| s / rows.len() as f64);
            for &i in rows {
                for c in 0..WIDTH {
                    v[i as usize][c] -= mean[c];
                }
            }
        }
    }
}
