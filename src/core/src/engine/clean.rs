//! Which triangles of a surface are not wanted: those of small parts, and those that lie on others.

use super::edit_command::CleanCommand;
use super::error::Error;
use crate::edit::SurfaceView;
use crate::exec::Exec;
use crate::mesh::{Components, Mesh, Weld};
use glam::DVec3;

/// A connected part of a surface.
#[derive(Clone)]
struct SurfacePart {
    /// Of its triangles that lie on no other.
    area: f64,
    low: DVec3,
    high: DVec3,
}

/// Finds the triangles that a cleaning takes away, rising.
///
/// # Errors
/// [`Error::Invalid`] when nothing would be left, [`Error::Cancelled`].
pub(super) fn unwanted_faces(
    surface: &SurfaceView<'_>,
    clean: &CleanCommand,
    exec: &Exec<'_>,
) -> Result<Vec<u32>, Error> {
    let mut unwanted = vec![false; surface.triangles.len()];
    if let Some(tolerance) = clean.duplicates_within {
        // Without a triangle that the tolerance leaves there is none that lies on another.
        if let Ok(welded) = Mesh::build(surface.positions, surface.triangles, Weld::Tolerance(tolerance)) {
            welded
                .duplicate_triangles
                .iter()
                .for_each(|&t| unwanted[t as usize] = true);
        }
    }
    exec.check()?;
    let points: Vec<[u32; 3]> = surface
        .triangles
        .iter()
        .map(|t| t.map(|v| surface.point_of[v as usize]))
        .collect();
    let connected = Components::of_triangles(surface.points as usize, &points);
    let none = SurfacePart {
        area: 0.0,
        low: DVec3::INFINITY,
        high: DVec3::NEG_INFINITY,
    };
    let mut parts = vec![none; connected.count];
    let part_of = |t: usize| connected.of_vertex[points[t][0] as usize] as usize;
    for (t, triangle) in surface.triangles.iter().enumerate().filter(|(t, _)| !unwanted[*t]) {
        let [a, b, c] = triangle.map(|v| surface.positions[v as usize]);
        let part = &mut parts[part_of(t)];
        part.area += (b - a).cross(c - a).length() / 2.0;
        part.low = [a, b, c].into_iter().fold(part.low, DVec3::min);
        part.high = [a, b, c].into_iter().fold(part.high, DVec3::max);
    }
    exec.check()?;
    let mut by_area: Vec<usize> = (0..parts.len()).collect();
    by_area.sort_by(|&a, &b| parts[b].area.total_cmp(&parts[a].area).then(a.cmp(&b)));
    let largest = by_area.first().map_or(0.0, |&first| parts[first].area);
    let mut stays = vec![true; parts.len()];
    for (rank, &p) in by_area.iter().enumerate() {
        let SurfacePart { area, low, high } = parts[p];
        stays[p] = clean.keep_largest.is_none_or(|most| rank < most as usize)
            && clean.smallest_share.is_none_or(|share| area >= share * largest)
            && clean.smallest_size.is_none_or(|size| (high - low).length() >= size);
    }
    for (t, unwanted) in unwanted.iter_mut().enumerate() {
        *unwanted |= !stays[part_of(t)];
    }
    if !unwanted.contains(&false) {
        let lengths = parts.iter().map(|p| (p.high - p.low).length());
        let longest = lengths.filter(|length| length.is_finite()).fold(0.0, f64::max);
        let problem = format!("leaves nothing; the largest part measures {longest} from corner to corner of its box");
        return Err(Error::invalid("clean.smallestSize", problem));
    }
    Ok((0u32..)
        .zip(unwanted)
        .filter(|(_, unwanted)| *unwanted)
        .map(|(t, _)| t)
        .collect())
}
