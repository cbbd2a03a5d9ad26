//! Vertices that triangles join, and means of their weights.
//!
//! Where bones move nearly alike, many weights play a vertex equally well, and fits of neighbours would differ at random. Such fits are
//! drawn to the mean of the weights around, which costs nothing that shows and keeps weights smooth.

use crate::skeleton::BoneInfluences;
use glam::DVec3;
use pliant_exec::Exec;
use pliant_exec::progress::Cancelled;
use rayon::prelude::*;

/// Bones of a mean at most, the heaviest.
const MOST: usize = 12;
/// Vertices that one thread takes in a row.
const RUN: usize = 256;

/// Weights by bone, bones in rising order; they add up to one.
pub(crate) type MeanWeights = Vec<(u16, f64)>;

/// Which vertices of a mesh have an edge in common. Vertices at one place are one.
#[derive(Debug, Clone, Default)]
pub(crate) struct JoinedVertices {
    /// By vertex: its place.
    place: Vec<u32>,
    /// By place: its first vertex.
    first: Vec<u32>,
    /// By place, where its neighbours begin.
    offsets: Vec<u32>,
    /// Places.
    neighbours: Vec<u32>,
}

impl JoinedVertices {
    /// Finds them; `rest` has a position for each vertex. Triangles of vertices that are not there are left out.
    pub(crate) fn of_triangles(rest: &[DVec3], triangles: &[[u32; 3]]) -> Self {
        let bits = |v: u32| rest[v as usize].to_array().map(|c| (c + 0.0).to_bits());
        let mut order: Vec<u32> = (0..rest.len() as u32).collect();
        order.sort_by_key(|v| (bits(*v), *v));
        let (mut place, mut first) = (vec![0; rest.len()], Vec::new());
        for (k, v) in order.iter().enumerate() {
            if k == 0 || bits(order[k - 1]) != bits(*v) {
                first.push(*v);
            }
            place[*v as usize] = first.len() as u32 - 1;
        }
        let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(6 * triangles.len());
        for t in triangles
            .iter()
            .filter(|t| t.iter().all(|v| (*v as usize) < rest.len()))
        {
            let [a, b, c] = t.map(|v| place[v as usize]);
            for (p, q) in [(a, b), (b, c), (c, a)] {
                pairs.extend([(p, q), (q, p)].into_iter().filter(|pair| pair.0 != pair.1));
            }
        }
        pairs.sort_unstable();
        pairs.dedup();
        let mut offsets = vec![0; first.len() + 1];
        pairs.iter().for_each(|pair| offsets[pair.0 as usize + 1] += 1);
        (1..offsets.len()).for_each(|k| offsets[k] += offsets[k - 1]);
        Self {
            place,
            first,
            offsets,
            neighbours: pairs.into_iter().map(|pair| pair.1).collect(),
        }
    }

    /// Whether no vertices are joined.
    pub(crate) fn is_empty(&self) -> bool {
        self.neighbours.is_empty()
    }

    /// The vertices in rising order that are on an edge across which a weight changes by more than `jump`, and those up to `rings`
    /// edges away.
    pub(crate) fn beside_jumps(&self, influences: &[BoneInfluences], jump: f64, rings: usize) -> Vec<u32> {
        let own = |place: usize| &influences[self.first[place] as usize];
        let around = |place: usize| {
            let range = self.offsets[place] as usize..self.offsets[place + 1] as usize;
            self.neighbours[range].iter().map(|n| *n as usize)
        };
        let mut is_near: Vec<bool> = (0..self.first.len())
            .map(|place| around(place).any(|other| largest_change(own(place), own(other)) > jump))
            .collect();
        for _ in 0..rings {
            is_near = (0..is_near.len())
                .map(|place| is_near[place] || around(place).any(|other| is_near[other]))
                .collect();
        }
        (0..self.place.len() as u32)
            .filter(|vertex| is_near[self.place[*vertex as usize] as usize])
            .collect()
    }

    /// By vertex, the mean of the weights around it: each takes that of its neighbours so many times.
    pub(crate) fn means(
        &self,
        influences: &[BoneInfluences],
        sweeps: usize,
        exec: &Exec<'_>,
    ) -> Result<Vec<MeanWeights>, Cancelled> {
        let own = |v: &u32| {
            let mut weights: MeanWeights = influences[*v as usize].iter().map(|(b, w)| (b as u16, w)).collect();
            weights.sort_unstable_by_key(|w| w.0);
            weights
        };
        let mut means: Vec<MeanWeights> = self.first.iter().map(own).collect();
        exec.pool.install(|| {
            for _ in 0..sweeps {
                let all = (0..means.len()).into_par_iter().with_min_len(RUN);
                means = all
                    .map(|place| {
                        exec.check()?;
                        let range = self.offsets[place] as usize..self.offsets[place + 1] as usize;
                        let around = self.neighbours[range].iter().map(|n| &means[*n as usize]);
                        Ok(mean_of(around.chain([&means[place]])))
                    })
                    .collect::<Result<_, Cancelled>>()?;
            }
            Ok::<_, Cancelled>(())
        })?;
        Ok(self.place.iter().map(|place| means[*place as usize].clone()).collect())
    }
}

/// The largest difference of a bone's weight between two vertices.
fn largest_change(a: &BoneInfluences, b: &BoneInfluences) -> f64 {
    let weight = |of: &BoneInfluences, bone: usize| of.iter().find(|own| own.0 == bone).map_or(0.0, |own| own.1);
    let bones = a.iter().chain(b.iter()).map(|own| own.0);
    bones
        .map(|bone| (weight(a, bone) - weight(b, bone)).abs())
        .fold(0.0, f64::max)
}

/// The mean of several, of its heaviest bones.
fn mean_of<'a>(several: impl Iterator<Item = &'a MeanWeights>) -> MeanWeights {
    let mut all: MeanWeights = several.flatten().copied().collect();
    // Stable, so that sums are formed in the order of neighbours.
    all.sort_by_key(|w| w.0);
    let mut sums: MeanWeights = Vec::with_capacity(all.len());
    for (bone, weight) in all {
        match sums.last_mut().filter(|last| last.0 == bone) {
            Some(last) => last.1 += weight,
            None => sums.push((bone, weight)),
        }
    }
    sums.sort_unstable_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    sums.truncate(MOST);
    let whole: f64 = sums.iter().map(|w| w.1).sum();
    if whole > 0.0 {
        sums.iter_mut().for_each(|w| w.1 /= whole);
    }
    sums.sort_unstable_by_key(|w| w.0);
    sums.shrink_to_fit();
    sums
}
