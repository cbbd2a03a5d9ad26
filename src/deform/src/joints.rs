//! Joints: the points between handles and what is free around them, which handles turn about by default.
//!
//! The joint of a region is the mean of the graph's edges, each weighing w (u_i − u_j)², its share of the Dirichlet energy of the
//! region's harmonic field, times exp(−½ (d / 2r)²). Here d is the distance from the centre of the region's border, and r the root
//! of the mean square of d over the border. Turned about this point a region arrives with little bending around it; the second
//! factor keeps the point near, where the field falls in far limbs also.

use crate::fields::HarmonicFields;
use crate::shares::map_with_scratch;
use glam::DVec3;
use pliant_exec::pool::Pool;
use pliant_mesh::graph::MeshGraph;

impl HarmonicFields {
    /// The joint of each hold of `regions` (its nodes). `None` for a region without a border or a field that falls nowhere.
    ///
    /// All sums run over fixed pieces in their order.
    pub(crate) fn joints(&self, regions: &[&[u32]], graph: &MeshGraph, pool: &Pool) -> Vec<Option<DVec3>> {
        let Some(shares) = self.sparse() else {
            let mut within = vec![false; graph.nodes()];
            let joint = |(hold, &region): (usize, &&[u32])| {
                region.iter().for_each(|&i| within[i as usize] = true);
                let joint = RegionField::new(graph, region, self.of(hold), &within)?.joint(
                    |border| PointSums::over(region.len(), pool, |k, sum| border(region[k], sum)),
                    |fall| PointSums::over(graph.nodes(), pool, |i, sum| fall(i as u32, &|j| j as usize > i, sum)),
                );
                region.iter().for_each(|&i| within[i as usize] = false);
                joint
            };
            return regions.iter().enumerate().map(joint).collect();
        };
        let fields = shares.by_hold(self.holds(), |_| true);
        let scratch = || (vec![0.0f32; graph.nodes()], vec![false; graph.nodes()]);
        map_with_scratch(regions.len(), pool, scratch, |(field, within), hold| {
            let (region, own) = (regions[hold], &fields[hold]);
            own.iter().for_each(|&(node, u)| field[node as usize] = u);
            region.iter().for_each(|&node| within[node as usize] = true);
            let near = RegionField::new(graph, region, field, within);
            let joint = near.and_then(|near| {
                // An edge counts where it is met first, or where its other end has no say.
                let is_counted = |i: u32| move |j: u32| j > i || near.field[j as usize] == 0.0;
                near.joint(
                    |border| PointSums::of(|sum| region.iter().for_each(|&i| border(i, sum))),
                    |fall| PointSums::of(|sum| own.iter().for_each(|&(i, _)| fall(i, &is_counted(i), sum))),
                )
            });
            own.iter().for_each(|&(node, _)| field[node as usize] = 0.0);
            region.iter().for_each(|&node| within[node as usize] = false);
            joint
        })
    }
}

/// A region and its field.
#[derive(Clone, Copy)]
struct RegionField<'a> {
    graph: &'a MeshGraph,
    /// What sums of points are relative to.
    origin: DVec3,
    /// By node.
    field: &'a [f32],
    /// By node: whether the region has it.
    within: &'a [bool],
}

impl<'a> RegionField<'a> {
    /// `None` where there is no region or no field.
    fn new(graph: &'a MeshGraph, region: &[u32], field: &'a [f32], within: &'a [bool]) -> Option<Self> {
        let origin = graph.positions[*region.first().filter(|_| !field.is_empty())? as usize];
        Some(Self {
            graph,
            origin,
            field,
            within,
        })
    }

    /// The edges of a node: weight, other end, middle.
    fn edges(&self, i: u32) -> impl Iterator<Item = (f64, u32, DVec3)> + '_ {
        let Self { graph, origin, .. } = *self;
        graph.entries(i).zip(graph.row(i)).map(move |(e, &j)| {
            let weight = graph.weights.as_ref().map_or(1.0, |w| f64::from(w[e]));
            let middle = (graph.positions[i as usize] + graph.positions[j as usize]) * 0.5 - origin;
            (weight, j, middle)
        })
    }

    /// The joint. `over_border` sums up what it is given over the nodes of the region, `over_falls` over those of the field, with what
    /// says which of a node's edges count.
    fn joint(
        &self,
        over_border: impl FnOnce(&(dyn Fn(u32, &mut PointSums) + Sync)) -> PointSums,
        over_falls: impl FnOnce(&(dyn Fn(u32, &dyn Fn(u32) -> bool, &mut PointSums) + Sync)) -> PointSums,
    ) -> Option<DVec3> {
        let border = over_border(&|i, sum| {
            for (weight, _, middle) in self.edges(i).filter(|(_, j, _)| !self.within[*j as usize]) {
                sum.add(weight, middle);
            }
        });
        let center = border.mean()?;
        let spread = 8.0 * (border.square / border.weight - center.length_squared()).max(0.0);
        if spread <= 0.0 {
            return Some(self.origin + center);
        }
        let falls = over_falls(&|i, is_counted, sum| {
            for (weight, j, at) in self.edges(i).filter(|(_, j, _)| is_counted(*j)) {
                let fall = f64::from(self.field[i as usize] - self.field[j as usize]);
                sum.add(
                    fall * fall * weight * libm::exp(-at.distance_squared(center) / spread),
                    at,
                );
            }
        });
        falls.mean().map(|joint| self.origin + joint)
    }
}

/// Sums of weighted points.
#[derive(Clone, Copy, Default)]
struct PointSums {
    weight: f64,
    point: DVec3,
    square: f64,
}

impl PointSums {
    /// Adds up what `add` adds for each of `count` items.
    fn over(count: usize, pool: &Pool, add: impl Fn(usize, &mut Self) + Sync) -> Self {
        const PIECE: usize = 8192;
        let pieces = pool.map(count.div_ceil(PIECE), 1, |piece| {
            let mut sum = Self::default();
            (piece * PIECE..((piece + 1) * PIECE).min(count)).for_each(|k| add(k, &mut sum));
            sum
        });
        pieces.iter().fold(Self::default(), |all, own| Self {
            weight: all.weight + own.weight,
            point: all.point + own.point,
            square: all.square + own.square,
        })
    }

    /// What `add` adds up.
    fn of(add: impl FnOnce(&mut Self)) -> Self {
        let mut sum = Self::default();
        add(&mut sum);
        sum
    }

    fn add(&mut self, weight: f64, point: DVec3) {
        self.weight += weight;
        self.point += point * weight;
        self.square += point.length_squared() * weight;
    }

    /// The weighted mean; `None` without weight.
    fn mean(&self) -> Option<DVec3> {
        Some(self.point / self.weight).filter(|mean| self.weight > 0.0 && mean.is_finite())
    }
}
