//! The rest shape that words are about: its surface, parts, sides, and distances along it.

use super::vertex_set::VertexSet;
use glam::{DMat3, DVec3};
use pliant_core::engine::{Deformer, Error};
use pliant_core::mesh::{Adjacency, Components, Mesh, NONE};
use pliant_exec::Exec;
use pliant_motion::humanoid::BodyAxes;
use std::cell::OnceCell;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Steps of a search between two looks whether the caller has left.
const BETWEEN_LOOKS: usize = 1 << 14;

/// A model's rest shape, seen as a figure that stands upright.
pub(crate) struct RestFigure<'a> {
    /// The model.
    pub deformer: &'a Deformer,
    /// Who waits for the answer.
    pub exec: &'a Exec<'a>,
    /// How it stands.
    pub axes: BodyAxes,
    /// All vertices that a handle can hold: those of triangles that are solved.
    pub all: VertexSet,
    net: OnceCell<Net>,
}

/// How the welded surface hangs together.
struct Net {
    adjacency: Adjacency,
    component: Vec<u32>,
}

impl<'a> RestFigure<'a> {
    /// The rest shape of a model.
    pub fn new(deformer: &'a Deformer, axes: BodyAxes, exec: &'a Exec<'a>) -> Self {
        let count = deformer.rest().len();
        let welded = &deformer.mesh().solver_from_render;
        let mut all = VertexSet::of(count, |v| welded.get(v).is_some_and(|s| *s != NONE));
        for primitive in deformer.geometry().primitives.iter().filter(|p| p.is_passenger) {
            let own = primitive.vertices();
            all = all.minus(&VertexSet::of(count, |v| own.contains(&v)));
        }
        Self {
            deformer,
            exec,
            axes,
            all,
            net: OnceCell::new(),
        }
    }

    /// Number of render vertices.
    pub fn count(&self) -> usize {
        self.deformer.rest().len()
    }

    /// From model space to one where left is x, up y and the front z.
    pub fn upright(&self) -> DMat3 {
        self.axes.upright_from_model()
    }

    pub fn mesh(&self) -> &'a Mesh {
        self.deformer.mesh()
    }

    fn net(&self) -> &Net {
        self.net.get_or_init(|| {
            let mesh = self.mesh();
            Net {
                adjacency: Adjacency::build(mesh.positions.len(), &mesh.triangles),
                component: Components::of_triangles(mesh.positions.len(), &mesh.triangles).of_vertex,
            }
        })
    }

    /// The welded vertices that share an edge with one.
    pub fn neighbours(&self, vertex: u32) -> &[u32] {
        self.net().adjacency.neighbours.of(vertex)
    }

    /// The welded vertices of a set, ascending.
    pub fn welded(&self, set: &VertexSet) -> Vec<u32> {
        let mesh = self.mesh();
        let has = |s: &u32| mesh.render_vertices_of(*s).iter().any(|v| set.has(*v as usize));
        (0..mesh.positions.len() as u32).filter(has).collect()
    }

    /// The render vertices of welded ones that fit.
    pub fn rendered(&self, fits: impl Fn(u32) -> bool) -> VertexSet {
        let welded = &self.mesh().solver_from_render;
        let own = VertexSet::of(self.count(), |v| welded.get(v).is_some_and(|s| *s != NONE && fits(*s)));
        own.and(&self.all)
    }

    /// Connected parts, the largest by area first: number in the order of the file, area, vertices.
    pub fn parts(&self) -> Vec<(usize, f64)> {
        let parts = self.deformer.report().parts.iter().enumerate();
        let mut parts: Vec<(usize, f64)> = parts.map(|(k, part)| (k, part.area)).collect();
        parts.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
        parts
    }

    /// The vertices of a connected part.
    pub fn part(&self, number: usize) -> Option<VertexSet> {
        let first = self.deformer.report().parts.get(number)?.first_vertex;
        let component = &self.net().component;
        let own = component.get(first as usize)?;
        Some(self.rendered(|s| component[s as usize] == *own))
    }

    /// The middle of a set at some positions of the model; `None` of an empty set.
    pub fn center(&self, set: &VertexSet, positions: &[DVec3]) -> Option<DVec3> {
        let list = set.list();
        let sum: DVec3 = list.iter().map(|v| positions[*v as usize]).sum();
        (!list.is_empty()).then(|| sum / list.len() as f64)
    }

    /// Where a region hangs on the rest of the surface: the middle of its border. `None` where it has none.
    pub fn border_middle(&self, set: &VertexSet) -> Option<DVec3> {
        let border = self.border(set);
        let mesh = self.mesh();
        let sum: DVec3 = border.iter().map(|s| mesh.positions[*s as usize]).sum();
        (!border.is_empty()).then(|| sum / border.len() as f64)
    }

    /// The welded vertices of a set with a neighbour outside of it.
    pub fn border(&self, set: &VertexSet) -> Vec<u32> {
        let own = self.welded(set);
        let mut is_own = vec![false; self.mesh().positions.len()];
        own.iter().for_each(|s| is_own[*s as usize] = true);
        let leaves = |s: &u32| self.neighbours(*s).iter().any(|n| !is_own[*n as usize]);
        own.iter().copied().filter(leaves).collect()
    }

    /// Lengths of the shortest ways along edges from any of some welded vertices, as far as `farthest` and inside of `within`;
    /// infinite where none leads.
    ///
    /// # Errors
    /// [`Error::Cancelled`].
    pub fn distances(&self, from: &[u32], within: Option<&[bool]>, farthest: f64) -> Result<Vec<f64>, Error> {
        let places = &self.mesh().positions;
        let mut far = vec![f64::INFINITY; places.len()];
        let mut heap = BinaryHeap::new();
        for &s in from {
            far[s as usize] = 0.0;
            heap.push(Reverse((0u64, s)));
        }
        let mut steps = 0;
        while let Some(Reverse((bits, s))) = heap.pop() {
            steps += 1;
            if steps % BETWEEN_LOOKS == 0 {
                self.exec.check()?;
            }
            // Lengths are not negative, so their bits are in their order.
            let way = f64::from_bits(bits);
            if way > far[s as usize] {
                continue;
            }
            for &next in self.neighbours(s) {
                if within.is_some_and(|within| !within[next as usize]) {
                    continue;
                }
                let longer = way + places[s as usize].distance(places[next as usize]);
                if longer < far[next as usize] && longer <= farthest {
                    far[next as usize] = longer;
                    heap.push(Reverse((longer.to_bits(), next)));
                }
            }
        }
        Ok(far)
    }
}
