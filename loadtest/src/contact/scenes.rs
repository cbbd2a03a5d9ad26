//! Poses in which surfaces of a model meet: limbs that bend, and thick shapes that are folded.
//!
//! A limb is found on the surface alone. Its tip is the vertex that is farthest along edges from the middle of the model and from the tips
//! before it. Its joint lies half way to the middle. What is free is as long on either side of the joint as the limb is thick there.

use crate::models::write_obj;
use glam::DVec3;
use pliant::asset::{FileSet, shapes};
use pliant::engine::{Handle, HandlePose, Region};
use pliant::mesh::{Lists, Mesh};
use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

/// Limbs of a model.
const LIMBS: usize = 5;
/// Where the joint is, between the tip (0) and the middle of the model (1).
const JOINT: f64 = 0.5;
/// How far what is free reaches on either side of the joint, radii of the limb there.
const FREE: f64 = 1.0;
/// Angles that a limb is bent by, degrees.
const BENDS: [f64; 5] = [150.0, 130.0, 110.0, 90.0, 70.0];

/// A part of a surface that turns, and one that stays.
pub(super) struct ContactScene {
    /// Solver vertices that stay,
    pub held: Vec<u32>,
    /// and those that turn,
    pub turned: Vec<u32>,
    /// about this point,
    pub pivot: DVec3,
    /// and this direction,
    pub axis: DVec3,
    /// by the first of these angles that will do, degrees.
    pub angles: Vec<f64>,
}

impl ContactScene {
    /// The limbs of a model, farthest tip first.
    pub fn limbs(mesh: &Mesh) -> Vec<Self> {
        let neighbours = neighbours(mesh);
        let mean = mesh.positions.iter().sum::<DVec3>() / mesh.positions.len() as f64;
        let near = |v: &usize| mesh.positions[*v].distance_squared(mean);
        let middle = (0..mesh.positions.len()).min_by(|a, b| near(a).total_cmp(&near(b)));
        let Some(middle) = middle else {
            return Vec::new();
        };
        let from_middle = along_edges(mesh, &neighbours, middle);
        let mut nearest = from_middle.clone();
        let mut limbs = Vec::new();
        for _ in 0..LIMBS {
            let reached = |v: &usize| if nearest[*v].is_finite() { nearest[*v] } else { 0.0 };
            let Some(tip) = (0..nearest.len()).max_by(|a, b| reached(a).total_cmp(&reached(b))) else {
                break;
            };
            let from_tip = along_edges(mesh, &neighbours, tip);
            limbs.extend(Self::limb(mesh, &from_tip, JOINT * from_middle[tip]));
            nearest.iter_mut().zip(&from_tip).for_each(|(a, b)| *a = a.min(*b));
        }
        limbs
    }

    /// The limb with so many lengths along edges from its tip, and its joint at one of them.
    fn limb(mesh: &Mesh, from_tip: &[f64], joint: f64) -> Option<Self> {
        let those = |wanted: &dyn Fn(f64) -> bool| -> Vec<u32> {
            (0u32..)
                .zip(from_tip)
                .filter(|(_, d)| wanted(**d))
                .map(|(v, _)| v)
                .collect()
        };
        let middle_of =
            |some: &[u32]| some.iter().map(|v| mesh.positions[*v as usize]).sum::<DVec3>() / some.len() as f64;
        let band = those(&|d| (d - joint).abs() < 0.1 * joint);
        let pivot = middle_of(&band);
        let away = band
            .iter()
            .map(|v| mesh.positions[*v as usize].distance(pivot))
            .sum::<f64>();
        let free = FREE * away / band.len() as f64;
        let turned = those(&|d| d <= joint - free);
        let held = those(&|d| d >= joint + free);
        if band.is_empty() || turned.len() < 3 || held.len() < 3 {
            return None;
        }
        let along = (middle_of(&turned) - pivot).normalize_or_zero();
        Some(Self {
            pivot,
            axis: along.any_orthonormal_vector(),
            held,
            turned,
            angles: BENDS.to_vec(),
        })
    }

    /// The handles of the two parts.
    pub fn handles(&self, mesh: &Mesh) -> Vec<Handle> {
        let listed = |some: &[u32]| Region::Vertices {
            indices: some.iter().flat_map(|v| mesh.render_vertices_of(*v)).copied().collect(),
            ranges: Vec::new(),
        };
        vec![
            Handle::new("held", listed(&self.held)),
            Handle::new("turned", listed(&self.turned)),
        ]
    }

    /// The pose of the part that turns.
    pub fn pose(&self, degrees: f64) -> HandlePose {
        HandlePose::rotation(self.axis * degrees.to_radians()).about(self.pivot)
    }
}

/// A thick shape along z whose end is folded over, and pressed into its side.
pub(super) struct FoldedShape {
    pub name: &'static str,
    /// The file of the shape.
    pub files: FileSet,
    /// What lies below this along z stays,
    below: f64,
    /// what lies above this turns,
    above: f64,
    /// about a line across the shape at this height,
    hinge: f64,
    /// so far inside of the side x = 0,
    inside: f64,
    degrees: f64,
}

impl FoldedShape {
    /// Bars, and hands whose fingertips are pressed into the palm.
    pub fn all() -> Vec<Self> {
        let fold = |name, shape: &shapes::Shape, [below, above, hinge]: [f64; 3], inside, degrees| Self {
            name,
            files: FileSet::single("folded.obj", write_obj(&shape.0, &shape.1)),
            below,
            above,
            hinge,
            inside,
            degrees,
        };
        let square = shapes::box_with_cells(DVec3::new(1.0, 1.0, 8.0), [8, 8, 64]);
        let broad = shapes::box_with_cells(DVec3::new(1.0, 2.0, 8.0), [8, 16, 64]);
        let mut round = shapes::cylinder(0.5, 8.0, 32, 64, true);
        round.0.iter_mut().for_each(|p| p.x += 0.5);
        let (hand, bar) = (hand(), [1.5, 7.0, 5.0]);
        vec![
            fold("square bar", &square, bar, 0.25, 178.0),
            fold("square bar", &square, bar, 0.35, 178.0),
            fold("square bar", &square, bar, 0.35, 172.0),
            fold("broad bar", &broad, bar, 0.25, 178.0),
            fold("broad bar", &broad, bar, 0.35, 178.0),
            fold("round bar", &round, bar, 0.35, 178.0),
            fold("hand", &hand, [0.3, 1.7, 1.2], 0.07, 178.0),
            fold("hand", &hand, [0.3, 1.7, 1.2], 0.10, 178.0),
            fold("hand", &hand, [0.2, 1.5, 1.1], 0.07, 178.0),
            fold("hand", &hand, [0.2, 1.5, 1.1], 0.10, 178.0),
        ]
    }

    /// What stays and what turns.
    pub fn scene(&self, mesh: &Mesh) -> ContactScene {
        let those = |wanted: &dyn Fn(f64) -> bool| -> Vec<u32> {
            let all = (0u32..).zip(&mesh.positions);
            all.filter(|(_, p)| wanted(p.z)).map(|(v, _)| v).collect()
        };
        ContactScene {
            held: those(&|z| z <= self.below),
            turned: those(&|z| z >= self.above),
            pivot: DVec3::new(self.inside, 0.0, self.hinge),
            axis: DVec3::NEG_Y,
            angles: vec![self.degrees],
        }
    }
}

/// A palm with four fingers along z, made of cubes whose surface is smoothed.
fn hand() -> shapes::Shape {
    const CELL: f64 = 0.03;
    const THICK: i32 = 8;
    const PALM: [i32; 2] = [33, 33];
    const FINGERS: [i32; 4] = [62, 66, 68, 60];
    let is_inside = |[x, y, z]: [i32; 3]| {
        let is_finger = y % 9 < 6 && FINGERS.get((y / 9) as usize).is_some_and(|end| z < *end);
        (0..THICK).contains(&x) && (0..PALM[0]).contains(&y) && z >= 0 && (z < PALM[1] || is_finger)
    };
    let mut numbers = BTreeMap::new();
    let mut corner = |at: [i32; 3]| {
        let next = numbers.len() as u32;
        *numbers.entry(at).or_insert(next)
    };
    let mut triangles = Vec::new();
    for cell in (0..THICK).flat_map(|x| (0..PALM[0]).flat_map(move |y| (0..68).map(move |z| [x, y, z]))) {
        for side in (0..6).filter(|_| is_inside(cell)) {
            let (axis, step) = (side / 2, side as i32 % 2);
            let mut beside = cell;
            beside[axis] += 2 * step - 1;
            if is_inside(beside) {
                continue;
            }
            let mut quad = [[0, 0], [1, 0], [1, 1], [0, 1]].map(|[u, v]| {
                let mut at = cell;
                at[axis] += step;
                at[(axis + 1) % 3] += u;
                at[(axis + 2) % 3] += v;
                corner(at)
            });
            if step == 0 {
                quad.reverse();
            }
            let [a, b, c, d] = quad;
            triangles.extend([[a, b, c], [a, c, d]]);
        }
    }
    let mut points = vec![DVec3::ZERO; numbers.len()];
    numbers
        .iter()
        .for_each(|(at, v)| points[*v as usize] = DVec3::from_array(at.map(f64::from)) * CELL);
    for _ in 0..3 {
        let mut sums = vec![(DVec3::ZERO, 0.0); points.len()];
        for t in &triangles {
            for k in 0..3 {
                let sum = &mut sums[t[k] as usize];
                *sum = (sum.0 + points[t[(k + 1) % 3] as usize], sum.1 + 1.0);
            }
        }
        points = points
            .iter()
            .zip(sums)
            .map(|(p, (sum, count))| p.lerp(sum / count, 0.5))
            .collect();
    }
    (points, triangles)
}

/// The neighbours of each vertex.
fn neighbours(mesh: &Mesh) -> Lists {
    let around = |t: &[u32; 3]| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]];
    let both = || {
        mesh.triangles
            .iter()
            .flat_map(around)
            .flat_map(|[a, b]| [(a, b), (b, a)])
    };
    Lists::gather(mesh.positions.len(), both)
}

/// How far each vertex is from one along edges; infinite where nothing leads there.
fn along_edges(mesh: &Mesh, neighbours: &Lists, from: usize) -> Vec<f64> {
    let mut lengths = vec![f64::INFINITY; mesh.positions.len()];
    // Numbers that are not negative are in the order of their bits.
    let mut next = BinaryHeap::from([Reverse((0, from))]);
    while let Some(Reverse((bits, v))) = next.pop() {
        let length = f64::from_bits(bits);
        if length >= lengths[v] {
            continue;
        }
        lengths[v] = length;
        for w in neighbours.of(v as u32).iter().map(|w| *w as usize) {
            let there = length + mesh.positions[v].distance(mesh.positions[w]);
            if there < lengths[w] {
                next.push(Reverse((there.to_bits(), w)));
            }
        }
    }
    lengths
}

#[cfg(test)]
mod tests {
    use super::*;
    use pliant::mesh::Weld;

    fn mesh(shape: &shapes::Shape) -> Mesh {
        Mesh::build(&shape.0, &shape.1, Weld::Exact).expect("a surface")
    }

    #[test]
    fn the_hand_is_one_closed_surface() {
        let (points, triangles) = hand();
        let edges = || {
            triangles
                .iter()
                .flat_map(|t| [[t[0], t[1]], [t[1], t[2]], [t[2], t[0]]])
        };
        let all: std::collections::BTreeSet<[u32; 2]> = edges().collect();
        assert_eq!(all.len(), edges().count(), "an edge has one triangle on each side");
        assert!(all.iter().all(|[a, b]| all.contains(&[*b, *a])));
        // V − E + F of a sphere.
        assert_eq!(points.len() + triangles.len(), all.len() / 2 + 2);
    }

    #[test]
    fn a_limb_bends_half_way_between_its_tip_and_the_middle() {
        let bar = mesh(&shapes::box_with_cells(DVec3::new(1.0, 1.0, 8.0), [8, 8, 64]));
        let limbs = ContactScene::limbs(&bar);
        assert_eq!(limbs.len(), LIMBS);
        // The first two tips are the two ends.
        for limb in &limbs[..2] {
            let z = limb.pivot.z;
            assert!((1.5..2.5).contains(&z) || (5.5..6.5).contains(&z), "{z}");
            let height =
                |some: &[u32]| some.iter().map(|v| bar.positions[*v as usize].z).sum::<f64>() / some.len() as f64;
            let [turned, held] = [&limb.turned, &limb.held].map(|some| (height(some) - z) * (z - 4.0));
            assert!(turned > 0.0 && held < 0.0, "{turned}, {held}");
            assert!(limb.turned.iter().all(|v| !limb.held.contains(v)));
            assert!(limb.axis.z.abs() < 0.2 && limb.axis.is_normalized(), "{}", limb.axis);
        }
    }
}
