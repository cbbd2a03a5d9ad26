//! The smoothest displacement of a region that meets conditions: conjugate gradients on a weighted sum of how the displacement
//! stretches and bends, of what conditions miss, squared, and of how far crumpled places are from flat; where asked for, of what edges
//! lack to their rest lengths and the shape to its volume.

use super::find::{Condition, ContactFinder};
use glam::{DMat3, DVec3};
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;

/// Steps of conjugate gradients.
const STEPS: usize = 40;
/// They end where the residual has fallen to this, squared.
const ENOUGH: f64 = 1e-6;
/// What is asked for at a time, median edges.
const STEP: f64 = 1.2;
/// How far a vertex goes at a time, median edges.
const FARTHEST: f64 = 2.0;
/// What the volume weighs beside stretching of the displacement.
const VOLUME: f64 = 1.0;
/// A shorter edge has no direction to lengthen it in, of its rest length.
const SHORTEST: f64 = 0.1;

/// The displacement problem of one round.
pub(super) struct DisplacementProblem<'a> {
    finder: &'a ContactFinder<'a>,
    /// The places of all vertices without displacement.
    base: &'a [DVec3],
    /// By solver vertex, the normal component of the rest shape's curvature.
    rest_bend: &'a [f64],
    /// By node, how far it is to be flattened.
    flat: Vec<f64>,
    volume: Option<VolumeGoal>,
    /// By free node, what its edges lack to their rest lengths, summed; empty where they may have any.
    lengths: Vec<DVec3>,
}

/// The volume that a displacement is to have: products with the normals, summed, are to be `wanted`.
struct VolumeGoal {
    /// By free node: a third of the area around it along its normal, in squares of the median edge.
    normals: Vec<DVec3>,
    wanted: f64,
    weight: f64,
}

impl<'a> DisplacementProblem<'a> {
    /// Displaces `base`; flat is as far from a plane as the vertices were in the rest pose.
    pub fn new(finder: &'a ContactFinder<'a>, base: &'a [DVec3], rest_bend: &'a [f64]) -> Self {
        Self {
            finder,
            base,
            rest_bend,
            flat: finder.region.nodes.iter().map(|v| finder.flat(*v)).collect(),
            volume: None,
            lengths: Vec::new(),
        }
    }

    /// Keeps the volume of a shape in a pose, going on from `at`, which is the base with `moved`: what is pushed in at one place comes
    /// out around it. Where the surface is open it encloses none, and layers give way.
    pub fn keeping_volume(mut self, of: &[DVec3], at: &[DVec3], moved: &[DVec3]) -> Self {
        let region = self.finder.region;
        let is_solid = !region.has_border && self.finder.layers.is_empty();
        if !self.finder.is_posed || !is_solid || region.free == 0 {
            return self;
        }
        let mut normals = vec![DVec3::ZERO; region.free];
        let origin = at[region.nodes[0] as usize];
        let square = region.edge * region.edge;
        let mut missing = 0.0;
        for t in &region.faces {
            let corners = self.finder.mesh.triangles[*t as usize];
            let places = |shape: &[DVec3]| corners.map(|v| shape[v as usize] - origin);
            let cone = |[a, b, c]: [DVec3; 3]| a.dot(b.cross(c)) / 6.0;
            missing += cone(places(of)) - cone(places(at));
            let [a, b, c] = places(at);
            for v in corners {
                if let Some(normal) = normals.get_mut(region.local[v as usize] as usize) {
                    *normal += (b - a).cross(c - a) / (6.0 * square);
                }
            }
        }
        let squares: f64 = normals.iter().map(|n| n.length_squared()).sum();
        let goal = VolumeGoal {
            wanted: missing / square + sum_of_products(&normals, moved),
            weight: if squares > 0.0 { VOLUME / squares } else { 0.0 },
            normals,
        };
        self.volume = Some(goal);
        self
    }

    /// Brings edges nearer to their rest lengths by a part of what they lack in `at`, along the directions that they have there
    /// (Bouaziz et al., *Projective dynamics*, 2014).
    pub fn restoring_lengths(mut self, at: &[DVec3], part: f64) -> Self {
        let region = self.finder.region;
        let rest = &self.finder.mesh.positions;
        let of_node = |k: usize| {
            let v = region.nodes[k] as usize;
            let lacks = |w: &u32| {
                let w = region.nodes[*w as usize] as usize;
                let (now, length) = (at[v] - at[w], rest[v].distance(rest[w]));
                let wanted = now * (length / now.length().max(SHORTEST * length).max(f64::MIN_POSITIVE));
                (wanted - (self.base[v] - self.base[w])) * part
            };
            region.neighbours[k].iter().map(lacks).sum()
        };
        self.lengths = (0..region.free).map(of_node).collect();
        self
    }

    /// Changes `moved`, by free node, so that it meets conditions better. Which of them hold with equality is chosen so many times.
    ///
    /// # Errors
    /// [`Cancelled`].
    pub fn improve(
        &self,
        mut conditions: Vec<Condition>,
        choices: usize,
        moved: &mut [DVec3],
        exec: &Exec<'_>,
    ) -> Result<(), Cancelled> {
        let edge = self.finder.region.edge;
        for condition in &mut conditions {
            condition.least = (condition.least + condition.shift).min(condition.gap + STEP * edge);
        }
        let before = moved.to_vec();
        for _ in 0..choices {
            let active: Vec<Condition> = (conditions.iter())
                .filter(|condition| self.base_gap(condition) + self.gain(condition, moved) < condition.least)
                .copied()
                .collect();
            self.solve(&active, moved, exec)?;
        }
        let far = moved
            .iter()
            .zip(&before)
            .map(|(now, then)| now.distance(*then))
            .fold(0.0, f64::max);
        if far > FARTHEST * edge {
            for (now, then) in moved.iter_mut().zip(&before) {
                *now = then.lerp(*now, FARTHEST * edge / far);
            }
        }
        Ok(())
    }

    fn base_gap(&self, condition: &Condition) -> f64 {
        let places = condition
            .nodes
            .iter()
            .map(|(v, factor)| self.base[*v as usize] * *factor);
        places.sum::<DVec3>().dot(condition.direction)
    }

    /// What a displacement adds to a condition.
    fn gain(&self, condition: &Condition, moved: &[DVec3]) -> f64 {
        let local = |v: u32| self.finder.region.local[v as usize] as usize;
        let parts = condition
            .nodes
            .iter()
            .filter_map(|(v, factor)| Some(*moved.get(local(*v))? * *factor));
        parts.sum::<DVec3>().dot(condition.direction)
    }

    /// What a missed condition weighs.
    fn weight(&self) -> f64 {
        self.finder.style.stiffness * (6.0 + 42.0 * self.finder.style.bending)
    }

    fn flat(&self, node: usize) -> f64 {
        self.flat[node]
    }

    /// Adds factors of a condition's direction to free nodes.
    fn push(&self, condition: &Condition, by: f64, out: &mut [DVec3]) {
        for (v, factor) in condition.nodes {
            if let Some(out) = out.get_mut(self.finder.region.local[v as usize] as usize) {
                *out += condition.direction * (factor * by);
            }
        }
    }

    /// The gradient of the sum at `moved`, without what does not depend on it.
    fn apply(&self, active: &[Condition], moved: &[DVec3], bend: &mut [DVec3], out: &mut [DVec3]) {
        let region = self.finder.region;
        region.laplace(moved, bend);
        out.copy_from_slice(&bend[..region.free]);
        for (k, bend) in bend.iter_mut().enumerate() {
            *bend *= self.finder.style.bending + self.flat(k);
        }
        self.add_transposed(bend, out);
        for condition in active {
            self.push(condition, self.weight() * self.gain(condition, moved), out);
        }
        if let Some(goal) = &self.volume {
            goal.push(sum_of_products(&goal.normals, moved), out);
        }
    }

    fn add_transposed(&self, bend: &[DVec3], out: &mut [DVec3]) {
        let region = self.finder.region;
        for (k, out) in out.iter_mut().enumerate() {
            let others: DVec3 = region.neighbours[k].iter().map(|w| bend[*w as usize]).sum();
            *out += bend[k] * region.degrees[k] - others;
        }
    }

    /// What pulls: conditions, crumpled places to be flat, lengths, and the volume.
    fn pulls(&self, active: &[Condition]) -> Vec<DVec3> {
        let region = self.finder.region;
        let mut pulls = vec![DVec3::ZERO; region.free];
        // Of the rim not all neighbours are known; it stays anyway.
        let bend: Vec<DVec3> = (0..region.nodes.len())
            .map(|k| match self.flat(k) {
                flat if flat > 0.0 && k < region.free => {
                    let at = |k: usize| self.base[region.nodes[k] as usize];
                    let others: DVec3 = region.neighbours[k].iter().map(|w| at(*w as usize)).sum();
                    let v = region.nodes[k] as usize;
                    (self.finder.normals[v] * self.rest_bend[v] - (at(k) * region.degrees[k] - others)) * flat
                }
                _ => DVec3::ZERO,
            })
            .collect();
        self.add_transposed(&bend, &mut pulls);
        for condition in active {
            let wanted = condition.least - self.base_gap(condition);
            self.push(condition, self.weight() * wanted, &mut pulls);
        }
        for (pull, lack) in pulls.iter_mut().zip(&self.lengths) {
            *pull += *lack;
        }
        if let Some(goal) = &self.volume {
            goal.push(goal.wanted, &mut pulls);
        }
        pulls
    }

    /// The inverse of the part of the equations that is about each node alone.
    fn blocks(&self, active: &[Condition]) -> Vec<DMat3> {
        let region = self.finder.region;
        let own = |k: usize| {
            let degree = region.degrees[k];
            let bend = self.finder.style.bending + self.flat(k);
            DMat3::from_diagonal(DVec3::splat(degree + bend * (degree * degree + degree)))
        };
        let mut blocks: Vec<DMat3> = (0..region.free).map(own).collect();
        for condition in active {
            let d = condition.direction;
            for (v, factor) in condition.nodes {
                if let Some(block) = blocks.get_mut(region.local[v as usize] as usize) {
                    let scaled = d * (factor * factor * self.weight());
                    *block += DMat3::from_cols(scaled * d.x, scaled * d.y, scaled * d.z);
                }
            }
        }
        blocks.into_iter().map(|block| block.inverse()).collect()
    }

    /// Goes to the displacement that the equations of some conditions have.
    fn solve(&self, active: &[Condition], moved: &mut [DVec3], exec: &Exec<'_>) -> Result<(), Cancelled> {
        let free = moved.len();
        let blocks = self.blocks(active);
        let scaled = |r: &[DVec3]| -> Vec<DVec3> { r.iter().zip(&blocks).map(|(r, block)| *block * *r).collect() };
        let mut bend = vec![DVec3::ZERO; self.finder.region.nodes.len()];
        let mut image = vec![DVec3::ZERO; free];
        self.apply(active, moved, &mut bend, &mut image);
        let mut residual: Vec<DVec3> = self.pulls(active).iter().zip(&image).map(|(b, a)| *b - *a).collect();
        let mut z = scaled(&residual);
        let mut way = z.clone();
        let mut rz = sum_of_products(&residual, &z);
        let enough = ENOUGH * rz;
        for _ in 0..STEPS {
            exec.check()?;
            if rz <= enough || !rz.is_finite() {
                break;
            }
            self.apply(active, &way, &mut bend, &mut image);
            let step = rz / sum_of_products(&way, &image);
            for k in 0..free {
                moved[k] += way[k] * step;
                residual[k] -= image[k] * step;
            }
            z = scaled(&residual);
            let after = sum_of_products(&residual, &z);
            for (way, z) in way.iter_mut().zip(&z) {
                *way = *z + *way * (after / rz);
            }
            rz = after;
        }
        Ok(())
    }
}

impl VolumeGoal {
    /// Adds what a sum of products with the normals pulls by.
    fn push(&self, sum: f64, out: &mut [DVec3]) {
        for (out, normal) in out.iter_mut().zip(&self.normals) {
            *out += *normal * (sum * self.weight);
        }
    }
}

fn sum_of_products(a: &[DVec3], b: &[DVec3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum()
}
