//! The smoothest displacement of a region that meets conditions: conjugate gradients on a weighted sum of how the displacement
//! stretches and bends, of what conditions miss, squared, and of how far crumpled places are from flat.

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

/// The displacement problem of one round.
pub(super) struct DisplacementProblem<'a> {
    finder: &'a ContactFinder<'a>,
    /// The places of all vertices without displacement.
    base: &'a [DVec3],
    /// By solver vertex, the normal component of the rest shape's curvature.
    rest_bend: &'a [f64],
    /// By node, how far it is to be flattened.
    flat: Vec<f64>,
}

impl<'a> DisplacementProblem<'a> {
    /// Displaces `base`; flat is as far from a plane as the vertices were in the rest pose.
    pub fn new(finder: &'a ContactFinder<'a>, base: &'a [DVec3], rest_bend: &'a [f64]) -> Self {
        Self {
            finder,
            base,
            rest_bend,
            flat: finder.region.nodes.iter().map(|v| finder.flat(*v)).collect(),
        }
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
    }

    fn add_transposed(&self, bend: &[DVec3], out: &mut [DVec3]) {
        let region = self.finder.region;
        for (k, out) in out.iter_mut().enumerate() {
            let others: DVec3 = region.neighbours[k].iter().map(|w| bend[*w as usize]).sum();
            *out += bend[k] * region.degrees[k] - others;
        }
    }

    /// What pulls: conditions, and crumpled places to be flat.
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
        let dot = |a: &[DVec3], b: &[DVec3]| a.iter().zip(b).map(|(a, b)| a.dot(*b)).sum::<f64>();
        let blocks = self.blocks(active);
        let scaled = |r: &[DVec3]| -> Vec<DVec3> { r.iter().zip(&blocks).map(|(r, block)| *block * *r).collect() };
        let mut bend = vec![DVec3::ZERO; self.finder.region.nodes.len()];
        let mut image = vec![DVec3::ZERO; free];
        self.apply(active, moved, &mut bend, &mut image);
        let mut residual: Vec<DVec3> = self.pulls(active).iter().zip(&image).map(|(b, a)| *b - *a).collect();
        let mut z = scaled(&residual);
        let mut way = z.clone();
        let mut rz = dot(&residual, &z);
        let enough = ENOUGH * rz;
        for _ in 0..STEPS {
            exec.check()?;
            if rz <= enough || !rz.is_finite() {
                break;
            }
            self.apply(active, &way, &mut bend, &mut image);
            let step = rz / dot(&way, &image);
            for k in 0..free {
                moved[k] += way[k] * step;
                residual[k] -= image[k] * step;
            }
            z = scaled(&residual);
            let after = dot(&residual, &z);
            for (way, z) in way.iter_mut().zip(&z) {
                *way = *z + *way * (after / rz);
            }
            rz = after;
        }
        Ok(())
    }
}
