//! Where the joints of a body lie in a mesh that stands upright and faces along z.
//!
//! The largest body of cells that hang together in a mesh, and how far they are from each other through it.

use crate::skin_weights::OccupiedCells;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Tenths of a cell in a band of an arm.
const BAND: u32 = 15;
/// A band that is so many times as large as those before it is the trunk.
const GROWTH: f64 = 2.0;
/// Where a wrist and an elbow are on the way from a finger's tip to the shoulder, and a knee on that from ankle to hip.
const WRIST: f64 = 0.25;
const ELBOW: f64 = 0.64;
/// The gap between legs over their depth: of legs apart, and of legs that touch.
const CLEAR: f64 = 0.25;
const THIN: f64 = 0.6;
/// Where a person's legs part, over the height.
const PERSON: f64 = 0.46;
/// How far off the straight way a joint has to be to show where the limb bends, over its length.
const BEND: f64 = 0.04;

/// What was found of a body.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FoundBody {
    /// Places by the name of the joint.
    pub joints: BTreeMap<&'static str, DVec3>,
    /// What speaks against the mesh being an upright figure, one line each; none where it looks like one.
    pub doubts: Vec<String>,
    /// Whether that is so much that the places mean nothing.
    pub is_none: bool,
}

/// Names of one side's joints.
struct SideNames {
    sign: f64,
    arm: [&'static str; 4],
    clavicle: &'static str,
    leg: [&'static str; 4],
}

const SIDES: [SideNames; 2] = [
    SideNames {
        sign: 1.0,
        arm: ["lHandEnd", "lWrist", "lElbow", "lShoulder"],
        clavicle: "lClav",
        leg: ["lHip", "lKnee", "lAnkle", "lToe"],
    },
    SideNames {
        sign: -1.0,
        arm: ["rHandEnd", "rWrist", "rElbow", "rShoulder"],
        clavicle: "rClav",
        leg: ["rHip", "rKnee", "rAnkle", "rToe"],
    },
];

/// Looks for all joints of a body.
///
/// # Errors
/// [`Cancelled`] when the caller cancels.
pub fn find_body(positions: &[DVec3], triangles: &[[u32; 3]], exec: &Exec<'_>) -> Result<FoundBody, Cancelled> {
    let lattice = BodyLattice::of_mesh(positions, triangles, exec)?;
    let search = BodySearch::of_lattice(lattice);
    let mut found = FoundBody::default();
    let crotch = search.crotch(&mut found.doubts);
    let mut shoulders = Vec::new();
    for side in &SIDES {
        exec.check()?;
        search.add_leg(side, crotch, &mut found);
        if let Some(length) = search.add_arm(side, &mut found) {
            shoulders.push((found.joints[side.arm[3]], length));
        }
    }
    search.even_shoulders(&mut shoulders, &mut found);
    search.add_trunk(crotch, &shoulders, &mut found);
    search.add_doubts(&shoulders, &mut found);
    Ok(found)
}

/// A body of cells, its extents and rows.
struct BodySearch {
    lattice: BodyLattice,
    low: DVec3,
    extent: DVec3,
    /// x of the plane between left and right.
    middle: f64,
    /// Cells by their height.
    rows: Vec<Vec<usize>>,
}

impl BodySearch {
    fn of_lattice(lattice: BodyLattice) -> Self {
        let low = lattice.places.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = lattice.places.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        let mut rows = vec![Vec::new(); lattice.height()];
        for (cell, p) in lattice.places.iter().enumerate() {
            rows[lattice.coordinates(*p)[1]].push(cell);
        }
        let middle = median(lattice.places.iter().map(|p| p.x).collect());
        Self {
            low,
            extent: high - low,
            middle,
            rows,
            lattice,
        }
    }

    fn row_at(&self, share: f64) -> usize {
        ((self.rows.len() - 1) as f64 * share.clamp(0.0, 1.0)).round() as usize
    }

    fn height_at(&self, share: f64) -> f64 {
        self.low.y + self.extent.y * share
    }

    /// The middle of the cells of a row that fit.
    fn middle_of_row(&self, share: f64, fits: impl Fn(DVec3) -> bool) -> Option<DVec3> {
        let row = self.rows[self.row_at(share)].iter().map(|c| self.lattice.places[*c]);
        let own: Vec<DVec3> = row.filter(|p| fits(*p)).collect();
        let x = median(own.iter().map(|p| p.x).collect());
        let z = median(own.iter().map(|p| p.z).collect());
        (!own.is_empty()).then(|| DVec3::new(x, self.height_at(share), z))
    }

    /// Whether a row has a gap between left and right.
    fn has_gap(&self, row: usize, thin: f64) -> bool {
        let mut columns: BTreeMap<usize, usize> = BTreeMap::new();
        for cell in &self.rows[row] {
            *columns
                .entry(self.lattice.coordinates(self.lattice.places[*cell])[0])
                .or_default() += 1;
        }
        let (Some(first), Some(last)) = (columns.keys().next(), columns.keys().next_back()) else {
            return false;
        };
        let most = columns.values().max().copied().unwrap_or(0);
        let middle = self.lattice.coordinates(DVec3::new(self.middle, 0.0, 0.0))[0];
        let near = (last - first) / 6 + 1;
        let center = middle.saturating_sub(near).max(first + 1)..(middle + near + 1).min(*last);
        center
            .clone()
            .any(|x| (columns.get(&x).copied().unwrap_or(0) as f64) <= thin * most as f64)
    }

    /// How high legs part, as a share of the height.
    fn crotch(&self, doubts: &mut Vec<String>) -> f64 {
        let clear = self.height_of_gap(CLEAR);
        if clear < 0.12 {
            doubts.push("no gap parts the legs; hips and knees are where those of a person are".into());
            return PERSON;
        }
        // Legs that touch part no higher than those of a person; what is thin above that are clothes.
        clear.max(self.height_of_gap(THIN).min(PERSON))
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

    fn add_leg(&self, side: &SideNames, crotch: f64, found: &mut FoundBody) {
        let hip_share = crotch * 1.07;
        let away = 0.02 * self.extent.x;
        let is_own = |p: DVec3| (p.x - self.middle) * side.sign > away;
        let at = |share: f64| self.middle_of_row(share, is_own);
        let rows = 24;
        // From just above the ankle to just below the crotch.
        let ankle_share = 0.115 * hip_share;
        let shares = (0..=rows).map(|k| ankle_share + (0.95 * crotch - ankle_share) * f64::from(k) / f64::from(rows));
        let line: Vec<DVec3> = shares.filter_map(at).collect();
        let (Some(&ankle), Some(&top)) = (line.first(), line.last()) else {
            found.doubts.push("there is no leg at one side".into());
            return;
        };
        let hip = DVec3::new(
            self.middle + 0.85 * (top.x - self.middle),
            self.height_at(hip_share),
            top.z,
        );
        let knee = bend_of(&line, 0.53).unwrap_or_else(|| ankle.lerp(hip, 0.53));
        let sole: Vec<DVec3> = self.rows[..=self.row_at(0.6 * ankle_share)]
            .iter()
            .flatten()
            .map(|c| self.lattice.places[*c])
            .filter(|p| is_own(*p) && (p.x - ankle.x).abs() < 0.12 * self.extent.y)
            .collect();
        let front = sole.iter().map(|p| p.z).fold(f64::NEG_INFINITY, f64::max);
        let ahead: Vec<DVec3> = sole
            .into_iter()
            .filter(|p| p.z > ankle.z + 0.6 * (front - ankle.z))
            .collect();
        let toe = match ahead.is_empty() {
            true => ankle - DVec3::Y * (0.5 * ankle_share * self.extent.y),
            false => {
                let mean = ahead.iter().sum::<DVec3>() / ahead.len() as f64;
                DVec3::new(mean.x, mean.y, ankle.z + 0.85 * (front - ankle.z))
            }
        };
        for (name, place) in side.leg.into_iter().zip([hip, knee, ankle, toe]) {
            found.joints.insert(name, place);
        }
    }

    /// Adds the joints of an arm; its length.
    fn add_arm(&self, side: &SideNames, found: &mut FoundBody) -> Option<f64> {
        let height = self.extent.y;
        let trunk = DVec3::new(self.middle, self.height_at(0.6), 0.5 * self.extent.z + self.low.z);
        let trunk = self.lattice.cell_near(trunk);
        let from_trunk = self.lattice.distances_from(trunk);
        let side_way = |p: DVec3| (p.x - self.middle) * side.sign;
        let candidates = (0..self.lattice.places.len()).filter(|c| {
            let p = self.lattice.places[*c];
            from_trunk[*c] != FAR && p.y > self.height_at(0.28) && side_way(p) > 0.1 * self.extent.x
        });
        let reach = |c: usize| f64::from(from_trunk[c]) / 10.0 + side_way(self.lattice.places[c]) / self.lattice.side;
        let ranked = candidates.map(|c| (reach(c), c));
        let tip = ranked.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?.1;
        let from_tip = self.lattice.distances_from(tip);
        let bands = self.bands(&from_tip, (height / self.lattice.side * 6.0) as u32);
        let cells_a_band = f64::from(BAND) / 10.0;
        let hand = (0.13 * height / (self.lattice.side * cells_a_band)).ceil() as usize;
        let limit = (0.6 * height / (self.lattice.side * cells_a_band)) as usize;
        let mut shoulder = None;
        for band in hand..limit.min(bands.len().saturating_sub(1)) {
            let before = median(bands[hand / 2..band].iter().map(|b| b.1).collect());
            if bands[band].1 > GROWTH * before && bands[band + 1].1 > GROWTH * before {
                shoulder = Some(band);
                break;
            }
        }
        let last = shoulder.map(|band| band.saturating_sub(1)).filter(|band| *band > 3)?;
        let line: Vec<DVec3> = bands[..=last].iter().map(|b| b.0).collect();
        let inwards = (line[last] - line[last - 3]).normalize_or_zero();
        let radius = self.lattice.side * (bands[last].1 / cells_a_band / std::f64::consts::PI).sqrt();
        let end = line[last] + inwards * (1.2 * radius).min(0.08 * height);
        let mut whole = line;
        whole.push(end);
        let wrist = place_along(&whole, WRIST);
        let elbow = bend_of(&whole, ELBOW).unwrap_or_else(|| place_along(&whole, ELBOW));
        for (name, place) in side.arm.into_iter().zip([whole[0], wrist, elbow, end]) {
            found.joints.insert(name, place);
        }
        let clavicle = DVec3::new(self.middle + 0.2 * (end.x - self.middle), end.y, end.z);
        found.joints.insert(side.clavicle, clavicle);
        Some(whole.windows(2).map(|w| w[0].distance(w[1])).sum())
    }

    /// Brings shoulders at about one height to one height, as far from the middle as each other.
    fn even_shoulders(&self, shoulders: &mut [(DVec3, f64)], found: &mut FoundBody) {
        let [left, right] = shoulders else { return };
        if (left.0.y - right.0.y).abs() > 0.15 * self.extent.y {
            return;
        }
        let height = 0.5 * (left.0.y + right.0.y);
        let away = 0.5 * (left.0.x - right.0.x).abs();
        for (side, own) in SIDES.iter().zip([left, right]) {
            own.0 = DVec3::new(self.middle + side.sign * away, height, own.0.z);
            let clavicle = DVec3::new(self.middle + side.sign * 0.2 * away, height, own.0.z);
            found.joints.insert(side.arm[3], own.0);
            found.joints.insert(side.clavicle, clavicle);
        }
    }

    /// Means and counts of the cells that are so and so far.
    fn bands(&self, far: &[u32], most: u32) -> Vec<(DVec3, f64)> {
        let mut bands = vec![(DVec3::ZERO, 0.0); (most / BAND) as usize + 1];
        for (p, far) in self.lattice.places.iter().zip(far).filter(|(_, far)| **far <= most) {
            let band = &mut bands[(far / BAND) as usize];
            band.0 += *p;
            band.1 += 1.0;
        }
        bands.retain(|b| b.1 > 0.0);
        bands.iter().map(|b| (b.0 / b.1, b.1)).collect()
    }

    fn add_trunk(&self, crotch: f64, shoulders: &[(DVec3, f64)], found: &mut FoundBody) {
        let share_of = |y: f64| (y - self.low.y) / self.extent.y;
        let mean = shoulders.iter().map(|s| share_of(s.0.y)).sum::<f64>() / shoulders.len().max(1) as f64;
        let shoulder = if shoulders.is_empty() { 0.81 } else { mean };
        let hips = (crotch + 0.06).min(shoulder - 0.1);
        let near = 0.1 * self.extent.x;
        let at = |share: f64| {
            let place = self.middle_of_row(share, |p| (p.x - self.middle).abs() < near);
            let plain = DVec3::new(self.middle, 0.0, self.low.z + 0.5 * self.extent.z);
            let place = place.unwrap_or(plain);
            DVec3::new(self.middle, self.height_at(share), place.z)
        };
        let between = |a: f64, b: f64, t: f64| a + (b - a) * t;
        for (name, share) in [
            ("hips", hips),
            ("spine", between(hips, shoulder, 0.25)),
            ("chest", between(hips, shoulder, 0.55)),
            ("neck", between(shoulder, 1.0, 0.12)),
            ("head", between(shoulder, 1.0, 0.35)),
            ("headEnd", 0.985),
        ] {
            found.joints.insert(name, at(share));
        }
        // Ears and horns are no way for a head to go.
        let (head, end) = (found.joints["head"], found.joints["headEnd"]);
        let most = 0.5 * (end.y - head.y).abs();
        let z = head.z + (end.z - head.z).clamp(-most, most);
        found.joints.insert("headEnd", DVec3::new(end.x, end.y, z));
    }

    /// Whether what touches the ground at one side lies far apart.
    fn stands_on_more(&self) -> bool {
        let sole = self.rows[..=self.row_at(0.04)]
            .iter()
            .flatten()
            .map(|c| self.lattice.places[*c]);
        let sole: Vec<DVec3> = sole.collect();
        [1.0, -1.0].iter().any(|sign| {
            let own = sole.iter().filter(|p| (p.x - self.middle) * sign > 0.0);
            let mut along: Vec<f64> = own.map(|p| p.z).collect();
            along.sort_by(f64::total_cmp);
            along.windows(2).any(|w| w[1] - w[0] > 0.1 * self.extent.y)
        })
    }

    fn add_doubts(&self, shoulders: &[(DVec3, f64)], found: &mut FoundBody) {
        let height = self.extent.y;
        found.is_none = self.stands_on_more();
        if found.is_none {
            found.doubts.push("it stands on more than two feet".into());
        }
        if self.extent.z > 0.95 * height {
            found.doubts.push("it is as deep as it is high".into());
        }
        match shoulders {
            [left, right] => {
                if (left.0.y - right.0.y).abs() > 0.15 * height {
                    found.doubts.push("its shoulders are not at one height".into());
                }
                if left.1.max(right.1) > 1.5 * left.1.min(right.1) {
                    found
                        .doubts
                        .push("one of its arms is much longer than the other".into());
                }
            }
            _ => found
                .doubts
                .push("there are no two arms that end where a trunk begins".into()),
        }
        found.is_none |= found.doubts.len() > 1 || shoulders.len() < 2;
    }
}

fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(0.0)
}

/// The place at a share of a line's length.
fn place_along(line: &[DVec3], share: f64) -> DVec3 {
    let all: f64 = line.windows(2).map(|w| w[0].distance(w[1])).sum();
    let mut left = share * all;
    for w in line.windows(2) {
        let length = w[0].distance(w[1]);
        if left <= length && length > 0.0 {
            return w[0].lerp(w[1], left / length);
        }
        left -= length;
    }
    line.last().copied().unwrap_or_default()
}

/// Where a line bends most near a share of its length; `None` where it is straight there.
fn bend_of(line: &[DVec3], near: f64) -> Option<DVec3> {
    let (from, to) = (*line.first()?, *line.last()?);
    let length: f64 = line.windows(2).map(|w| w[0].distance(w[1])).sum();
    let way = (to - from).try_normalize()?;
    let off = |p: DVec3| ((p - from) - way * (p - from).dot(way)).length();
    let shares = (0..=20).map(|k| near - 0.12 + 0.012 * f64::from(k));
    let ranked = shares.map(|share| place_along(line, share)).map(|p| (off(p), p));
    let best = ranked.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (best.0 > BEND * length).then_some(best.1)
}

/// Cells of the box around a mesh, about.
const CELLS: usize = 1 << 18;
/// Not reached.
pub(super) const FAR: u32 = u32::MAX;
/// Lengths of steps along one, two and three axes, in tenths of a cell.
const STEPS: [u32; 4] = [0, 10, 14, 17];

/// Cells of a cubic lattice inside a mesh.
pub(super) struct BodyLattice {
    /// Side of a cell.
    pub(super) side: f64,
    /// The middle of each cell.
    pub(super) places: Vec<DVec3>,
    low: DVec3,
    size: [usize; 3],
    /// By place in the box, the cell, or [`FAR`].
    cell: Vec<u32>,
}

impl BodyLattice {
    /// Finds the cells of a mesh, and keeps the largest part of them.
    pub(super) fn of_mesh(positions: &[DVec3], triangles: &[[u32; 3]], exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let cells = OccupiedCells::find(positions, triangles, CELLS, exec)?;
        let whole = Self::around_places(cells.places, cells.side);
        let mut part = vec![FAR; whole.places.len()];
        let mut largest = (0, 0);
        for seed in 0..whole.places.len() {
            if part[seed] != FAR {
                continue;
            }
            let mut count = 0;
            let mut open = vec![seed];
            part[seed] = seed as u32;
            while let Some(at) = open.pop() {
                count += 1;
                for (next, _) in whole.cells_around(at) {
                    if part[next] == FAR {
                        part[next] = seed as u32;
                        open.push(next);
                    }
                }
            }
            if count > largest.0 {
                largest = (count, seed as u32);
            }
        }
        let kept = whole.places.iter().zip(&part).filter(|(_, p)| **p == largest.1);
        Ok(Self::around_places(kept.map(|(p, _)| *p).collect(), whole.side))
    }

    fn around_places(places: Vec<DVec3>, side: f64) -> Self {
        let low = places.iter().fold(DVec3::INFINITY, |a, p| a.min(*p));
        let high = places.iter().fold(DVec3::NEG_INFINITY, |a, p| a.max(*p));
        let size = ((high - low) / side).round().to_array().map(|n| n as usize + 1);
        let mut lattice = Self {
            side,
            low,
            size,
            cell: vec![FAR; size[0] * size[1] * size[2]],
            places,
        };
        for k in 0..lattice.places.len() {
            let at = lattice.coordinates(lattice.places[k]);
            let place = lattice.place_of(at);
            lattice.cell[place] = k as u32;
        }
        lattice
    }

    /// Which cell of the box a point is in, as steps from the lowest one.
    pub(super) fn coordinates(&self, p: DVec3) -> [usize; 3] {
        let at = ((p - self.low) / self.side).round().max(DVec3::ZERO);
        [0, 1, 2].map(|k| (at[k] as usize).min(self.size[k] - 1))
    }

    fn place_of(&self, [x, y, z]: [usize; 3]) -> usize {
        (z * self.size[1] + y) * self.size[0] + x
    }

    /// Rows of cells from bottom to top.
    pub(super) fn height(&self) -> usize {
        self.size[1]
    }

    /// The cells that touch one, and how long the steps to them are.
    fn cells_around(&self, cell: usize) -> impl Iterator<Item = (usize, u32)> + '_ {
        let at = self.coordinates(self.places[cell]);
        (0..27).filter_map(move |k| {
            let shift = [k % 3, k / 3 % 3, k / 9];
            let mut to = [0; 3];
            for axis in 0..3 {
                to[axis] = (at[axis] + shift[axis])
                    .checked_sub(1)
                    .filter(|v| *v < self.size[axis])?;
            }
            let axes = shift.iter().filter(|s| **s != 1).count();
            let next = self.cell[self.place_of(to)];
            (axes > 0 && next != FAR).then_some((next as usize, STEPS[axes]))
        })
    }

    /// How far each cell is from one of them, through the body, in tenths of a cell.
    fn distances_from(&self, seed: usize) -> Vec<u32> {
        let mut far = vec![FAR; self.places.len()];
        let mut open = BinaryHeap::from([Reverse((0, seed))]);
        far[seed] = 0;
        while let Some(Reverse((distance, at))) = open.pop() {
            if distance > far[at] {
                continue;
            }
            for (next, step) in self.cells_around(at) {
                let there = distance + step;
                if there < far[next] {
                    far[next] = there;
                    open.push(Reverse((there, next)));
                }
            }
        }
        far
    }

    /// The cell nearest to a point.
    fn cell_near(&self, p: DVec3) -> usize {
        let ranked = self.places.iter().enumerate().map(|(k, q)| (q.distance_squared(p), k));
        ranked
            .min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)))
            .map_or(0, |best| best.1)
    }
}
