//! Points with the neighbourhoods that they follow, and the carrier of one deformed shape.

use crate::exec::Exec;
use crate::mesh::carry::clusters::CarrySurface;
use crate::mesh::carry::motion::{CarriedFrame, SurfaceMotion};
use crate::mesh::carry::neighbourhood::Neighbourhood;
use crate::pool::Pool;
use crate::progress::Cancelled;
use glam::DVec3;
use rayon::prelude::*;
use std::sync::Arc;

/// Points that one piece of parallel work takes.
const BATCH: usize = 64;

/// Points of rest space with what they follow, found once and carried into many shapes: a shape then costs one short sum
/// for each point.
#[derive(Debug, Clone, Default)]
pub struct CarriedPoints {
    points: Vec<DVec3>,
    /// From the mean place of what a point follows to the point.
    levers: Vec<DVec3>,
    /// Where the samples of each point begin; one more than there are points.
    first: Vec<usize>,
    samples: Vec<u32>,
    weights: Vec<f64>,
}

impl CarriedPoints {
    /// Finds what each of `points` follows on `surface`, in about `log n` time each; where triangles are as long as the surface it
    /// may look at each of them, and each point may follow all.
    ///
    /// # Errors
    /// [`Cancelled`], one point after the work was given up.
    pub fn bind(surface: &CarrySurface, points: &[DVec3], exec: &Exec<'_>) -> Result<Self, Cancelled> {
        let mut all = Self::default();
        all.bind_more(surface, points, exec)?;
        Ok(all)
    }

    /// Adds points, as [`CarriedPoints::bind`] finds what they follow. Answers how many parts of the surface it looked at.
    ///
    /// # Errors
    /// As there; nothing is added then.
    pub(crate) fn bind_more(
        &mut self,
        surface: &CarrySurface,
        points: &[DVec3],
        exec: &Exec<'_>,
    ) -> Result<u64, Cancelled> {
        let batches: Vec<(Self, u64)> = exec.pool.install(|| {
            let batches = points.par_chunks(BATCH);
            batches
                .map(|batch| Self::bind_batch(surface, batch, exec))
                .collect::<Result<_, _>>()
        })?;
        if self.first.is_empty() {
            self.first.push(0);
        }
        let mut visits = 0;
        for (batch, own_visits) in batches {
            let begin = self.samples.len();
            self.points.extend(batch.points);
            self.levers.extend(batch.levers);
            self.first.extend(batch.first.iter().skip(1).map(|end| begin + end));
            self.samples.extend(batch.samples);
            self.weights.extend(batch.weights);
            visits += own_visits;
        }
        Ok(visits)
    }

    fn bind_batch(surface: &CarrySurface, points: &[DVec3], exec: &Exec<'_>) -> Result<(Self, u64), Cancelled> {
        let mut bound = Self {
            points: points.to_vec(),
            first: vec![0],
            ..Self::default()
        };
        let mut around = Neighbourhood::default();
        for &point in points {
            exec.check()?;
            around.gather(surface, point);
            bound.levers.push(lever(surface, &around, point));
            bound.samples.extend(around.samples.iter().map(|s| s.0));
            bound.weights.extend(around.samples.iter().map(|s| s.1));
            bound.first.push(bound.samples.len());
        }
        Ok((bound, around.visits))
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no points.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }

    /// Carries every point along with `motion`, in order. `motion` must be of the surface that the points were bound to.
    ///
    /// # Panics
    /// When `motion` is of a surface with fewer samples.
    pub fn carried_by(&self, motion: &SurfaceMotion, pool: &Pool) -> Vec<CarriedFrame> {
        let carry_point = |i: usize| {
            let followed = self.first[i]..self.first[i + 1];
            let samples = self.samples[followed.clone()]
                .iter()
                .zip(&self.weights[followed.clone()]);
            match followed.is_empty() {
                true => CarriedFrame::resting(self.points[i]),
                false => motion.carry_along(self.points[i], self.levers[i], samples.map(|(&s, &w)| (s, w))),
            }
        };
        pool.install(|| {
            let points = (0..self.points.len()).into_par_iter().with_min_len(BATCH);
            points.map(carry_point).collect()
        })
    }

    /// Bytes held on the heap.
    pub fn byte_size(&self) -> usize {
        (self.points.capacity() + self.levers.capacity()) * size_of::<DVec3>()
            + self.first.capacity() * size_of::<usize>()
            + self.samples.capacity() * size_of::<u32>()
            + self.weights.capacity() * size_of::<f64>()
    }
}

/// Carries points of rest space along with one deformed shape of a surface.
///
/// ```
/// use glam::DVec3;
/// use pliant_core::asset::shapes::box_with_cells;
/// use pliant_core::mesh::carry::SurfaceCarrier;
/// use pliant_core::pool::Pool;
///
/// let (rest, triangles) = box_with_cells(DVec3::ONE, [4, 4, 4]);
/// // Twice as large and moved: what is inside and what is outside follows.
/// let current: Vec<DVec3> = rest.iter().map(|p| *p * 2.0 + DVec3::X).collect();
/// let carrier = SurfaceCarrier::new(&triangles, &rest, &current, &Pool::new(1).expect("a thread"));
/// for point in [DVec3::splat(0.2), DVec3::splat(-3.0)] {
///     let carried = carrier.carry_point(point);
///     assert!(carried.position.distance(point * 2.0 + DVec3::X) < 1e-9);
///     assert!((carried.scale - 2.0).abs() < 1e-9);
/// }
/// ```
#[derive(Debug, Clone)]
pub struct SurfaceCarrier {
    surface: Arc<CarrySurface>,
    motion: SurfaceMotion,
}

impl SurfaceCarrier {
    /// Measures how the surface of `triangles` over `rest` has become `current`: a pure function of the three.
    ///
    /// # Panics
    /// When a triangle names a position that does not exist, or `current` is shorter than `rest`.
    pub fn new(triangles: &[[u32; 3]], rest: &[DVec3], current: &[DVec3], pool: &Pool) -> Self {
        Self::of_surface(Arc::new(CarrySurface::build(rest, triangles, pool)), current, pool)
    }

    /// As [`SurfaceCarrier::new`], with a surface that is known already.
    ///
    /// # Panics
    /// When `current` is shorter than the surface has vertices.
    pub fn of_surface(surface: Arc<CarrySurface>, current: &[DVec3], pool: &Pool) -> Self {
        let motion = SurfaceMotion::between(&surface, current, pool);
        Self { surface, motion }
    }

    /// Carries one point.
    pub fn carry_point(&self, point: DVec3) -> CarriedFrame {
        self.carry_around(&mut Neighbourhood::default(), point)
    }

    /// Carries points, in order. One point takes about `log n` time; where triangles are as long as the surface it may look at each.
    ///
    /// # Errors
    /// [`Cancelled`], one point after the work was given up.
    pub fn carry_points(&self, points: &[DVec3], exec: &Exec<'_>) -> Result<Vec<CarriedFrame>, Cancelled> {
        exec.pool.install(|| {
            let points = points.par_iter().with_min_len(BATCH);
            points
                .map_init(Neighbourhood::default, |around, &point| {
                    exec.check()?;
                    Ok(self.carry_around(around, point))
                })
                .collect()
        })
    }

    fn carry_around(&self, around: &mut Neighbourhood, point: DVec3) -> CarriedFrame {
        around.gather(&self.surface, point);
        if around.samples.is_empty() {
            return CarriedFrame::resting(point);
        }
        let lever = lever(&self.surface, around, point);
        self.motion.carry_along(point, lever, around.samples.iter().copied())
    }
}

/// From the mean place of what a point follows to the point.
fn lever(surface: &CarrySurface, around: &Neighbourhood, point: DVec3) -> DVec3 {
    let place = |&(sample, weight): &(u32, f64)| (surface.sample_place(sample) - point) * weight;
    -around.samples.iter().map(place).sum::<DVec3>()
}
