//! Constraints on a hierarchy: which rows of each level are solved for, and with which diagonal.

use std::sync::Arc;

use crate::build::hierarchy::Hierarchy;
use crate::build::level::HierarchyLevel;
use crate::constrain::mask::FloatingComponents;
use crate::constrain::mask::{LevelMask, mask_coarser_level};
use crate::dense_inverse::DenseInverse;
use crate::error::Error;
use crate::lanes::NO_ROW;
use crate::options::{Constraints, LevelSize};
use crate::paper::hierarchy::PaperHierarchy;
use crate::threads::Parallelism;
use pliant_exec::pool::Pool;

/// Up to this many free vertices are solved directly.
const DIRECT: usize = 200;

/// Largest stiffness in units of the heaviest edge.
const STIFFEST: f64 = 1e12;

/// Rows that one piece of work handles.
const PIECE: usize = 4096;

/// A hierarchy under one set of constraints, ready to solve for any right-hand side.
///
/// It refers to its hierarchy by identity and borrows nothing; pass the hierarchy to every call.
#[derive(Debug)]
pub struct LinearSystem {
    token: Arc<()>,
    free: usize,
    /// One per level; only the finest where the direct method applies.
    pub(crate) masks: Vec<LevelMask>,
    /// Scaled stiffness in row order, or empty.
    pub(crate) stiffness: Vec<f64>,
    /// Fixed vertices, in the caller's order, one bit each.
    fixed: Vec<u64>,
    /// Rows of the last level that `inverse` covers.
    pub(crate) dense_rows: Vec<u32>,
    pub(crate) inverse: DenseInverse,
    /// How many cycles each level runs for one of the level above it: 1 or 2.
    pub(crate) cycles_per_visit: Vec<u8>,
    /// Whether the finest level is swept forth and back on either side of the coarse correction, not just once.
    pub(crate) twice: bool,
    pub(crate) floating: FloatingComponents,
    /// With the paper's operators: its own levels.
    pub(crate) paper: Option<PaperHierarchy>,
}

impl Hierarchy {
    /// Prepares solving under `constraints`: masks, diagonals and the coarsest factor of every level. Much cheaper
    /// than building; the topology of the hierarchy stays as it is.
    ///
    /// ```
    /// # use pliant_exec::{Exec, pool::Pool, progress::Silent};
    /// # use pliant_solver::{BuildOptions, Constraints, Hierarchy, WeightedGraph};
    /// # let pool = Pool::new(1)?;
    /// # let exec = Exec::new(&pool, &Silent);
    /// # let chain = WeightedGraph { offsets: &[0, 1, 3, 5, 7, 8], neighbours: &[1, 0, 2, 1, 3, 2, 4, 3], weights: None, positions: None };
    /// let hierarchy = Hierarchy::build(&chain, &BuildOptions::default(), &exec)?;
    /// let ends = Constraints { fixed: &[true, false, false, false, true], stiffness: None };
    /// let system = hierarchy.constrain(&ends, &pool)?;
    /// assert_eq!(system.free_count(), 3);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    ///
    /// # Errors
    /// [`Error::Invalid`] if the lengths do not fit the graph or a stiffness is negative, not finite or larger than
    /// 1e12 times the heaviest edge (a harder one is a fixed vertex).
    pub fn constrain(&self, constraints: &Constraints<'_>, pool: &Pool) -> Result<LinearSystem, Error> {
        LinearSystem::new(self, constraints, pool)
    }
}

impl LinearSystem {
    pub(crate) fn new(
        hierarchy: &Hierarchy,
        constraints: &Constraints<'_>,
        pool: &Pool,
    ) -> Result<LinearSystem, Error> {
        let threads = Parallelism::from_pool(pool);
        check(hierarchy, constraints)?;
        let scale = hierarchy.weight_scale;
        let stiffness: Vec<f64> = match constraints.stiffness {
            Some(s) if s.iter().any(|v| *v != 0.0) => hierarchy
                .order
                .iter()
                .map(|&v| {
                    if v == NO_ROW || constraints.fixed[v as usize] {
                        0.0
                    } else {
                        s[v as usize] * scale
                    }
                })
                .collect(),
            _ => Vec::new(),
        };
        let free = constraints.fixed.iter().filter(|f| !**f).count();
        let mut system = LinearSystem {
            token: hierarchy.token.clone(),
            free,
            masks: Vec::with_capacity(hierarchy.levels.len()),
            stiffness,
            fixed: pack_flags(constraints.fixed),
            dense_rows: Vec::new(),
            inverse: DenseInverse::default(),
            cycles_per_visit: Vec::new(),
            twice: hierarchy.thin,
            floating: FloatingComponents::default(),
            paper: None,
        };
        threads.run_on(pool, || {
            system.mask_finest(hierarchy, constraints.fixed, threads);
            if free > DIRECT {
                for l in 1..hierarchy.levels.len() {
                    let mask = mask_coarser_level(
                        &hierarchy.levels[l - 1],
                        &hierarchy.levels[l],
                        &system.masks[l - 1],
                        threads,
                    );
                    system.masks.push(mask);
                }
            }
            system.factor_coarsest(hierarchy);
            system.floating = FloatingComponents::find(hierarchy, &system.masks, &system.stiffness, &system.dense_rows);
        });
        system.cycles_per_visit = steps(hierarchy);
        if let (Some(uncut), false) = (&hierarchy.paper, system.is_direct()) {
            let paper = PaperHierarchy::build(uncut, hierarchy, constraints.fixed, &system.stiffness);
            system.paper = Some(paper);
        }
        Ok(system)
    }

    /// Number of free vertices.
    pub fn free_count(&self) -> usize {
        self.free
    }

    /// Sizes of the levels over free vertices, finest first, where constraints have a hierarchy of their own: with
    /// [`CoarseOperators::Paper`](crate::CoarseOperators::Paper) and more free vertices than are solved directly.
    pub fn level_sizes(&self) -> Option<Vec<LevelSize>> {
        self.paper.as_ref().map(PaperHierarchy::level_sizes)
    }

    /// Bytes held, without the hierarchy's.
    pub fn byte_size(&self) -> usize {
        let masks: usize = self.masks.iter().map(LevelMask::byte_size).sum();
        let paper = self.paper.as_ref().map_or(0, PaperHierarchy::byte_size);
        let vectors = 8 * (self.stiffness.len() + self.fixed.len());
        masks + vectors + self.inverse.byte_size() + self.floating.byte_size() + paper
    }

    /// True if the dense inverse covers the finest level itself.
    pub(crate) fn is_direct(&self) -> bool {
        self.masks.len() == 1
    }

    /// Makes sure that `hierarchy` is the one this system was made for.
    pub(crate) fn check_hierarchy(&self, hierarchy: &Hierarchy) -> Result<(), Error> {
        if Arc::ptr_eq(&self.token, &hierarchy.token) {
            Ok(())
        } else {
            Err(Error::Invalid("the system was made for another hierarchy".into()))
        }
    }

    #[inline(always)]
    pub(crate) fn is_fixed(&self, vertex: usize) -> bool {
        self.fixed[vertex >> 6] >> (vertex & 63) & 1 == 1
    }

    fn mask_finest(&mut self, hierarchy: &Hierarchy, fixed: &[bool], threads: Parallelism) {
        let level = &hierarchy.levels[0];
        let mut mask = LevelMask {
            inverses: vec![0.0; level.rows()],
            ..LevelMask::default()
        };
        mask.alphas = self.stiffness.iter().map(|&s| s as f32).collect();
        let alphas = &mask.alphas;
        let threads_of_level = threads.for_rows(level.rows());
        threads_of_level.for_each_piece(PIECE, mask.inverses.as_mut_slice(), |first, inverses| {
            for (i, out) in (first..).zip(inverses) {
                let vertex = hierarchy.order[i];
                if vertex != NO_ROW && !fixed[vertex as usize] {
                    let diagonal = level.diagonal[i] + alphas.get(i).copied().unwrap_or(0.0);
                    // A free vertex that touches nothing has diagonal 0. It stays free; see `floating`.
                    *out = if diagonal > 0.0 { 1.0 / diagonal } else { 1.0 };
                }
            }
        });
        mask.list_active(level, threads);
        mask.find_border(level, threads);
        self.masks.push(mask);
    }

    /// Factors the last level that has a mask: the coarsest one, or the finest one if that is small enough.
    fn factor_coarsest(&mut self, hierarchy: &Hierarchy) {
        let last = self.masks.len() - 1;
        let (level, mask) = (&hierarchy.levels[last], &self.masks[last]);
        let rows: Vec<u32> = (0..level.rows() as u32).filter(|&i| mask.free(i as usize)).collect();
        let n = rows.len();
        let mut matrix = vec![0.0; n * n];
        for (a, &i) in rows.iter().enumerate() {
            let stiffness = if last == 0 {
                self.stiffness.get(i as usize).copied().unwrap_or(0.0)
            } else {
                f64::from(mask.alpha(i as usize))
            };
            let mut diagonal = stiffness;
            for (j, w) in level.row(i as usize) {
                let w = f64::from(w);
                diagonal += w;
                if let Ok(b) = rows.binary_search(&(j as u32)) {
                    matrix[a * n + b] -= w;
                }
            }
            matrix[a * n + a] = if diagonal > 0.0 { diagonal } else { 1.0 };
        }
        self.inverse = DenseInverse::new(matrix, n);
        self.dense_rows = rows;
    }
}

/// One bit per flag.
fn pack_flags(flags: &[bool]) -> Vec<u64> {
    let word = |flags: &[bool]| flags.iter().enumerate().fold(0, |w, (k, &f)| w | u64::from(f) << k);
    flags.chunks(64).map(word).collect()
}

fn check(hierarchy: &Hierarchy, constraints: &Constraints<'_>) -> Result<(), Error> {
    let n = hierarchy.vertices();
    if constraints.fixed.len() != n {
        let seen = constraints.fixed.len();
        return Err(Error::Invalid(format!("{seen} constraint flags for {n} vertices")));
    }
    let Some(stiffness) = constraints.stiffness else {
        return Ok(());
    };
    if stiffness.len() != n {
        return Err(Error::Invalid(format!(
            "{} stiffness values for {n} vertices",
            stiffness.len()
        )));
    }
    let most = STIFFEST / hierarchy.weight_scale;
    if let Some(i) = stiffness.iter().position(|s| !(*s >= 0.0 && *s <= most)) {
        return Err(Error::Invalid(format!(
            "the stiffness of vertex {i} is {}, allowed are 0 to {most:e} (hold the vertex fixed instead)",
            stiffness[i]
        )));
    }
    Ok(())
}

/// Two cycles per visit (the K-cycle) wherever all cycles of the level together stay cheaper than the finest level.
fn steps(hierarchy: &Hierarchy) -> Vec<u8> {
    const SHARE: f64 = 0.6;
    let work = |l: &HierarchyLevel| (l.rows() + l.entries) as f64;
    let budget = SHARE * work(&hierarchy.levels[0]).max(1e6);
    let mut cycles = 1.0;
    let mut steps = vec![1];
    for pair in hierarchy.levels[1..].windows(2) {
        // The level below is visited once per cycle; count it, the coarsest one with its dense inverse.
        let below = if pair[1].aggregates.is_empty() {
            (pair[1].rows() as f64).powi(2)
        } else {
            0.0
        };
        let two = 2.0 * cycles * (work(&pair[0]) + below) <= budget;
        steps.push(if two { 2 } else { 1 });
        cycles *= if two { 2.0 } else { 1.0 };
    }
    steps.push(1);
    debug_assert!(hierarchy.levels.iter().all(|l| {
        l.aggregates
            .iter()
            .all(|&a| a == NO_ROW || (a as usize) < l.coarse_rows())
    }));
    steps
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{BoxLattice, pool};

    #[test]
    fn masks_follow_their_members() {
        // A third of it along each side still has too many free rows to be solved directly.
        let block = BoxLattice::new(21, 20, 19).weighted();
        let hierarchy = block.hierarchy(30);
        let end = if cfg!(miri) { 2.0 } else { 4.0 };
        let fixed: Vec<bool> = block.positions.iter().map(|p| p[0] < end).collect();
        let stiffness: Vec<f64> = block
            .positions
            .iter()
            .map(|p| f64::from(u8::from(p[0] > 9.0)))
            .collect();
        let constraints = Constraints {
            fixed: &fixed,
            stiffness: Some(&stiffness),
        };
        let system = hierarchy.constrain(&constraints, &pool()).unwrap();
        assert_eq!(system.free_count(), fixed.iter().filter(|f| !**f).count());
        let (mut masked, mut mixed) = (0, 0);
        for (row, &vertex) in hierarchy.order.iter().enumerate() {
            let free = vertex != NO_ROW && !fixed[vertex as usize];
            assert_eq!(system.masks[0].free(row), free);
        }
        for l in 1..hierarchy.levels.len() {
            let (fine, coarse) = (&hierarchy.levels[l - 1], &hierarchy.levels[l]);
            let (above, mask) = (&system.masks[l - 1], &system.masks[l]);
            for row in 0..coarse.rows() {
                let members = fine.members_of(row);
                let free: Vec<usize> = members.iter().map(|&i| i as usize).filter(|&i| above.free(i)).collect();
                assert_eq!(mask.free(row), !free.is_empty());
                masked += usize::from(free.is_empty());
                mixed += usize::from(!free.is_empty() && free.len() < members.len());
                let mut alpha = 0.0;
                for &i in &free {
                    alpha += above.alpha(i);
                    for (j, w) in fine.row(i).filter(|&(j, _)| !above.free(j)) {
                        let inside = members.contains(&(j as u32));
                        let partial = mask.free(fine.aggregates[j] as usize);
                        alpha += if inside { w } else { w * if partial { 0.6 } else { 0.0 } };
                    }
                }
                assert!((alpha - mask.alpha(row)).abs() <= 1e-5 * alpha, "level {l} row {row}");
                if mask.free(row) {
                    let diagonal = coarse.diagonal[row] + mask.alpha(row);
                    assert!((mask.inverses[row] * diagonal - 1.0).abs() < 1e-5);
                }
            }
        }
        assert!(cfg!(miri) || masked > 0 && mixed > 0, "the test meets both kinds");
        // The border, found from the other side.
        let level = &hierarchy.levels[0];
        for row in 0..level.rows() {
            let touches = level.row(row).any(|(j, _)| !system.masks[0].free(j));
            assert_eq!(system.masks[0].on_border(row), system.masks[0].free(row) && touches);
        }
    }

    #[test]
    #[cfg_attr(miri, ignore = "counts work on a graph that is too large for it")]
    fn cycles_stay_within_their_budget() {
        let hierarchy = BoxLattice::new(40, 40, 24).hierarchy(20);
        let steps = steps(&hierarchy);
        assert_eq!(steps.len(), hierarchy.levels.len());
        assert!(steps.contains(&2), "coarse levels run twice: {steps:?}");
        let mut cycles = 1.0;
        for (level, steps) in hierarchy.levels.iter().zip(&steps) {
            cycles *= f64::from(*steps);
            assert!(cycles * (level.neighbours.len() as f64) <= hierarchy.levels[0].neighbours.len() as f64);
        }
    }
}
