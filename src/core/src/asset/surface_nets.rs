//! Turns a scalar field into a mesh: naive surface nets (one vertex in each cell that the surface passes, one
//! quadrilateral across each lattice edge that it cuts), then smoothing on the surface.

use glam::{DVec3, USizeVec3};

/// A lattice of cubic cells.
#[derive(Debug, Clone, Copy)]
pub(super) struct Lattice {
    /// Its lowest corner.
    pub low: DVec3,
    /// Edge of a cell.
    pub cell: f64,
    /// Cells along each axis. The surface must not reach the outermost ones.
    pub cells: USizeVec3,
}

impl Lattice {
    fn points(&self) -> USizeVec3 {
        self.cells + 1
    }

    fn index(&self, at: USizeVec3) -> usize {
        let n = self.points();
        (at.x * n.y + at.y) * n.z + at.z
    }

    fn position(&self, at: USizeVec3) -> DVec3 {
        self.low + at.as_dvec3() * self.cell
    }
}

/// The surface where `field` is zero, seen from where it is positive. The field must change by no more than the distance
/// between two points, as signed distances do: blocks of the lattice that the surface cannot reach are not sampled.
pub(super) fn polygonise(field: &dyn Fn(DVec3) -> f64, lattice: Lattice) -> (Vec<DVec3>, Vec<[u32; 3]>) {
    let values = sample(field, lattice);
    let value = |at: USizeVec3| values[lattice.index(at)];
    let mut vertex_of_cell = vec![u32::MAX; values.len()];
    let mut positions = Vec::new();
    for cell in all_below(lattice.cells) {
        let (mut sum, mut cuts) = (DVec3::ZERO, 0.0);
        for (a, b) in cell_edges() {
            let (va, vb) = (value(cell + a), value(cell + b));
            if (va < 0.0) != (vb < 0.0) {
                sum += a.as_dvec3().lerp(b.as_dvec3(), va / (va - vb));
                cuts += 1.0;
            }
        }
        if cuts > 0.0 {
            vertex_of_cell[lattice.index(cell)] = positions.len() as u32;
            positions.push(lattice.position(cell) + sum / cuts * lattice.cell);
        }
    }
    let mut triangles = Vec::new();
    for at in all_below(lattice.cells) {
        for axis in 0..3 {
            let (u, v) = (USizeVec3::AXES[(axis + 1) % 3], USizeVec3::AXES[(axis + 2) % 3]);
            let inside = value(at) < 0.0;
            if at.dot(u) == 0 || at.dot(v) == 0 || inside == (value(at + USizeVec3::AXES[axis]) < 0.0) {
                continue;
            }
            let quad = [at - u - v, at - v, at, at - u].map(|cell| vertex_of_cell[lattice.index(cell)]);
            let [a, b, c, d] = if inside {
                quad
            } else {
                [quad[3], quad[2], quad[1], quad[0]]
            };
            let length = |i: u32, j: u32| positions[i as usize].distance(positions[j as usize]);
            if length(a, c) <= length(b, d) {
                triangles.extend([[a, b, c], [a, c, d]]);
            } else {
                triangles.extend([[a, b, d], [b, c, d]]);
            }
        }
    }
    (positions, triangles)
}

/// The field at the lattice points; far from the surface, some value of the right sign.
fn sample(field: &dyn Fn(DVec3) -> f64, lattice: Lattice) -> Vec<f64> {
    const BLOCK: usize = 4;
    let n = lattice.points();
    let mut values = vec![0.0; n.element_product()];
    let half = DVec3::splat((BLOCK - 1) as f64 * 0.5 * lattice.cell);
    for block in all_below((n + (BLOCK - 1)) / BLOCK) {
        let low = block * BLOCK;
        let middle = field(lattice.position(low) + half);
        let far = middle.abs() > half.length() + lattice.cell;
        for at in all_below((n - low).min(USizeVec3::splat(BLOCK))) {
            values[lattice.index(low + at)] = if far { middle } else { field(lattice.position(low + at)) };
        }
    }
    values
}

/// Evens out the triangles: moves each vertex toward the mean of its neighbours and back onto the surface.
pub(super) fn relax(
    field: &dyn Fn(DVec3) -> f64,
    positions: &mut [DVec3],
    triangles: &[[u32; 3]],
    cell: f64,
    rounds: usize,
) {
    for round in 0..rounds {
        // On the way a single step stays close enough.
        let steps = if round + 1 == rounds { 3 } else { 1 };
        let mut sum = vec![(DVec3::ZERO, 0.0); positions.len()];
        for t in triangles {
            for i in 0..3 {
                let (a, b) = (t[i] as usize, t[(i + 1) % 3] as usize);
                sum[a].0 += positions[b];
                sum[a].1 += 1.0;
            }
        }
        for (position, (sum, count)) in positions.iter_mut().zip(sum) {
            if count > 0.0 {
                *position = onto_surface(field, position.lerp(sum / count, 0.5), cell, steps);
            }
        }
    }
}

/// Newton steps toward the zero of the field, none longer than half a cell.
fn onto_surface(field: &dyn Fn(DVec3) -> f64, mut position: DVec3, cell: f64, steps: usize) -> DVec3 {
    for _ in 0..steps {
        let slope = gradient(field, position, cell);
        if slope.length_squared() > 0.0 {
            let step = slope * (field(position) / slope.length_squared());
            position -= step.clamp_length_max(cell * 0.5);
        }
    }
    position
}

/// The field's gradient by central differences.
pub(super) fn gradient(field: &dyn Fn(DVec3) -> f64, at: DVec3, cell: f64) -> DVec3 {
    let h = cell * 0.05;
    let along = |axis: DVec3| (field(at + axis * h) - field(at - axis * h)) / (2.0 * h);
    DVec3::new(along(DVec3::X), along(DVec3::Y), along(DVec3::Z))
}

fn all_below(n: USizeVec3) -> impl Iterator<Item = USizeVec3> {
    (0..n.x).flat_map(move |x| (0..n.y).flat_map(move |y| (0..n.z).map(move |z| USizeVec3::new(x, y, z))))
}

/// The twelve edges of a cell, as offsets of their ends.
fn cell_edges() -> impl Iterator<Item = (USizeVec3, USizeVec3)> {
    all_below(USizeVec3::splat(2)).flat_map(|a| {
        USizeVec3::AXES
            .into_iter()
            .filter(move |axis| a.dot(*axis) == 0)
            .map(move |axis| (a, a + axis))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::shapes::tests::{boundary_edges, euler, volume};

    #[test]
    fn a_sphere_comes_out_round_closed_and_facing_outward() {
        let field = |p: DVec3| p.length() - 1.0;
        let lattice = Lattice {
            low: DVec3::splat(-1.3),
            cell: 0.1,
            cells: USizeVec3::splat(26),
        };
        let (mut positions, triangles) = polygonise(&field, lattice);
        relax(&field, &mut positions, &triangles, lattice.cell, 3);
        assert!(positions.iter().all(|p| (p.length() - 1.0).abs() < 1e-9));
        let shape = (positions, triangles);
        assert_eq!((boundary_edges(&shape), euler(&shape)), (0, 2));
        assert!((volume(&shape) / (4.0 / 3.0 * std::f64::consts::PI) - 1.0).abs() < 0.01);
    }
}
