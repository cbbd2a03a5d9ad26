//! A model held at one end and turned at the other.

use glam::DVec3;
use pliant_core::engine::{Deformer, Error, Handle, HandlePose, Region};
use pliant_core::exec::Exec;
use pliant_core::mesh::{Mesh, Weld, shading};

/// The longest side of a model, and what lies at its ends.
pub struct LongSide {
    /// 0 for x, 1 for y, 2 for z.
    pub axis: usize,
    low: f64,
    size: f64,
}

/// Which share of the long side each handle holds.
const HELD: f64 = 0.15;

impl LongSide {
    /// Finds it.
    pub fn of(positions: &[DVec3]) -> Self {
        let first = positions[0];
        let low = positions.iter().fold(first, |a, b| a.min(*b));
        let high = positions.iter().fold(first, |a, b| a.max(*b));
        let size = high - low;
        let axis = (0..3).fold(0, |best, k| if size[k] > size[best] { k } else { best });
        Self {
            axis,
            low: low[axis],
            size: size[axis],
        }
    }

    /// A handle at each end.
    pub fn ends(&self) -> [Handle; 2] {
        let along = DVec3::AXES[self.axis];
        [
            Handle::new("base", Region::half_space(-along, -(self.low + HELD * self.size))),
            Handle::new("top", Region::half_space(along, self.low + (1.0 - HELD) * self.size)),
        ]
    }

    /// Sets a handle at each end.
    pub fn hold_ends(&self, deformer: &mut Deformer, exec: &Exec<'_>) -> Result<(), Error> {
        deformer.set_handles(self.ends(), exec)
    }

    /// The top turned about another axis, radians.
    pub fn turn(&self, angle: f64) -> HandlePose {
        HandlePose::rotation(DVec3::AXES[(self.axis + 1) % 3] * angle)
    }

    /// The middle of the box around what the top holds.
    pub fn middle_of_top(&self, positions: &[DVec3]) -> DVec3 {
        let first = positions[0];
        let low = positions.iter().fold(first, |a, b| a.min(*b));
        let high = positions.iter().fold(first, |a, b| a.max(*b));
        let mut middle = 0.5 * (low + high);
        middle[self.axis] = self.low + (1.0 - 0.5 * HELD) * self.size;
        middle
    }

    fn is_held(&self, p: DVec3) -> bool {
        let share = (p[self.axis] - self.low) / self.size;
        !(HELD..=1.0 - HELD).contains(&share)
    }

    /// Triangles that turned over, further than two rings from what the handles hold.
    pub fn free_flips(&self, deformer: &Deformer, now: &[DVec3]) -> usize {
        let mesh = Mesh::build(deformer.rest(), &deformer.geometry().triangles, Weld::Exact).expect("a mesh");
        let of = |s: u32| now[mesh.render_vertices_of(s)[0] as usize];
        let deformed: Vec<DVec3> = (0..mesh.positions.len() as u32).map(of).collect();
        let corners = |shape: &[DVec3], t: &[u32; 3]| t.map(|v| shape[v as usize]);
        let mut gradients = vec![glam::DMat3::ZERO; mesh.positions.len()];
        for t in &mesh.triangles {
            let gradient = shading::area_gradient(corners(&mesh.positions, t), corners(&deformed, t));
            t.iter()
                .for_each(|&v| gradients[v as usize] += gradient.unwrap_or_default());
        }
        let mut near: Vec<bool> = mesh.positions.iter().map(|p| self.is_held(*p)).collect();
        for _ring in 0..2 {
            let was = near.clone();
            let touching = mesh.triangles.iter().filter(|t| t.iter().any(|&v| was[v as usize]));
            touching.flatten().for_each(|&v| near[v as usize] = true);
        }
        let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
        let is_flipped = |t: &&[u32; 3]| {
            let Some(rest) = normal(corners(&mesh.positions, t)).try_normalize() else {
                return false;
            };
            let carried = |v: &u32| {
                (shading::cofactor(&gradients[*v as usize]) * rest)
                    .try_normalize()
                    .unwrap_or(rest)
            };
            let carried: DVec3 = t.iter().map(carried).sum();
            carried.dot(normal(corners(&deformed, t))) < 0.0
        };
        let free = mesh.triangles.iter().filter(|t| t.iter().all(|&v| !near[v as usize]));
        free.filter(is_flipped).count()
    }
}
