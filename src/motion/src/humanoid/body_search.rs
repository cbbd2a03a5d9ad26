//! A body of cells that stands upright and faces along z: its rows, its plane of symmetry, and where its legs part.

use super::body_lattice::BodyLattice;
use glam::DVec3;
use std::collections::BTreeMap;

/// The gap between legs over their depth: of legs apart, and of legs that touch.
const CLEAR: f64 = 0.25;
const THIN: f64 = 0.6;
/// Where a person's legs part, over the height.
pub(super) const PERSON: f64 = 0.46;
/// How high legs part at least, over the height.
const LEAST_LEG: f64 = 0.1;
/// Heights from where legs are followed, over the whole: feet may touch.
const STARTS: [f64; 5] = [0.01, 0.05, 0.09, 0.13, 0.18];
/// Rows of one part of a row, of a leg, over those of the smallest leg that counts.
const LEAST_SHARE: f64 = 0.15;

/// How legs were separated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum LegGap {
    /// Nothing is between them.
    Open,
    /// They touch, and are thin where they do.
    Thin,
    /// Nothing parts them.
    Missing,
}

/// The legs of a body.
pub(super) struct Legs {
    /// How high they part, as a share of the height.
    pub(super) crotch: f64,
    /// How they part.
    pub(super) gap: LegGap,
    /// How many limbs carry the body.
    pub(super) feet: usize,
    /// By cell: 1 in the left leg, -1 in the right one, otherwise 0.
    pub(super) side_of: Vec<i8>,
}

/// A body of cells, its extents and rows.
pub(super) struct BodySearch {
    pub(super) lattice: BodyLattice,
    pub(super) low: DVec3,
    pub(super) extent: DVec3,
    /// x of the plane between left and right.
    pub(super) middle: f64,
    /// The share of cells that the plane mirrors to cells.
    pub(super) symmetry: f64,
    /// Cells by their height.
    pub(super) rows: Vec<Vec<usize>>,
}

/// A part of a row that hangs together.
struct RowPart {
    row: usize,
    cells: Vec<usize>,
}

/// Parts of rows that are one above the other.
struct Limb {
    start: usize,
    cells: Vec<usize>,
}

/// Limbs that come together in one part of a row.
struct Meeting {
    row: usize,
    limbs: Vec<Vec<usize>>,
}

impl BodySearch {
    pub(super) fn of_lattice(lattice: BodyLattice) -> Self {
        let low = lattice.places.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = lattice.places.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        let mut rows = vec![Vec::new(); lattice.height()];
        for (cell, p) in lattice.places.iter().enumerate() {
            rows[lattice.coordinates(*p)[1]].push(cell);
        }
        let (middle, symmetry) = plane_of_symmetry(&lattice);
        Self {
            low,
            extent: high - low,
            middle,
            symmetry,
            rows,
            lattice,
        }
    }

    pub(super) fn row_at(&self, share: f64) -> usize {
        ((self.rows.len() - 1) as f64 * share.clamp(0.0, 1.0)).round() as usize
    }

    pub(super) fn height_at(&self, share: f64) -> f64 {
        self.low.y + self.extent.y * share
    }

    pub(super) fn share_of(&self, y: f64) -> f64 {
        (y - self.low.y) / self.extent.y.max(f64::MIN_POSITIVE)
    }

    /// Where the plane of symmetry takes a point.
    pub(super) fn mirrored(&self, p: DVec3) -> DVec3 {
        DVec3::new(2.0 * self.middle - p.x, p.y, p.z)
    }

    /// The middle of the cells of a row that fit.
    pub(super) fn middle_of_row(&self, share: f64, fits: impl Fn(usize) -> bool) -> Option<DVec3> {
        let row = self.rows[self.row_at(share)].iter().filter(|cell| fits(**cell));
        let own: Vec<DVec3> = row.map(|cell| self.lattice.places[*cell]).collect();
        let x = median(own.iter().map(|p| p.x).collect());
        let z = median(own.iter().map(|p| p.z).collect());
        (!own.is_empty()).then(|| DVec3::new(x, self.height_at(share), z))
    }

    /// Whether a row has a gap between left and right.
    fn has_gap(&self, row: usize, thin: f64) -> bool {
        let mut columns: BTreeMap<usize, usize> = BTreeMap::new();
        for cell in &self.rows[row] {
            let column = self.lattice.coordinates(self.lattice.places[*cell])[0];
            *columns.entry(column).or_default() += 1;
        }
        let (Some(first), Some(last)) = (columns.keys().next(), columns.keys().next_back()) else {
            return false;
        };
        let most = columns.values().max().copied().unwrap_or(0);
        let middle = self.lattice.coordinates(DVec3::new(self.middle, 0.0, 0.0))[0];
        let near = (last - first) / 6 + 1;
        let mut center = middle.saturating_sub(near).max(first + 1)..(middle + near + 1).min(*last);
        center.any(|x| (columns.get(&x).copied().unwrap_or(0) as f64) <= thin * most as f64)
    }

    /// Up to where a gap goes, as a share of the height.
    fn height_of_gap(&self, thin: f64) -> f64 {
        let (mut top, mut missed) = (0, 0);
        for row in self.row_at(0.03)..self.row_at(0.7) {
            if self.has_gap(row, thin) {
                (top, missed) = (row, 0);
            } else {
                missed += 1;
            }
            if missed > 3 && row > self.row_at(0.15) {
                break;
            }
        }
        top as f64 / (self.rows.len() - 1).max(1) as f64
    }

    /// The parts of all rows, lowest first, and by cell the part that it is in.
    fn row_parts(&self) -> (Vec<RowPart>, Vec<usize>) {
        let mut part_of = vec![usize::MAX; self.lattice.places.len()];
        let mut parts: Vec<RowPart> = Vec::new();
        for (row, cells) in self.rows.iter().enumerate() {
            for &seed in cells {
                if part_of[seed] != usize::MAX {
                    continue;
                }
                let mut own = vec![seed];
                part_of[seed] = parts.len();
                let mut next = 0;
                while let Some(&at) = own.get(next) {
                    next += 1;
                    for beside in self.cells_of_row_around(at, 0) {
                        if part_of[beside] == usize::MAX {
                            part_of[beside] = parts.len();
                            own.push(beside);
                        }
                    }
                }
                parts.push(RowPart { row, cells: own });
            }
        }
        (parts, part_of)
    }

    /// Cells around the place of one, so many rows above it.
    fn cells_of_row_around(&self, cell: usize, above: i64) -> impl Iterator<Item = usize> + '_ {
        let [x, y, z] = self.lattice.coordinates(self.lattice.places[cell]).map(|n| n as i64);
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dz| [dx, dz]));
        around.filter_map(move |[dx, dz]| self.lattice.cell_at([x + dx, y + above, z + dz]))
    }

    /// Follows the limbs of a row upwards until two or more of them meet.
    fn meeting_above(&self, parts: &[RowPart], part_of: &[usize], start: usize) -> Option<Meeting> {
        let least = (LEAST_LEG * self.rows.len() as f64).ceil() as usize;
        let mut limbs: Vec<Limb> = Vec::new();
        let mut limb_of = vec![usize::MAX; parts.len()];
        let from = parts.partition_point(|part| part.row < start);
        for (number, part) in parts.iter().enumerate().skip(from) {
            if part.row > self.row_at(0.75) {
                return None;
            }
            let mut below: Vec<usize> = part
                .cells
                .iter()
                .flat_map(|cell| self.cells_of_row_around(*cell, -1))
                .map(|cell| limb_of[part_of[cell]])
                .filter(|limb| *limb != usize::MAX)
                .collect();
            below.sort_unstable();
            below.dedup();
            let stands = |limb: &&usize| {
                let limb = &limbs[**limb];
                limb.start <= start + 1 && part.row - limb.start >= least
            };
            let standing: Vec<usize> = below.iter().filter(stands).copied().collect();
            if standing.len() >= 2 {
                let cells = |limb: &usize| std::mem::take(&mut limbs[*limb].cells);
                let mut limbs: Vec<Vec<usize>> = standing.iter().map(cells).collect();
                limbs.sort_by_key(|cells| std::cmp::Reverse(cells.len()));
                let least = LEAST_SHARE * limbs[0].len() as f64;
                limbs.retain(|cells| cells.len() as f64 >= least);
                if limbs.len() >= 2 {
                    let row = part.row;
                    return Some(Meeting { row, limbs });
                }
                return None;
            }
            let own = below.iter().copied().max_by_key(|limb| limbs[*limb].cells.len());
            let own = own.unwrap_or_else(|| {
                let (start, cells) = (part.row, Vec::new());
                limbs.push(Limb { start, cells });
                limbs.len() - 1
            });
            for other in below.into_iter().filter(|other| *other != own) {
                let cells = std::mem::take(&mut limbs[other].cells);
                limbs[own].cells.extend(cells);
                limb_of
                    .iter_mut()
                    .filter(|limb| **limb == other)
                    .for_each(|limb| *limb = own);
            }
            limb_of[number] = own;
            limbs[own].cells.extend(&part.cells);
        }
        None
    }

    /// Looks for the legs.
    pub(super) fn legs(&self) -> Legs {
        let (parts, part_of) = self.row_parts();
        let last = (self.rows.len() - 1).max(1) as f64;
        let starts = STARTS.map(|share| self.row_at(share));
        let met = starts
            .iter()
            .find_map(|start| self.meeting_above(&parts, &part_of, *start));
        // Legs that touch part no higher than those of a person; what is thin above that are clothes.
        let thin = self.height_of_gap(THIN).min(PERSON);
        let (crotch, gap) = match &met {
            Some(met) => (thin.max(met.row.saturating_sub(1) as f64 / last), LegGap::Open),
            None => match thin.max(self.height_of_gap(CLEAR)) {
                touching if touching >= 0.12 => (touching, LegGap::Thin),
                _ => (PERSON, LegGap::Missing),
            },
        };
        let mut side_of = vec![0; self.lattice.places.len()];
        let feet = met.as_ref().map_or(0, |met| met.limbs.len());
        if let Some(met) = &met {
            for (limb, side) in self.pair_of_limbs(&met.limbs) {
                let mut part_of_row: BTreeMap<usize, usize> = BTreeMap::new();
                for part in limb.iter().map(|cell| part_of[*cell]) {
                    let largest = part_of_row.entry(parts[part].row).or_insert(part);
                    if parts[part].cells.len() > parts[*largest].cells.len() {
                        *largest = part;
                    }
                }
                // A hand that touches a leg is not one, nor is the arm above it.
                for part in part_of_row.values() {
                    parts[*part].cells.iter().for_each(|cell| side_of[*cell] = side);
                }
            }
        }
        let above = met.as_ref().map_or(0, |met| met.row);
        self.mark_legs_above(&parts, above, crotch, &mut side_of);
        Legs {
            crotch,
            gap,
            feet,
            side_of,
        }
    }

    /// The two largest limbs with the side that each is on.
    fn pair_of_limbs<'a>(&self, limbs: &'a [Vec<usize>]) -> impl Iterator<Item = (&'a Vec<usize>, i8)> {
        let x_of = |limb: &Vec<usize>| limb.iter().map(|c| self.lattice.places[*c].x).sum::<f64>() / limb.len() as f64;
        let sides: [i8; 2] = if x_of(&limbs[0]) > x_of(&limbs[1]) {
            [1, -1]
        } else {
            [-1, 1]
        };
        limbs.iter().zip(sides)
    }

    /// Marks what is above cells of legs, or stands, from a row up to a height.
    fn mark_legs_above(&self, parts: &[RowPart], from: usize, crotch: f64, side_of: &mut [i8]) {
        let (ground, top) = (self.row_at(0.03), self.row_at(crotch));
        let is_unmarked = side_of.iter().all(|side| *side == 0);
        for part in parts.iter().filter(|part| (from..=top).contains(&part.row)) {
            if part.cells.iter().any(|cell| side_of[*cell] != 0) {
                continue;
            }
            let mut below = part.cells.iter().flat_map(|cell| self.cells_of_row_around(*cell, -1));
            if below.any(|cell| side_of[cell] != 0) || (is_unmarked && part.row <= ground) {
                for cell in &part.cells {
                    side_of[*cell] = if self.lattice.places[*cell].x > self.middle {
                        1
                    } else {
                        -1
                    };
                }
            }
        }
    }
}

/// x of the plane that mirrors most cells of the trunk to cells, and their share of all.
fn plane_of_symmetry(lattice: &BodyLattice) -> (f64, f64) {
    let middle = median(lattice.places.iter().map(|p| p.x).collect());
    let near = lattice.coordinates(DVec3::new(middle, 0.0, 0.0))[0] as i64;
    let at: Vec<[i64; 3]> = (lattice.places.iter())
        .map(|p| lattice.coordinates(*p).map(|n| n as i64))
        .collect();
    let reach = 2 + lattice.width() as i64 / 16;
    let overlap = |sum: i64| {
        at.iter()
            .filter(|[x, y, z]| lattice.cell_at([sum - x, *y, *z]).is_some())
            .count()
    };
    let sums = (2 * near - reach)..=(2 * near + reach);
    let best = sums
        .map(|sum| (overlap(sum), std::cmp::Reverse((sum - 2 * near).abs()), sum))
        .max();
    let (count, _, sum) = best.unwrap_or_default();
    let x = lattice.x_of(0.5 * sum as f64);
    (x, count as f64 / at.len().max(1) as f64)
}

pub(super) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}
