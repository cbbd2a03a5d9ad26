//! Conditions on a few vertices each that keep two surfaces apart, found where triangles cross.

use super::layers::{LayerSides, MisplacedVertex};
use super::region::ContactRegion;
use glam::DVec3;
use pliant_mesh::Mesh;
use pliant_mesh::query::closest_point::closest_weights_on_triangle;
use std::collections::BTreeMap;

/// A condition is kept while surfaces are nearer than this, median edges,
const KEPT: f64 = 1.0;
/// and its two places not further aside of each other than this.
const ASIDE: f64 = 1.0;
/// By what part of what is missing a condition asks for more in the next round,
const RATE: f64 = 0.5;
/// up to this, median edges.
const MOST_SHIFT: f64 = 0.6;
/// A vertex lies behind a face when it is not further aside of it than this, median edges.
const BEHIND: f64 = 0.5;
/// Surfaces that were nearer in the rest pose keep this part of that.
const REST_PART: f64 = 0.5;
/// How much flatter a crumpled place gets each time that it is met, and its neighbours,
const FLATTER: [f64; 2] = [1.0, 0.3];
/// and at most, in the first unit.
const FLATTEST: f64 = 8.0;

/// What a condition is about, by which it is known again.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Encounter {
    /// A vertex and a face.
    Face(u32, u32),
    /// Two edges.
    Edges([u32; 2], [u32; 2]),
    /// Two faces as a whole, for one round.
    Faces([u32; 2]),
}

/// A condition: the sum of the places of vertices, each times its factor, along `direction` is `least` or more.
#[derive(Debug, Clone, Copy)]
pub(super) struct Condition {
    pub nodes: [(u32, f64); 6],
    pub direction: DVec3,
    pub least: f64,
    /// What it asks for beyond `least`, because a solve gave less.
    pub shift: f64,
    /// The sum in the shape that it was found in.
    pub gap: f64,
}

impl Condition {
    /// Where the places of the two sides lie from each other in a shape.
    pub fn between(&self, at: &[DVec3]) -> DVec3 {
        between(&self.nodes, at)
    }
}

/// Where the middles of the two sides lie from each other.
fn between(nodes: &[(u32, f64); 6], at: &[DVec3]) -> DVec3 {
    nodes.iter().map(|(v, factor)| at[*v as usize] * *factor).sum()
}

/// How surfaces are parted. What is best depends on how rough they are.
#[derive(Debug, Clone, Copy)]
pub(super) struct PartingStyle {
    /// How often normals are averaged.
    pub smoothing: usize,
    /// Two faces do not face each other when the cosine of the angle between their normals is above this: the surface is crumpled.
    pub facing: f64,
    /// How far a crumpled place is flattened.
    pub flatten: f64,
    /// What bending weighs beside stretching of the displacement.
    pub bending: f64,
    /// What a missed condition weighs beside what moves one vertex alone.
    pub stiffness: f64,
}

/// What was found so far.
#[derive(Debug, Clone, Default)]
pub(super) struct Knowledge {
    known: BTreeMap<Encounter, Condition>,
    /// By solver vertex of a crumpled place, how far it is to be flattened.
    flat: BTreeMap<u32, f64>,
}

/// Finds conditions.
pub(super) struct ContactFinder<'a> {
    pub mesh: &'a Mesh,
    pub region: &'a ContactRegion,
    pub layers: &'a LayerSides,
    pub style: PartingStyle,
    pub clearance: f64,
    /// Whether a pose is parted, in which surfaces may be as near as in the rest pose, and that shape itself is not.
    pub is_posed: bool,
    /// Normals of the shape that is to be parted, by vertex.
    pub normals: Vec<DVec3>,
    pub knowledge: Knowledge,
}

impl ContactFinder<'_> {
    /// The conditions in force, in a fixed order.
    pub fn conditions(&self) -> Vec<Condition> {
        self.knowledge.known.values().copied().collect()
    }

    /// How far a vertex is to be flattened.
    pub fn flat(&self, v: u32) -> f64 {
        self.knowledge.flat.get(&v).copied().unwrap_or(0.0)
    }

    /// Looks at those that are known again, in another shape, and adds those of pairs of faces that cross and of misplaced vertices.
    pub fn look(&mut self, at: &[DVec3], crossings: &[[u32; 2]], misplaced: &[MisplacedVertex]) {
        for (encounter, before) in std::mem::take(&mut self.knowledge.known) {
            let Some(mut now) = self
                .condition(encounter, at)
                .filter(|_| !matches!(encounter, Encounter::Faces(_)))
            else {
                continue;
            };
            now.shift = (before.shift + RATE * (now.least - now.gap)).clamp(0.0, MOST_SHIFT * self.region.edge);
            let is_near = now.gap <= (KEPT * self.region.edge).max(self.clearance) || now.shift > 0.0;
            if is_near && self.aside(&now, at) <= ASIDE * self.region.edge {
                self.knowledge.known.insert(encounter, now);
            }
        }
        for pair in crossings {
            self.see(*pair, at);
        }
        for found in misplaced {
            let corners = self.mesh.triangles[found.triangle as usize];
            let is_free = |v: &u32| (self.region.local[*v as usize] as usize) < self.region.free;
            if corners.iter().chain([&found.vertex]).any(is_free) {
                self.add(Encounter::Face(found.vertex, found.triangle), at, |_, _| true);
            }
        }
    }

    fn aside(&self, condition: &Condition, at: &[DVec3]) -> f64 {
        (condition.between(at) - condition.direction * condition.gap).length()
    }

    /// Adds the conditions of two faces that cross.
    fn see(&mut self, pair: [u32; 2], at: &[DVec3]) {
        let corners = pair.map(|t| self.mesh.triangles[t as usize]);
        let normals = corners.map(|c| c.iter().map(|v| self.normals[*v as usize]).sum::<DVec3>());
        let [own, other] = self.sided(normals, [corners[0][0], corners[1][0]]);
        if own.normalize_or_zero().dot(other.normalize_or_zero()) > self.style.facing {
            self.flatten(corners);
            return;
        }
        let places = corners.map(|c| c.map(|v| at[v as usize]));
        let through = [0, 1].map(|side| edges_through(corners[side], places[side], places[1 - side]));
        let mut is_met = false;
        if let (Some(a), Some(b)) = (through[0].first(), through[1].first()) {
            is_met = self.add(Encounter::Edges(*a, *b), at, |_, condition| {
                condition.gap < condition.least
            });
        } else {
            let behind = |finder: &Self, condition: &Condition| {
                condition.gap < 0.0 && finder.aside(condition, at) < BEHIND * finder.region.edge
            };
            for side in (0..2).filter(|side| !through[*side].is_empty()) {
                for v in corners[side] {
                    is_met |= self.add(Encounter::Face(v, pair[1 - side]), at, behind);
                }
            }
        }
        if !is_met {
            self.add(Encounter::Faces(pair), at, |_, _| true);
        }
    }

    /// Adds one that is new, if it `holds`; whether it is known then.
    fn add(&mut self, encounter: Encounter, at: &[DVec3], holds: impl Fn(&Self, &Condition) -> bool) -> bool {
        if self.knowledge.known.contains_key(&encounter) {
            return true;
        }
        match self.condition(encounter, at).filter(|condition| holds(self, condition)) {
            Some(condition) => self.knowledge.known.insert(encounter, condition).is_none(),
            None => false,
        }
    }

    /// A crumpled place: pushing does not help, it is to get flatter.
    fn flatten(&mut self, corners: [[u32; 3]; 2]) {
        let most = FLATTEST * self.style.flatten;
        for v in corners.as_flattened() {
            let own = self.region.local[*v as usize] as usize;
            let around = self.region.neighbours.get(own).into_iter().flatten();
            let around = around.map(|w| (self.region.nodes[*w as usize], FLATTER[1]));
            for (w, flatter) in around.chain([(*v, FLATTER[0])]) {
                let flat = self.knowledge.flat.entry(w).or_default();
                *flat = (*flat + flatter * self.style.flatten).min(most);
            }
        }
    }

    /// The condition of a encounter in a shape; `None` where it has no direction.
    fn condition(&self, encounter: Encounter, at: &[DVec3]) -> Option<Condition> {
        let normal = |v: u32| self.normals[v as usize];
        match encounter {
            Encounter::Face(v, t) => {
                let c = self.mesh.triangles[t as usize];
                if c.contains(&v) {
                    return None;
                }
                let (w, _) = closest_weights_on_triangle(at[v as usize], c.map(|v| at[v as usize]));
                let other = (0..3).map(|k| normal(c[k]) * w[k]).sum();
                let nodes = [
                    (v, 1.0),
                    (c[0], -w[0]),
                    (c[1], -w[1]),
                    (c[2], -w[2]),
                    (v, 0.0),
                    (v, 0.0),
                ];
                self.filled(nodes, self.sided([normal(v), other], [v, c[0]]), at)
            }
            Encounter::Edges(a, b) => {
                if a.iter().any(|v| b.contains(v)) {
                    return None;
                }
                let (s, t) = closest_of_segments(a.map(|v| at[v as usize]), b.map(|v| at[v as usize]));
                let own = normal(a[0]).lerp(normal(a[1]), s);
                let other = normal(b[0]).lerp(normal(b[1]), t);
                let nodes = [
                    (a[0], 1.0 - s),
                    (a[1], s),
                    (b[0], t - 1.0),
                    (b[1], -t),
                    (a[0], 0.0),
                    (a[0], 0.0),
                ];
                self.filled(nodes, self.sided([own, other], [a[0], b[0]]), at)
            }
            Encounter::Faces(pair) => {
                let [a, b] = pair.map(|t| self.mesh.triangles[t as usize]);
                let third = 1.0 / 3.0;
                let nodes = [
                    (a[0], third),
                    (a[1], third),
                    (a[2], third),
                    (b[0], -third),
                    (b[1], -third),
                    (b[2], -third),
                ];
                let sums = [a, b].map(|c| c.iter().map(|v| normal(*v)).sum());
                let condition = self.filled(nodes, self.sided(sums, [a[0], b[0]]), at)?;
                Some(Condition {
                    least: condition.gap + self.clearance,
                    ..condition
                })
            }
        }
    }

    /// Normals of two sides, as they face each other; of layers by where they lay on each other.
    fn sided(&self, [own, other]: [DVec3; 2], of: [u32; 2]) -> [DVec3; 2] {
        match self.layers.sides(of[0], of[1]) {
            None => [own, other],
            Some([before, behind]) => [own.normalize_or_zero() * behind, other.normalize_or_zero() * before],
        }
    }

    /// One along the bisector of two normals, which points from the second side to the first.
    fn filled(&self, nodes: [(u32, f64); 6], [own, other]: [DVec3; 2], at: &[DVec3]) -> Option<Condition> {
        let (own, other) = (own.normalize_or_zero(), other.normalize_or_zero());
        let direction = (other - own).normalize_or_zero();
        if direction == DVec3::ZERO || own.dot(other) > self.style.facing {
            return None;
        }
        Some(Condition {
            nodes,
            direction,
            least: self.least(&nodes),
            shift: 0.0,
            gap: between(&nodes, at).dot(direction),
        })
    }

    /// How far two sides are to be from each other: layers as far as in the rest pose, up to the clearance.
    fn least(&self, nodes: &[(u32, f64); 6]) -> f64 {
        if !self.is_posed {
            return self.clearance;
        }
        let other = nodes
            .iter()
            .find(|(_, factor)| *factor < 0.0)
            .map_or(nodes[0].0, |n| n.0);
        let (own, layers) = (nodes[0].0, self.layers);
        let of_layers = layers.gap(own, other).or_else(|| layers.gap(other, own));
        let at_rest = || REST_PART * between(nodes, &self.mesh.positions).length();
        self.clearance.min(of_layers.unwrap_or_else(at_rest))
    }
}

/// The edges of a face that pass through another one, smaller vertex first.
pub(super) fn edges_through(corners: [u32; 3], own: [DVec3; 3], [a, b, c]: [DVec3; 3]) -> Vec<[u32; 2]> {
    let volume = |a: DVec3, b: DVec3, c: DVec3, d: DVec3| (b - a).cross(c - a).dot(d - a);
    let passes = |p: DVec3, q: DVec3| {
        let sides = [volume(a, b, c, p), volume(a, b, c, q)];
        let around = [volume(p, q, a, b), volume(p, q, b, c), volume(p, q, c, a)];
        sides[0] * sides[1] < 0.0 && (around.iter().all(|v| *v >= 0.0) || around.iter().all(|v| *v <= 0.0))
    };
    let edges = [(0, 1), (1, 2), (2, 0)]
        .into_iter()
        .filter(|&(i, j)| passes(own[i], own[j]));
    edges
        .map(|(i, j)| [corners[i].min(corners[j]), corners[i].max(corners[j])])
        .collect()
}

/// Where two segments are closest to each other, as parameters of each.
pub(super) fn closest_of_segments(p: [DVec3; 2], q: [DVec3; 2]) -> (f64, f64) {
    let (d, e, r) = (p[1] - p[0], q[1] - q[0], p[0] - q[0]);
    let (dd, ee, de, dr, er) = (d.dot(d), e.dot(e), d.dot(e), d.dot(r), e.dot(r));
    let determinant = dd * ee - de * de;
    let mut s = if determinant > 1e-12 * dd * ee {
        ((de * er - dr * ee) / determinant).clamp(0.0, 1.0)
    } else {
        0.5
    };
    let t = if ee > 0.0 { (de * s + er) / ee } else { 0.0 };
    if !(0.0..=1.0).contains(&t) {
        s = if dd > 0.0 {
            ((de * t.clamp(0.0, 1.0) - dr) / dd).clamp(0.0, 1.0)
        } else {
            0.0
        };
    }
    (s, t.clamp(0.0, 1.0))
}
