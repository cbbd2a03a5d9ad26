//! The volume that a smoothing loses, given back: of parts that it would shrink as a whole by their size, of others along the normals.

use super::region_mesh::RegionMesh;
use super::smooth::Smoother;
use super::smooth_closed::WholePart;
use super::surface::SurfaceView;
use glam::DVec3;
use pliant_exec::progress::{Progress, check};
use pliant_mesh::{BoundingBox, Error, NONE, sorted_set};

/// The volume is right when no more than this part of what was lost is left.
const EXACT: f64 = 1e-9;

impl Smoother {
    /// The parts that all steps would shrink as a whole.
    pub fn whole_parts(&self) -> Vec<WholePart> {
        let at = self.positions();
        let neighbours = |row: u32| {
            let row = self.rows[row as usize].iter();
            row.map(|&(q, weight)| {
                let place = self.row_of[q as usize];
                ((place != NONE).then_some(place), weight)
            })
        };
        let parts = self.parts();
        parts
            .iter()
            .filter_map(|part| WholePart::find(part, &at, neighbours))
            .collect()
    }

    /// Gives such parts the extents that they had `before` an iteration.
    pub fn restore_extents(&mut self, whole: &[WholePart], before: &[DVec3]) {
        if !whole.is_empty() {
            let mut at = self.positions();
            whole.iter().for_each(|part| part.restore_extents(before, &mut at));
            self.set_positions(&at);
        }
    }

    /// Gives each part that hangs together by points that move the volume that it had.
    pub fn restore_volume(&mut self, whole: &[WholePart], progress: &dyn Progress) -> Result<(), Error> {
        let amount = self.spread_amounts();
        let mut whole = whole.iter().peekable();
        for part in self.parts() {
            check(progress)?;
            match whole.next_if(|whole| whole.points() == part) {
                Some(whole) => self.scale_to_volume(whole),
                None => self.restore_volume_of(&part, &amount),
            }
        }
        Ok(())
    }

    /// How far each free point has moved, averaged with its neighbours, so that what comes back comes back evenly.
    fn spread_amounts(&self) -> Vec<f64> {
        let moved = |p: u32| self.mesh.position(p).distance(self.before[p as usize]);
        let mut amount: Vec<f64> = self.free.iter().map(|&p| moved(p)).collect();
        for _ in 0..2 {
            let at = |q: u32| amount.get(self.row_of[q as usize] as usize).copied().unwrap_or(0.0);
            let spread = self.rows.iter().zip(&amount).map(|(row, own)| {
                let around: f64 = row.iter().map(|&(q, weight)| at(q) * weight).sum();
                0.5 * (own + around)
            });
            amount = spread.collect();
        }
        amount
    }

    /// The points that move, by parts, as places among them.
    fn parts(&self) -> Vec<Vec<u32>> {
        let mut seen = vec![false; self.free.len()];
        let mut parts = Vec::new();
        for start in 0..self.free.len() {
            if std::mem::replace(&mut seen[start], true) {
                continue;
            }
            let mut part = vec![start as u32];
            let mut done = 0;
            while done < part.len() {
                for &(q, _) in &self.rows[part[done] as usize] {
                    let row = self.row_of[q as usize];
                    if row != NONE && !std::mem::replace(&mut seen[row as usize], true) {
                        part.push(row);
                    }
                }
                done += 1;
            }
            part.sort_unstable();
            parts.push(part);
        }
        parts
    }

    /// The faces at the points of a part.
    fn faces_of(&self, part: &[u32]) -> Vec<u32> {
        let around = |&row: &u32| self.mesh.faces_around(self.free[row as usize]).iter().copied();
        sorted_set(part.iter().flat_map(around))
    }

    fn scale_to_volume(&mut self, whole: &WholePart) {
        let faces = self.faces_of(whole.points());
        let origin = self.before[self.free[whole.points()[0] as usize] as usize];
        let wanted = volume_of(&self.mesh, &faces, |p| self.before[p as usize] - origin);
        let times = wanted / volume_of(&self.mesh, &faces, |p| self.mesh.position(p) - origin);
        if times.is_finite() && times > 0.0 {
            let mut at = self.positions();
            whole.scale_volume(times, &mut at);
            self.set_positions(&at);
        }
    }

    fn restore_volume_of(&mut self, part: &[u32], amount: &[f64]) {
        let faces = self.faces_of(part);
        let origin = self.before[self.free[part[0] as usize] as usize];
        let wanted = volume_of(&self.mesh, &faces, |p| self.before[p as usize] - origin);
        let smooth = self.positions();
        let normals: Vec<DVec3> = (part.iter())
            .map(|&row| self.area_normal_at(self.free[row as usize]).normalize_or_zero())
            .collect();
        let missing = |this: &Self| wanted - volume_of(&this.mesh, &faces, |p| this.mesh.position(p) - origin);
        let first = missing(self);
        let mut share = 0.0;
        for _ in 0..8 {
            let left = missing(self);
            if left.abs() <= EXACT * first.abs() {
                break;
            }
            let slope: f64 = (part.iter().zip(&normals))
                .map(|(&row, n)| n.dot(self.area_normal_at(self.free[row as usize])) * amount[row as usize] / 6.0)
                .sum();
            share = (share + left / slope).clamp(-1.0, 1.0);
            if !share.is_finite() {
                return self.set_positions(&smooth);
            }
            for (&row, &n) in part.iter().zip(&normals) {
                let place = smooth[row as usize] + n * (share * amount[row as usize]);
                self.mesh.points[self.free[row as usize] as usize].position = place;
            }
        }
        self.take_back(&smooth);
    }

    /// The sum of the area normals of the faces around a point.
    fn area_normal_at(&self, p: u32) -> DVec3 {
        self.mesh
            .faces_around(p)
            .iter()
            .map(|&f| self.mesh.area_normal(f))
            .sum()
    }

    /// By which part of the volume of the whole surface it has changed.
    pub fn volume_change(&self, surface: &SurfaceView<'_>) -> f64 {
        let origin = BoundingBox::of(surface.positions).center();
        let faces: Vec<u32> = self.mesh.living_faces().collect();
        let [was, now] = [false, true].map(|now| {
            volume_of(&self.mesh, &faces, |p| match now {
                true => self.mesh.position(p) - origin,
                false => self.before[p as usize] - origin,
            })
        });
        let corners = (0..surface.triangles.len() as u32).map(|t| surface.corner_positions(t).map(|x| x - origin));
        let whole: f64 = corners.map(|[a, b, c]| a.dot(b.cross(c))).sum();
        let part = (now - was) / (whole / 6.0).abs();
        if part.is_finite() { part } else { 0.0 }
    }
}

/// The volume between faces and the origin, counted negative where they face it.
fn volume_of(mesh: &RegionMesh, faces: &[u32], at: impl Fn(u32) -> DVec3) -> f64 {
    let sum: f64 = (faces.iter())
        .map(|&f| {
            let [a, b, c] = mesh.points_of(f).map(&at);
            a.dot(b.cross(c))
        })
        .sum();
    sum / 6.0
}
