//! The mesh while it is remeshed, with what each of its points knows about the original surface.

use super::deviation::{ChangedFaces, DeviationBound, OriginalPoint, OriginalSurface, SLIVER, WORK};
use super::feature_lines::{Chain, ChainPoint, FeatureLines, LineKind};
use crate::region_mesh::{EdgeFaces, RegionMesh, Wedge};
use crate::triangle;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{Error, NONE, sorted_set};

/// No face turns by more than the angle with this cosine (60°) in one step.
const LEAST_COSINE: f64 = 0.5;

/// No step changes more faces than this: it would compare each with what all others lay on, and take long.
const MOST_CHANGED: usize = 256;

/// Cosine of the largest angle between a face and the original one beside it (about 78°).
const FAITHFUL: f64 = 0.2;

/// Where a point is in terms of the original surface.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum PointConstraint {
    /// At an original point that stays.
    Held,
    /// On a line.
    OnLine(ChainPoint),
    /// Inside.
    OnSurface(OriginalPoint),
}

/// A region mesh while it is remeshed, with what each of its points knows about the original surface.
pub(super) struct Remesher<'a> {
    pub mesh: RegionMesh,
    pub original: OriginalSurface,
    pub curves: FeatureLines,
    /// Of each point.
    pub constraints: Vec<PointConstraint>,
    /// Target length at each point.
    pub sizes: Vec<f64>,
    deviation: DeviationBound<'a>,
    /// Which of the gathered faces are not fair; empty when all may change.
    unfair: Vec<bool>,
}

/// What a remesh is begun with, beside the mesh.
pub(super) struct RemeshPlan {
    /// Target length at each point.
    pub sizes: Vec<f64>,
    /// How far the old and the new surface may be from each other.
    pub max_deviation: f64,
    /// Cosine of the angle beyond which edges are sharp.
    pub sharp_cosine: f64,
    /// Which of the gathered faces are not fair; empty when all may change.
    pub unfair: Vec<bool>,
}

impl<'a> Remesher<'a> {
    /// Begins with `mesh` before any change.
    pub fn new(mesh: RegionMesh, plan: RemeshPlan, progress: &'a dyn Progress) -> Self {
        let sizes = plan.sizes;
        let (curves, on, held) = FeatureLines::trace_lines(&mesh, &sizes, plan.sharp_cosine);
        let original = OriginalSurface::from_mesh(&mesh, sizes.clone(), |a, b| curves.chain_segment(a, b).is_none());
        let constraints = (0..mesh.points.len() as u32)
            .map(|p| {
                let point = &mesh.points[p as usize];
                match (on[p as usize], point.faces.first()) {
                    (Some(on), _) => PointConstraint::OnLine(on),
                    (None, Some(&f)) if !point.fixed && !held.contains(&p) => {
                        PointConstraint::OnSurface(original.corner_point(f, p))
                    }
                    _ => PointConstraint::Held,
                }
            })
            .collect();
        Self {
            deviation: DeviationBound::new(&mesh, &sizes, plan.max_deviation, progress),
            unfair: plan.unfair,
            mesh,
            original,
            curves,
            constraints,
            sizes,
        }
    }

    /// Takes the count of triangles that distances were computed to since this was last called.
    pub fn take_work(&mut self) -> usize {
        self.deviation.take_work(&mut self.original)
    }

    /// The largest distance between the old surface and the new one.
    pub fn measure_deviation(&mut self, progress: &dyn Progress) -> Result<f64, Error> {
        let (mesh, constraints) = (&self.mesh, &self.constraints);
        let seeds = |f| seeds_of_face(mesh, constraints, f);
        self.deviation.measure(&mut self.original, mesh, seeds, progress)
    }

    /// Whether some of these faces may change: one of them is not fair, or was changed before.
    pub fn may_change(&self, mut faces: impl Iterator<Item = u32>) -> bool {
        self.unfair.is_empty()
            || faces.any(|f| !self.mesh.faces[f as usize].untouched || self.unfair.get(f as usize) == Some(&true))
    }

    /// Whether the new faces of a change stay near the old surface, and it near them; then it has to be carried out.
    fn stays_near(&mut self, change: &ChangedFaces) -> bool {
        if change.before.len() > MOST_CHANGED {
            return false;
        }
        let seeds: Vec<u32> =
            sorted_set((change.before.iter()).flat_map(|&f| seeds_of_face(&self.mesh, &self.constraints, f)));
        self.deviation.admit(&mut self.original, change, &seeds)
    }

    /// The faces around `p` before and after it moves.
    fn faces_after_move(&self, p: u32, position: DVec3) -> ChangedFaces {
        let faces = self.mesh.faces_around(p);
        let at = |q: u32| if q == p { position } else { self.mesh.position(q) };
        ChangedFaces {
            before: faces.to_vec(),
            after: faces.iter().map(|&f| (f, self.mesh.points_of(f).map(at))).collect(),
            edges: (self.mesh.neighbours(p).into_iter())
                .map(|q| [position, self.mesh.position(q)])
                .collect(),
        }
    }

    /// The faces at an edge before and after it is split at `position`: each is followed by its half at the end `b`, or `a`
    /// to the right.
    fn faces_after_split(&self, edge: EdgeFaces, a: u32, b: u32, position: DVec3) -> ChangedFaces {
        let mut change = ChangedFaces {
            before: edge.faces().collect(),
            edges: vec![[self.mesh.position(a), position], [position, self.mesh.position(b)]],
            ..ChangedFaces::default()
        };
        let mut new = self.mesh.faces.len() as u32;
        for (f, from, to) in [(edge.left, a, b), (edge.right, b, a)] {
            if f == NONE {
                continue;
            }
            let half = |gone: u32| {
                let points = self.mesh.points_of(f);
                points.map(|p| if p == gone { position } else { self.mesh.position(p) })
            };
            change.after.extend([(f, half(to)), (new, half(from))]);
            change
                .edges
                .extend((self.mesh.opposite_corner(f, a, b)).map(|tip| [position, self.mesh.position(tip)]));
            new += 1;
        }
        change
    }

    /// Turns the edge if the pair after it stays near the old surface. [`RegionMesh::faces_after_turn`] must have given `after`.
    pub fn turn_edge(&mut self, edge: EdgeFaces, a: u32, b: u32, after: [[DVec3; 3]; 2]) -> bool {
        let change = ChangedFaces {
            before: vec![edge.left, edge.right],
            after: vec![(edge.left, after[0]), (edge.right, after[1])],
            edges: vec![[after[0][1], after[0][2]]],
        };
        let near = self.stays_near(&change);
        if near {
            self.mesh.turn_edge(edge, a, b);
        }
        near
    }

    /// Length of an edge over the target length there.
    pub fn relative_length(&self, a: u32, b: u32) -> f64 {
        self.mesh.edge_length(a, b) / (0.5 * (self.sizes[a as usize] + self.sizes[b as usize]))
    }

    /// Whether a face with these corners may stand for the original surface beside face `f`.
    pub fn is_faithful(&self, f: u32, corners: [DVec3; 3]) -> bool {
        let there = self.original.face_normal(self.mesh.faces[f as usize].source);
        triangle::cosine(triangle::area_normal(corners), there).is_none_or(|c| c >= FAITHFUL)
    }

    /// Whether a changed face stands against the original one that it lies beside.
    pub fn stands_against(&self, f: u32) -> bool {
        !self.mesh.faces[f as usize].untouched && !self.is_faithful(f, self.mesh.corner_positions(f))
    }

    /// The same as [`is_faithful`](Self::is_faithful), beside the original face that is nearest to the middle of these corners, looked for around face `f`. It
    /// notices when a face would cut off a thin part of the surface.
    pub fn is_faithful_nearby(&mut self, f: u32, corners: [DVec3; 3]) -> bool {
        let middle = (corners[0] + corners[1] + corners[2]) / 3.0;
        let spot = self
            .original
            .find_nearest(middle, &seeds_of_face(&self.mesh, &self.constraints, f));
        let there = self.original.face_normal(spot.face);
        triangle::cosine(triangle::area_normal(corners), there).is_none_or(|c| c >= FAITHFUL)
    }

    /// Faces of the original surface from which to look for a place near point `p`, on one side of all lines.
    pub fn original_seeds(&self, p: u32) -> Vec<u32> {
        let around = self.mesh.faces_around(p).iter();
        let mut seeds: Vec<u32> = around.map(|&f| self.mesh.faces[f as usize].source).collect();
        if let PointConstraint::OnSurface(spot) = self.constraints[p as usize] {
            seeds.insert(0, spot.face);
        }
        seeds.dedup();
        seeds
    }

    /// Splits the edge in its middle, on the original surface. Says whether it could.
    pub fn split_edge(&mut self, a: u32, b: u32) -> bool {
        let edge = self.mesh.edge_faces(a, b);
        if self.mesh.is_locked(edge) || edge.faces().next().is_none() {
            return false;
        }
        match self.curves.chain_segment(a, b) {
            Some(piece) if piece.at[0] <= piece.at[1] => self.split_line_edge(edge, a, b, piece.chain, piece.at),
            Some(piece) => {
                let turned = self.mesh.edge_faces(b, a);
                self.split_line_edge(turned, b, a, piece.chain, [piece.at[1], piece.at[0]])
            }
            None => self.split_inner_edge(edge, a, b),
        }
    }

    fn split_inner_edge(&mut self, edge: EdgeFaces, a: u32, b: u32) -> bool {
        if !self.mesh.is_inside(edge, a, b) {
            return false;
        }
        let middle = (self.mesh.position(a) + self.mesh.position(b)) * 0.5;
        let seeds = [edge.left, edge.right].map(|f| self.mesh.faces[f as usize].source);
        let spot = self.original.find_nearest(middle, &seeds);
        let on_surface = self.original.position_at(spot);
        let position = self.place_split(edge, a, b, on_surface);
        let m = self.mesh.add_point(position);
        let (of, weights) = self.original.blend_at(spot);
        let wedge = self.mesh.add_wedge(Wedge::from_blend(of, weights));
        self.mesh.insert_into_edge(edge, [a, b], m, [wedge; 2]);
        self.constraints.push(PointConstraint::OnSurface(spot));
        self.sizes.push(self.original.target_length_at(spot));
        true
    }

    /// Splits a piece of a chain from `a`, at length `at[0]`, to `b`, at `at[1]`, which is not less.
    fn split_line_edge(&mut self, edge: EdgeFaces, a: u32, b: u32, chain: u32, at: [f64; 2]) -> bool {
        let line = &self.curves.chains[chain as usize];
        let middle = 0.5 * (at[0] + at[1]);
        let Some(blends) = blends_on_both_sides(line, middle) else {
            return false;
        };
        let on_line = line.position_at(middle);
        let (size, kind) = (line.target_length_at(middle), line.kind);
        let position = self.place_split(edge, a, b, on_line);
        let m = self.mesh.add_point(position);
        let wedge = |mesh: &mut RegionMesh, f: u32, side: usize| {
            if f == NONE {
                return NONE;
            }
            let (of, weights) = blends[side];
            mesh.add_wedge(Wedge::from_blend(of, weights))
        };
        let left = wedge(&mut self.mesh, edge.left, 0);
        let right = if kind == LineKind::Sharp {
            left
        } else {
            wedge(&mut self.mesh, edge.right, 1)
        };
        self.mesh.insert_into_edge(edge, [a, b], m, [left, right]);
        self.curves.remove_segment(a, b);
        self.curves.set_segment(a, m, chain, [at[0], middle]);
        self.curves.set_segment(m, b, chain, [middle, at[1]]);
        for (p, old) in [(a, b), (b, a)] {
            if let PointConstraint::OnLine(on) = &mut self.constraints[p as usize] {
                on.beside.iter_mut().filter(|q| **q == old).for_each(|q| *q = m);
            }
        }
        self.constraints.push(PointConstraint::OnLine(ChainPoint {
            chain,
            at: middle,
            beside: [a, b],
        }));
        self.sizes.push(size);
        true
    }

    /// Where an edge is split: at `wanted`, or in its middle, which changes no surface, where that would not do.
    fn place_split(&mut self, edge: EdgeFaces, a: u32, b: u32, wanted: DVec3) -> DVec3 {
        let change = self.faces_after_split(edge, a, b, wanted);
        if self.splits_well(edge, a, b, wanted) && self.stays_near(&change) {
            return wanted;
        }
        let middle = (self.mesh.position(a) + self.mesh.position(b)) * 0.5;
        self.deviation.hand_over(&self.faces_after_split(edge, a, b, middle));
        middle
    }

    /// Whether the four faces of a split at `position` look the way that the two did.
    fn splits_well(&self, edge: EdgeFaces, a: u32, b: u32, position: DVec3) -> bool {
        edge.faces().all(|f| {
            let points = self.mesh.points_of(f);
            let before = self.mesh.area_normal(f);
            [a, b].into_iter().all(|end| {
                let half = points.map(|p| if p == end { position } else { self.mesh.position(p) });
                let turned = triangle::cosine(before, triangle::area_normal(half));
                turned.is_some_and(|c| c >= LEAST_COSINE) && self.is_faithful(f, half)
            })
        })
    }

    /// Whether `from` may be taken away by moving it into `to`, as far as lines go.
    pub fn may_go(&self, from: u32, to: u32) -> bool {
        match self.constraints[from as usize] {
            PointConstraint::Held => false,
            PointConstraint::OnSurface(_) => true,
            PointConstraint::OnLine(on) => on.beside.contains(&to) && self.curves.chain_segment(from, to).is_some(),
        }
    }

    /// Collapses `from` into `to` when topology and normals allow it and `accept` says yes to all faces after it.
    pub fn collapse_edge(&mut self, from: u32, to: u32, accept: impl Fn(&Self, &[[DVec3; 3]]) -> bool) -> bool {
        if !self.may_go(from, to) {
            return false;
        }
        let Some(collapse) = self.mesh.plan_collapse(from, to) else {
            return false;
        };
        let mut after = Vec::with_capacity(collapse.kept.len());
        for (f, before, corners) in self.mesh.before_and_after(&collapse) {
            if !self.may_become(f, before, corners) {
                return false;
            }
            after.push(corners);
        }
        if !accept(self, &after) {
            return false;
        }
        if !(collapse.kept.iter().zip(&after)).all(|(&f, &corners)| self.is_faithful_nearby(f, corners)) {
            return false;
        }
        let (place, around) = (self.mesh.position(to), self.mesh.neighbours(from));
        let change = ChangedFaces {
            before: self.mesh.faces_around(from).to_vec(),
            after: collapse.kept.iter().copied().zip(after).collect(),
            edges: (around.into_iter())
                .filter(|&q| q != to && !self.mesh.has_edge(q, to))
                .map(|q| [place, self.mesh.position(q)])
                .collect(),
        };
        if matches!(self.constraints[from as usize], PointConstraint::OnLine(on) if !self.can_leave_chain(from, to, on))
            || !self.stays_near(&change)
        {
            return false;
        }
        if let PointConstraint::OnLine(on) = self.constraints[from as usize] {
            self.drop_from_chain(from, to, on);
        }
        self.mesh.apply_collapse(&collapse);
        true
    }

    /// Whether `from` can be taken out of its chain in favour of its neighbour `to`.
    fn can_leave_chain(&self, from: u32, to: u32, on: ChainPoint) -> bool {
        let other = if on.beside[0] == to { on.beside[1] } else { on.beside[0] };
        let pieces = [to, other].map(|q| self.curves.chain_segment(from, q));
        other != to && pieces.iter().all(Option::is_some) && self.curves.chain_segment(to, other).is_none()
    }

    /// Takes `from` out of its chain in favour of its neighbour `to`.
    fn drop_from_chain(&mut self, from: u32, to: u32, on: ChainPoint) {
        let other = if on.beside[0] == to { on.beside[1] } else { on.beside[0] };
        let (Some(here), Some(there)) = (
            self.curves.chain_segment(from, to),
            self.curves.chain_segment(from, other),
        ) else {
            return;
        };
        self.curves.remove_segment(from, to);
        self.curves.remove_segment(from, other);
        self.curves.set_segment(to, other, on.chain, [here.at[1], there.at[1]]);
        for p in [to, other] {
            if let PointConstraint::OnLine(beside) = &mut self.constraints[p as usize] {
                beside.beside.iter_mut().filter(|q| **q == from).for_each(|q| {
                    *q = if p == to { other } else { to };
                });
            }
        }
    }

    /// Moves an inner point near `position`, onto the original surface, when no face turns over and `accept` says yes.
    pub fn move_on_surface(&mut self, p: u32, position: DVec3, accept: impl Fn(&Self, DVec3) -> bool) -> bool {
        let seeds = self.original_seeds(p);
        let spot = self.original.find_nearest(position, &seeds);
        let position = self.original.position_at(spot);
        if !self.can_move(p, position) || !accept(self, position) {
            return false;
        }
        if !self.stays_near(&self.faces_after_move(p, position)) {
            return false;
        }
        let blend = self.original.blend_at(spot);
        self.mesh.move_point(p, position, |_| blend);
        self.constraints[p as usize] = PointConstraint::OnSurface(spot);
        self.sizes[p as usize] = self.original.target_length_at(spot);
        for i in 0..self.mesh.faces_around(p).len() {
            let f = self.mesh.faces_around(p)[i];
            self.mesh.faces[f as usize].source = spot.face;
        }
        true
    }

    /// Moves a point along its chain to the length `at`, under the same conditions.
    pub fn slide_on_line(&mut self, p: u32, on: ChainPoint, at: f64, accept: impl Fn(&Self, DVec3) -> bool) -> bool {
        let line = &self.curves.chains[on.chain as usize];
        let (position, size, sharp) = (
            line.position_at(at),
            line.target_length_at(at),
            line.kind == LineKind::Sharp,
        );
        let Some(blends) = blends_on_both_sides(line, at) else {
            return false;
        };
        let ends = on
            .beside
            .map(|q| self.curves.chain_segment(p, q).map(|piece| piece.at[1]));
        let [Some(start), Some(end)] = ends else { return false };
        let between = at > start && at < end;
        if !between || !self.can_move(p, position) || !accept(self, position) {
            return false;
        }
        if !self.stays_near(&self.faces_after_move(p, position)) {
            return false;
        }
        let forward = self.mesh.edge_faces(p, on.beside[1]);
        let left = if forward.left == NONE {
            None
        } else {
            self.mesh.wedge_at(forward.left, p)
        };
        let side = |w| if sharp || Some(w) == left { 0 } else { 1 };
        self.mesh.move_point(p, position, |w| blends[side(w)]);
        self.curves.set_segment(p, on.beside[0], on.chain, [at, start]);
        self.curves.set_segment(p, on.beside[1], on.chain, [at, end]);
        self.constraints[p as usize] = PointConstraint::OnLine(ChainPoint { at, ..on });
        self.sizes[p as usize] = size;
        true
    }

    /// Whether face `f` may change its corners: it turns little, and still stands for the surface beside it. The normal
    /// of a sliver says little, so that one need do the second only.
    fn may_become(&self, f: u32, before: [DVec3; 3], after: [DVec3; 3]) -> bool {
        let little = triangle::turns_little(before, after, LEAST_COSINE)
            || (triangle::aspect(before) > SLIVER && triangle::aspect(after) < f64::INFINITY);
        little && self.is_faithful(f, after)
    }

    fn can_move(&self, p: u32, position: DVec3) -> bool {
        self.mesh.faces_around(p).iter().all(|&f| {
            let points = self.mesh.points_of(f);
            let before = points.map(|q| self.mesh.position(q));
            let after = points.map(|q| if q == p { position } else { self.mesh.position(q) });
            self.may_become(f, before, after)
        })
    }

    /// Looks again which original face each changed one lies beside.
    pub fn refresh_sources(&mut self, progress: &dyn Progress) -> Result<(), Error> {
        let mut done = 0;
        let changed: Vec<u32> = (self.mesh.living_faces())
            .filter(|&f| !self.mesh.faces[f as usize].untouched)
            .collect();
        for f in changed {
            done += 20 + self.take_work();
            if done >= WORK {
                done = 0;
                check(progress)?;
            }
            let middle = self.mesh.corner_positions(f).iter().sum::<DVec3>() / 3.0;
            let seeds = seeds_of_face(&self.mesh, &self.constraints, f);
            self.mesh.faces[f as usize].source = self.original.find_nearest(middle, &seeds).face;
        }
        Ok(())
    }

    /// The worst aspect of the faces around `p`, were it at `position`.
    pub fn worst_aspect(&self, p: u32, position: DVec3) -> f64 {
        let faces = self.mesh.faces_around(p).iter();
        faces.fold(0.0, |worst: f64, &f| {
            let points = self.mesh.points_of(f);
            worst.max(triangle::aspect(
                points.map(|q| if q == p { position } else { self.mesh.position(q) }),
            ))
        })
    }
}

/// Faces of the original surface from which to look for places near face `f`.
fn seeds_of_face(mesh: &RegionMesh, constraints: &[PointConstraint], f: u32) -> Vec<u32> {
    let inside = |p: u32| match constraints[p as usize] {
        PointConstraint::OnSurface(spot) => Some(spot.face),
        _ => None,
    };
    let points = mesh.points_of(f).into_iter();
    points
        .filter_map(inside)
        .chain([mesh.faces[f as usize].source])
        .collect()
}

/// What a point of a chain is made of on either side; a boundary has the same on both.
fn blends_on_both_sides(line: &Chain, at: f64) -> Option<[([u32; 3], [f64; 3]); 2]> {
    Some([line.blend_at(at, 0)?, line.blend_at(at, 1)?])
}
