//! Edits of plain meshes, made by hand for tests.
#![allow(dead_code)]

use glam::DVec3;
use pliant::graph::{MeshChange, MeshGraph};
use std::collections::{BTreeMap, BTreeSet};

/// Points and triangles; every point is used.
#[derive(Clone, Default)]
pub struct Surface {
    pub points: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
}

/// What is to be done: faces that go, points that come (numbered on from the old ones), faces that come, points that move.
#[derive(Clone, Default)]
pub struct Plan {
    pub removed: Vec<u32>,
    pub points: Vec<DVec3>,
    pub faces: Vec<[u32; 3]>,
    pub moved: Vec<(u32, DVec3)>,
}

impl Plan {
    /// Faces that go, and nothing else.
    pub fn without(removed: Vec<u32>) -> Self {
        Self {
            removed,
            ..Self::default()
        }
    }
}

/// A surface after an edit, with what led to it.
pub struct Edited {
    pub surface: Surface,
    pub old_from_new: Vec<u32>,
    pub removed: Vec<[u32; 3]>,
    pub added: Vec<u32>,
    pub moved: Vec<u32>,
}

pub const NONE: u32 = u32::MAX;

impl Edited {
    pub fn change(&self) -> MeshChange<'_> {
        MeshChange {
            positions: &self.surface.points,
            triangles: &self.surface.faces,
            old_from_new: &self.old_from_new,
            removed: &self.removed,
            added: &self.added,
            moved: &self.moved,
        }
    }

    /// Corners of everything that changed, in the places before and after.
    pub fn changed_places(&self, before: &Surface) -> Vec<DVec3> {
        let mut places: Vec<DVec3> = self
            .removed
            .iter()
            .flatten()
            .map(|&v| before.points[v as usize])
            .collect();
        let added = self.added.iter().flat_map(|&t| self.surface.faces[t as usize]);
        places.extend(added.map(|v| self.surface.points[v as usize]));
        let moved: BTreeSet<u32> = self.moved.iter().copied().collect();
        for t in self
            .surface
            .faces
            .iter()
            .filter(|t| t.iter().any(|v| moved.contains(v)))
        {
            places.extend(t.iter().map(|&v| self.surface.points[v as usize]));
            let old = t.iter().map(|&v| self.old_from_new[v as usize]).filter(|&o| o != NONE);
            places.extend(old.map(|o| before.points[o as usize]));
        }
        places
    }
}

impl Surface {
    pub fn of((points, faces): (Vec<DVec3>, Vec<[u32; 3]>)) -> Self {
        Self { points, faces }
    }

    pub fn shape(&self) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        (self.points.clone(), self.faces.clone())
    }

    /// The vertices within `rings` edges of `seed`.
    pub fn disc(&self, seed: u32, rings: usize) -> BTreeSet<u32> {
        let around = self.neighbours();
        let mut disc = BTreeSet::from([seed]);
        let mut front = vec![seed];
        for _ in 0..rings {
            let mut next = Vec::new();
            for v in front {
                next.extend(around[v as usize].iter().copied().filter(|&w| disc.insert(w)));
            }
            front = next;
        }
        disc
    }

    pub fn neighbours(&self) -> Vec<Vec<u32>> {
        let mut around = vec![Vec::new(); self.points.len()];
        for &[a, b, c] in &self.faces {
            for (v, w) in [(a, b), (b, c), (c, a), (b, a), (c, b), (a, c)] {
                if !around[v as usize].contains(&w) {
                    around[v as usize].push(w);
                }
            }
        }
        around
    }

    /// The faces whose corners are all wanted.
    pub fn faces_in(&self, wanted: impl Fn(u32) -> bool) -> Vec<u32> {
        let faces = (0u32..).zip(&self.faces).filter(|(_, t)| t.iter().all(|&v| wanted(v)));
        faces.map(|f| f.0).collect()
    }

    pub fn mean_edge(&self) -> f64 {
        let sum: f64 = self
            .faces
            .iter()
            .map(|t| self.points[t[0] as usize].distance(self.points[t[1] as usize]))
            .sum();
        sum / self.faces.len() as f64
    }

    /// Loops of the edges that the faces left by `removed` lack, each turned as the faces that go had it.
    pub fn rims(&self, removed: &[u32]) -> Vec<Vec<u32>> {
        let gone: BTreeSet<u32> = removed.iter().copied().collect();
        let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
        for (t, &[a, b, c]) in (0u32..).zip(&self.faces) {
            if gone.contains(&t) {
                for (v, w) in [(a, b), (b, c), (c, a)] {
                    *edges.entry((v, w)).or_default() += 1;
                    *edges.entry((w, v)).or_default() -= 1;
                }
            }
        }
        let mut next: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
        for ((v, w), _) in edges.into_iter().filter(|e| e.1 > 0) {
            next.entry(v).or_default().push(w);
        }
        let mut rims = Vec::new();
        while let Some((&first, _)) = next.iter().find(|n| !n.1.is_empty()) {
            let mut rim = vec![first];
            let mut here = first;
            while let Some(to) = next.get_mut(&here).and_then(Vec::pop) {
                if to == first {
                    break;
                }
                rim.push(to);
                here = to;
            }
            rims.push(rim);
        }
        rims
    }

    pub fn apply(&self, plan: &Plan) -> Edited {
        let gone: BTreeSet<u32> = plan.removed.iter().copied().collect();
        let kept = (0u32..).zip(&self.faces).filter(|t| !gone.contains(&t.0)).map(|t| *t.1);
        let mut faces: Vec<[u32; 3]> = kept.collect();
        let first_added = faces.len() as u32;
        faces.extend_from_slice(&plan.faces);
        let mut points = self.points.clone();
        plan.moved.iter().for_each(|&(v, p)| points[v as usize] = p);
        points.extend_from_slice(&plan.points);
        let mut used = vec![false; points.len()];
        faces.iter().flatten().for_each(|&v| used[v as usize] = true);
        let mut number = vec![NONE; points.len()];
        let (mut now, mut old_from_new) = (Vec::new(), Vec::new());
        for (v, &p) in points.iter().enumerate().filter(|v| used[v.0]) {
            number[v] = now.len() as u32;
            now.push(p);
            old_from_new.push(if v < self.points.len() { v as u32 } else { NONE });
        }
        let moved = plan.moved.iter().map(|m| number[m.0 as usize]).filter(|&v| v != NONE);
        let mut moved: Vec<u32> = moved.collect();
        moved.sort_unstable();
        let faces: Vec<[u32; 3]> = faces.into_iter().map(|t| t.map(|v| number[v as usize])).collect();
        Edited {
            added: (first_added..faces.len() as u32).collect(),
            surface: Surface { points: now, faces },
            old_from_new,
            removed: plan.removed.iter().map(|&t| self.faces[t as usize]).collect(),
            moved,
        }
    }

    /// Takes out a disc and fills it with as many new points, moved along `shift`, and turned diagonals where that keeps
    /// the surface sound.
    pub fn refill(&self, seed: u32, rings: usize, shift: DVec3) -> Plan {
        let disc = self.disc(seed, rings);
        let removed = self.faces_in(|v| disc.contains(&v));
        let rim: BTreeSet<u32> = self.rims(&removed).into_iter().flatten().collect();
        let inner: BTreeSet<u32> = removed
            .iter()
            .flat_map(|&t| self.faces[t as usize])
            .filter(|v| !rim.contains(v))
            .collect();
        let mut new = BTreeMap::new();
        let mut points = Vec::new();
        for &v in &inner {
            new.insert(v, (self.points.len() + points.len()) as u32);
            points.push(self.points[v as usize] + shift);
        }
        let to = |v: u32| new.get(&v).copied().unwrap_or(v);
        let faces = removed.iter().map(|&t| self.faces[t as usize].map(to)).collect();
        Plan {
            removed,
            points,
            faces,
            moved: Vec::new(),
        }
    }

    /// Takes out a disc and closes it with a fan.
    pub fn collapse(&self, seed: u32, rings: usize) -> Plan {
        let disc = self.disc(seed, rings);
        self.capped(self.faces_in(|v| disc.contains(&v)))
    }

    /// Closes what `removed` opens with fans.
    pub fn capped(&self, removed: Vec<u32>) -> Plan {
        let mut plan = Plan::default();
        for rim in self.rims(&removed) {
            let middle = (self.points.len() + plan.points.len()) as u32;
            plan.points
                .push(rim.iter().map(|&v| self.points[v as usize]).sum::<DVec3>() / rim.len() as f64);
            let next = rim.iter().cycle().skip(1);
            plan.faces.extend(rim.iter().zip(next).map(|(&a, &b)| [a, b, middle]));
        }
        Plan { removed, ..plan }
    }

    /// Moves the points of a disc along `by`, most in its middle.
    pub fn pull(&self, seed: u32, rings: usize, by: DVec3) -> Plan {
        let mut moved = Vec::new();
        let whole = self.disc(seed, rings);
        let far = whole
            .iter()
            .map(|&v| self.points[v as usize].distance(self.points[seed as usize]))
            .fold(0.0, f64::max);
        for v in whole {
            let t = self.points[v as usize].distance(self.points[seed as usize]) / (far * 1.01);
            moved.push((v, self.points[v as usize] + by * (1.0 - t * t) * (1.0 - t * t)));
        }
        Plan {
            moved,
            ..Plan::default()
        }
    }

    /// Splits the faces of a disc into four, those beside it into two.
    pub fn subdivide(&self, seed: u32, rings: usize) -> Plan {
        let disc = self.disc(seed, rings);
        let four: BTreeSet<u32> = self.faces_in(|v| disc.contains(&v)).into_iter().collect();
        let mut plan = Plan::default();
        let mut middles: BTreeMap<(u32, u32), u32> = BTreeMap::new();
        for &t in &four {
            let [a, b, c] = self.faces[t as usize];
            for (v, w) in [(a, b), (b, c), (c, a)] {
                middles.entry((v.min(w), v.max(w))).or_insert_with(|| {
                    plan.points
                        .push((self.points[v as usize] + self.points[w as usize]) * 0.5);
                    (self.points.len() + plan.points.len() - 1) as u32
                });
            }
        }
        for (t, &[a, b, c]) in (0u32..).zip(&self.faces) {
            let m = [(a, b), (b, c), (c, a)].map(|(v, w)| middles.get(&(v.min(w), v.max(w))).copied());
            let corners = [a, b, c];
            match m {
                [None, None, None] => continue,
                [Some(x), Some(y), Some(z)] => plan.faces.extend([[a, x, z], [b, y, x], [c, z, y], [x, y, z]]),
                _ => {
                    // The polygon of corners and middles, as a fan from a middle.
                    let ring: Vec<u32> = (0..3).flat_map(|k| [Some(corners[k]), m[k]]).flatten().collect();
                    let first = ring.iter().position(|v| m.contains(&Some(*v))).expect("a middle");
                    let at = |k: usize| ring[(first + k) % ring.len()];
                    plan.faces
                        .extend((1..ring.len() - 1).map(|k| [at(0), at(k), at(k + 1)]));
                }
            }
            plan.removed.push(t);
        }
        plan
    }

    /// Cuts along the rims of the faces wanted and closes both sides; the rim of the far side is moved by `apart`.
    pub fn cut(&self, far: impl Fn(DVec3) -> bool, apart: impl Fn(DVec3) -> DVec3) -> Plan {
        let removed = self.faces_in(|v| far(self.points[v as usize]));
        let rims = self.rims(&removed);
        let mut plan = self.capped(removed.clone());
        let faces_near = std::mem::take(&mut plan.faces);
        let mut twin: BTreeMap<u32, u32> = BTreeMap::new();
        for &v in rims.iter().flatten() {
            twin.entry(v).or_insert_with(|| {
                plan.points.push(apart(self.points[v as usize]));
                (self.points.len() + plan.points.len() - 1) as u32
            });
        }
        let first_middle = self.points.len() as u32;
        for k in 0..rims.len() as u32 {
            twin.insert(first_middle + k, (self.points.len() + plan.points.len()) as u32);
            plan.points.push(apart(plan.points[k as usize]));
        }
        let to = |v: u32| twin.get(&v).copied().unwrap_or(v);
        let touching = |t: &u32| self.faces[*t as usize].iter().any(|v| twin.contains_key(v));
        plan.removed = removed.iter().copied().filter(touching).collect();
        plan.faces = plan.removed.iter().map(|&t| self.faces[t as usize].map(to)).collect();
        plan.faces
            .extend(faces_near.iter().map(|&[a, b, c]| [to(a), to(c), to(b)]));
        plan.faces.extend(faces_near);
        plan
    }
}

/// A graph as if a deformation had become the rest shape.
pub fn warped(graph: &MeshGraph, to: impl Fn(DVec3) -> DVec3) -> MeshGraph {
    let mut graph = graph.clone();
    graph.positions.iter_mut().for_each(|p| *p = to(*p));
    graph
}
