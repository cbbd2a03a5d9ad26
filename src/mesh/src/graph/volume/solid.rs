//! Which connected parts of a mesh enclose space, and which way leads in.
//!
//! The winding number jumps by one across a face. Across a closed surface it jumps between whole numbers; across a
//! sheet in empty space between −½ and ½; a surface with holes lies between the two. A part whose faces see values
//! nearer to a half than to a whole number is a sheet: it encloses nothing, and it is left out when other parts are
//! asked what they enclose.
//!
//! The angle of a direction in the upper half plane.

use crate::graph::parallel::{map, map_in_space};
use crate::graph::volume::caps::ClosedHull;
use crate::graph::volume::lattice_grid::NearSurface;
use crate::graph::winding::WindingTree;
use crate::query::VisitBudget;
use crate::{Adjacency, Components, Error, Mesh};
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

/// Places of each part that are looked at.
const SAMPLES: usize = 32;
/// A part is a sheet when the winding number beside its faces is on average further than this from a whole number.
/// Measured: 0.47 to 0.50 for sheets, 0.26 for a car body without floor, under 0.07 for scans with holes.
pub(in crate::graph) const OPEN: f64 = 0.35;
/// One edge in so many without its match makes a soup.
pub(in crate::graph) const SOUP: usize = 4;
/// And so does one in so many edges around holes that lie inside.
const LOST: usize = 4;
/// Across a hole the winding number lies half-way between whole numbers; where it is nearer to one than this, there is no
/// hole.
const WHOLE: f64 = 0.15;

/// A unit vector for each vertex that has one.
pub(in crate::graph) type InwardDirections = Vec<DVec3>;

/// What a part encloses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::graph) enum PartKind {
    /// Space, exactly: each edge is passed equally often both ways, so its winding number is whole off its surface.
    Closed,
    /// Space, with holes that faces can close.
    Holed,
    /// Space, with so many holes that only its winding number shows what is inside.
    Soup,
    /// Nothing.
    Sheet,
}

/// The connected parts of a mesh, and what each encloses.
pub(in crate::graph) struct ClassifiedParts {
    pub(in crate::graph) components: Components,
    pub(in crate::graph) kinds: Vec<PartKind>,
}

impl ClassifiedParts {
    /// Separates solids from sheets. `step` is a small length beside an edge.
    pub(in crate::graph) fn sort(
        mesh: &Mesh,
        adjacency: &Adjacency,
        surface: &NearSurface,
        step: f64,
        budget: &VisitBudget<'_>,
    ) -> Result<Self, Error> {
        let components = Components::of_triangles(mesh.positions.len(), &mesh.triangles);
        let mut kinds = vec![PartKind::Closed; components.count];
        // All edges of a part, and those that are not passed equally often both ways.
        let mut edges = vec![(0usize, 0usize); components.count];
        for e in &adjacency.edges {
            let part = components.of_vertex[e.vertices[0] as usize] as usize;
            edges[part].0 += 1;
            if e.forward != e.backward {
                edges[part].1 += 1;
                kinds[part] = PartKind::Sheet;
            }
        }
        if kinds.contains(&PartKind::Sheet) {
            let part = |t: u32| components.of_vertex[mesh.triangles[t as usize][0] as usize] as usize;
            let faces = (0..mesh.triangles.len() as u32)
                .filter(|&t| kinds[part(t)] == PartKind::Sheet)
                .collect();
            let looked_at = sample(faces, components.count, part);
            let tree = surface.tree();
            let space = || tree.bvh().triangle_order().to_vec();
            let open = map_in_space(&looked_at, space, budget, |&t| {
                let [a, b, c] = mesh.triangles[t as usize].map(|v| mesh.positions[v as usize]);
                let beside = (b - a).cross(c - a).try_normalize()? * step;
                let winding = tree.rough_winding_number((a + b + c) / 3.0 - beside);
                Some((winding - winding.round()).abs())
            })?;
            let mut seen = vec![(0.0, 0.0); components.count];
            for (&t, open) in looked_at.iter().zip(open).filter_map(|(t, o)| Some((t, o?))) {
                let s: &mut (f64, f64) = &mut seen[part(t)];
                *s = (s.0 + open, s.1 + 1.0);
            }
            for ((kind, (sum, count)), (all, open)) in kinds.iter_mut().zip(seen).zip(edges) {
                if count > 0.0 && sum <= OPEN * count {
                    *kind = if open * SOUP > all {
                        PartKind::Soup
                    } else {
                        PartKind::Holed
                    };
                }
            }
        }
        Ok(Self { components, kinds })
    }

    /// What the part of a vertex encloses.
    pub(in crate::graph) fn kind(&self, vertex: u32) -> PartKind {
        self.kinds[self.components.of_vertex[vertex as usize] as usize]
    }

    /// Whether all parts are of one kind.
    pub(in crate::graph) fn all(&self, kind: PartKind) -> bool {
        self.kinds.iter().all(|&k| k == kind)
    }

    /// Whether rows can be followed through the part of a vertex: it is closed, or closed by faces over its holes.
    fn is_hull(&self, vertex: u32) -> bool {
        matches!(self.kind(vertex), PartKind::Closed | PartKind::Holed)
    }

    /// Closed and holed parts with their holes closed; `None` when there are none, or when all parts are closed.
    pub(in crate::graph) fn hull(&self, mesh: &Mesh, adjacency: &Adjacency) -> Option<ClosedHull> {
        let some = self
            .kinds
            .iter()
            .any(|k| matches!(k, PartKind::Closed | PartKind::Holed));
        let wanted = |v: u32| self.is_hull(v);
        (some && !self.all(PartKind::Closed))
            .then(|| ClosedHull::close(&mesh.positions, &mesh.triangles, adjacency, wanted))
    }

    /// The faces of soups; `None` when there are none, or when all parts are.
    pub(in crate::graph) fn soup(&self, mesh: &Mesh) -> Option<Vec<[u32; 3]>> {
        let mixed = self.kinds.contains(&PartKind::Soup) && !self.all(PartKind::Soup);
        let faces = mesh.triangles.iter().copied();
        mixed.then(|| faces.filter(|t| self.kind(t[0]) == PartKind::Soup).collect())
    }

    /// Takes holed parts for soups where closing their holes cuts through what the winding number counts as inside, as it
    /// does where cracks part a surface into patches. Whether any was found.
    pub(in crate::graph) fn doubt(
        &mut self,
        tree: &WindingTree,
        hull: &ClosedHull,
        budget: &VisitBudget<'_>,
    ) -> Result<bool, Error> {
        let within = map(&hull.loops, budget, |l| {
            let winding = tree.winding_number(l.2).abs();
            winding > 0.5 && (winding - winding.round()).abs() < WHOLE
        })?;
        // By part: edges of all loops, and of those that run around the inside.
        let mut edges = vec![(0usize, 0usize); self.kinds.len()];
        for (&(vertex, length, _), within) in hull.loops.iter().zip(within) {
            let part = &mut edges[self.components.of_vertex[vertex as usize] as usize];
            part.0 += length;
            part.1 += if within { length } else { 0 };
        }
        let mut found = false;
        for (kind, (all, within)) in self.kinds.iter_mut().zip(edges) {
            if within * LOST > all {
                *kind = PartKind::Soup;
                found = true;
            }
        }
        Ok(found)
    }
}

/// From how many places ahead of and behind a part's vertices lie inside to how its normals are to be taken: 1, −1 turned
/// round, 0 not at all.
pub(in crate::graph) fn turn(ahead: usize, behind: usize) -> f64 {
    match (ahead, behind) {
        (0, 0) => 0.0,
        _ if behind > ahead => -1.0,
        _ => 1.0,
    }
}

/// At most about [`SAMPLES`] members of each part, evenly spread over `members`.
pub(in crate::graph) fn sample(members: Vec<u32>, parts: usize, part: impl Fn(u32) -> usize) -> Vec<u32> {
    let mut size = vec![0usize; parts];
    members.iter().for_each(|&m| size[part(m)] += 1);
    let mut seen = vec![0usize; parts];
    let mut chosen = members;
    chosen.retain(|&m| {
        let part = part(m);
        seen[part] += 1;
        (seen[part] - 1).is_multiple_of(size[part].div_ceil(SAMPLES))
    });
    chosen
}

/// Unit normal of a vertex: face normals weighted by the angle at the vertex; zero where they cancel.
pub(in crate::graph) fn normal(positions: &[DVec3], triangles: &[[u32; 3]], adjacency: &Adjacency, v: u32) -> DVec3 {
    let p = positions[v as usize];
    let mut sum = DVec3::ZERO;
    for &f in adjacency.faces.of(v) {
        let t = triangles[f as usize];
        // Which corner it is comes at random, so this is not a branch.
        let first = 2 * usize::from(t[2] == v) + usize::from(t[1] == v);
        let [a, b] = [1, 2].map(|k| positions[t[(first + k) % 3] as usize] - p);
        let cross = a.cross(b);
        let twice_area = cross.length();
        if twice_area > 0.0 {
            sum += cross / twice_area * upper_angle(twice_area, a.dot(b));
        }
    }
    if sum.length() > 1e-9 {
        sum.normalize()
    } else {
        DVec3::ZERO
    }
}

/// Arguments of this size and its reciprocal have a quotient and need no care.
const MODERATE: f64 = 1e150;
/// Where the arc tangent changes from one of its five forms to the next.
const STEPS: [f64; 4] = [0.4375, 0.6875, 1.1875, 2.4375];
/// For each form (a, b, c, d): the arc tangent of q is that of (a q − b) / (c + d q) …
const FRACTIONS: [[f64; 4]; 5] = [
    [1.0, 0.0, 1.0, 0.0],
    [2.0, 1.0, 2.0, 1.0],
    [1.0, 1.0, 1.0, 1.0],
    [1.0, 1.5, 1.0, 1.5],
    [0.0, 1.0, 0.0, 1.0],
];
/// … and of 0, ½, 1, 1½ or ∞, in two parts.
const SHIFTS: [[f64; 2]; 5] = [
    [0.0, 0.0],
    [4.636_476_090_008_061e-1, 2.269_877_745_296_168_7e-17],
    [FRAC_PI_4, 3.061_616_997_868_383e-17],
    [9.827_937_232_473_29e-1, 1.390_331_103_123_099_8e-17],
    [FRAC_PI_2, 6.123_233_995_736_766e-17],
];
const EVEN: [f64; 6] = [
    3.333_333_333_333_293e-1,
    1.428_571_427_250_346_6e-1,
    9.090_887_133_436_507e-2,
    6.661_073_137_387_531e-2,
    4.976_877_994_615_932_4e-2,
    1.628_582_011_536_578_2e-2,
];
const ODD: [f64; 5] = [
    -1.999_999_999_987_648_3e-1,
    -1.111_111_040_546_235_6e-1,
    -7.691_876_205_044_83e-2,
    -5.833_570_133_790_573_5e-2,
    -3.653_157_274_421_691_6e-2,
];
const PI_LOW: f64 = 1.224_646_799_147_353_2e-16;

/// The angle of (`x`, `y`) for `y` above 0: bit-identical to `libm::atan2`, by the same steps without their branches,
/// which angles of a mesh take at random.
#[inline]
fn upper_angle(y: f64, x: f64) -> f64 {
    let is_moderate = |v: f64| (1.0 / MODERATE..MODERATE).contains(&v);
    let q = (y / x).abs();
    if !(is_moderate(y) && is_moderate(x.abs()) && (1e-8..1e18).contains(&q)) {
        return libm::atan2(y, x);
    }
    let form: usize = STEPS.iter().map(|&step| usize::from(q >= step)).sum();
    let ([a, b, c, d], [high, low]) = (FRACTIONS[form], SHIFTS[form]);
    let r = (a * q - b) / (c + d * q);
    let z = r * r;
    let w = z * z;
    let even = z * (EVEN[0] + w * (EVEN[1] + w * (EVEN[2] + w * (EVEN[3] + w * (EVEN[4] + w * EVEN[5])))));
    let odd = w * (ODD[0] + w * (ODD[1] + w * (ODD[2] + w * (ODD[3] + w * ODD[4]))));
    let angle = high - (r * (even + odd) - low - r);
    if x < 0.0 { PI - (angle - PI_LOW) } else { angle }
}

#[cfg(test)]
mod angle_tests {
    use super::*;

    #[test]
    fn angles_are_those_of_libm_to_the_bit() {
        let mut next = crate::testing::random(5);
        let ask = |y: f64, x: f64| {
            let (own, known) = (upper_angle(y, x), libm::atan2(y, x));
            assert_eq!(own.to_bits(), known.to_bits(), "{y:e}, {x:e}: {own:e}, {known:e}");
        };
        let edges = STEPS.iter().flat_map(|s| [s.next_down(), *s, s.next_up()]);
        let special = [
            1.0,
            0.0,
            -0.0,
            1e-300,
            1e300,
            5e-324,
            f64::INFINITY,
            f64::NAN,
            1e-8,
            1e18,
            1e-20,
        ];
        let values: Vec<f64> = edges.chain(special).collect();
        for &y in values.iter().filter(|&&y| y > 0.0) {
            for &x in &values {
                ask(y, x);
                ask(y, -x);
            }
        }
        for _ in 0..200_000 {
            ask(next() + 1e-12, next() - 0.5);
            let scale = libm::exp2(40.0 * (next() - 0.5));
            ask(next() * scale + 1e-300, next() - 0.5);
        }
    }
}
