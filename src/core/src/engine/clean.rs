//! Which triangles of a surface are not wanted: those of small parts, and those that lie on others.

use super::edit_command::CleanCommand;
use super::error::Error;
use crate::edit::SurfaceView;
use crate::exec::Exec;
use crate::mesh::Components;
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
    let points: Vec<[u32; 3]> = surface
        .triangles
        .iter()
        .map(|t| t.map(|v| surface.point_of[v as usize]))
        .collect();
    let connected = Components::of_triangles(surface.points as usize, &points);
    if let Some(tolerance) = clean.duplicates_within {
        Duplicates::new(surface, &points, &connected, tolerance).mark(&mut unwanted, exec)?;
    }
    exec.check()?;
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

/// How many pairs of triangles are compared: some seconds.
const MOST_COMPARED: u64 = 1 << 30;

/// Triangles whose corners are near those of an earlier one. Vertices are compared, never joined: those of one part may be nearer
/// to each other than the distance.
struct Duplicates<'a> {
    triangles: &'a [[u32; 3]],
    places: Vec<DVec3>,
    part_of_point: &'a [u32],
    distance: f64,
    /// The triangles by the cell of their middle, sorted.
    cells: Vec<([i64; 3], u32)>,
    /// The edge of a cell.
    cell: f64,
}

impl<'a> Duplicates<'a> {
    fn new(surface: &SurfaceView<'_>, triangles: &'a [[u32; 3]], parts: &'a Components, distance: f64) -> Self {
        let places = surface.point_positions();
        let largest = places.iter().fold(0.0f64, |most, p| most.max(p.abs().max_element()));
        // Numbers of cells are exact.
        let cell = (2.0 * distance).max(largest * 1e-12).max(f64::MIN_POSITIVE);
        let mut found = Self {
            triangles,
            places,
            part_of_point: &parts.of_vertex,
            distance,
            cells: Vec::new(),
            cell,
        };
        found.cells = (0..triangles.len()).map(|t| (found.cell_of(t), t as u32)).collect();
        found.cells.sort_unstable();
        found
    }

    fn corners(&self, triangle: usize) -> [DVec3; 3] {
        self.triangles[triangle].map(|p| self.places[p as usize])
    }

    fn cell_of(&self, triangle: usize) -> [i64; 3] {
        let [a, b, c] = self.corners(triangle);
        ((a + b + c) / 3.0 / self.cell).floor().to_array().map(|x| x as i64)
    }

    /// Marks each triangle that lies on an earlier one that is not marked.
    fn mark(&self, marks: &mut [bool], exec: &Exec<'_>) -> Result<(), Error> {
        let mut compared = 0u64;
        for triangle in 0..self.triangles.len() {
            if triangle.is_multiple_of(1024) {
                exec.check()?;
            }
            let [x, y, z] = self.cell_of(triangle);
            for (dx, dy) in (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| (dx, dy))) {
                let begin = self.cells.partition_point(|(cell, _)| *cell < [x + dx, y + dy, z - 1]);
                let near = self.cells[begin..].iter();
                for &(_, other) in near.take_while(|(cell, _)| *cell <= [x + dx, y + dy, z + 1]) {
                    compared += 1;
                    let other = other as usize;
                    if other < triangle && !marks[other] && self.lies_on(triangle, other) {
                        marks[triangle] = true;
                    }
                }
            }
            if compared > MOST_COMPARED {
                let problem =
                    "is so large against the triangles that too many are near each other; take a smaller distance";
                return Err(Error::invalid("clean.duplicatesWithin", problem));
            }
        }
        Ok(())
    }

    /// Whether each corner of a triangle is near another one of an earlier triangle: of another part, or so near that the
    /// triangle's own corners are far apart beside it.
    fn lies_on(&self, triangle: usize, other: usize) -> bool {
        let (own, their) = (self.corners(triangle), self.corners(other));
        let part = |t: usize| self.part_of_point[self.triangles[t][0] as usize];
        let shortest = (0..3)
            .map(|k| own[k].distance(own[(k + 1) % 3]))
            .fold(f64::INFINITY, f64::min);
        if part(triangle) == part(other) && 2.0 * self.distance >= shortest {
            return false;
        }
        [[0, 1, 2], [1, 2, 0], [2, 0, 1], [0, 2, 1], [2, 1, 0], [1, 0, 2]]
            .iter()
            .any(|order| (0..3).all(|k| own[k].distance(their[order[k]]) <= self.distance))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pool::Pool;
    use crate::progress::Silent;

    #[test]
    fn a_hidden_copy_goes_whole_and_leaves_no_hole_even_within_an_edge_length() {
        // Two sheets of edges of 0.1, 0.05 above each other.
        let mut positions = Vec::new();
        let mut triangles = Vec::new();
        for height in [0.0, 0.05] {
            let first = positions.len() as u32;
            let places = (0..36).map(|k| DVec3::new(f64::from(k % 6), f64::from(k / 6), 0.0) * 0.1 + DVec3::Z * height);
            positions.extend(places);
            for corner in (0..25).map(|k| first + k % 5 + 6 * (k / 5)) {
                triangles.extend([[corner, corner + 1, corner + 7], [corner, corner + 7, corner + 6]]);
            }
        }
        let points: Vec<u32> = (0..positions.len() as u32).collect();
        let surface = SurfaceView {
            positions: &positions,
            triangles: &triangles,
            primitive_of: &vec![0; triangles.len()],
            point_of: &points,
            points: points.len() as u32,
        };
        let pool = Pool::new(2).expect("threads");
        let unwanted = |distance| {
            let clean = CleanCommand {
                duplicates_within: Some(distance),
                ..CleanCommand::default()
            };
            unwanted_faces(&surface, &clean, &Exec::new(&pool, &Silent)).expect("something is left")
        };
        let upper: Vec<u32> = (50..100).collect();
        for distance in [0.051, 0.09, 0.15] {
            assert_eq!(unwanted(distance), upper, "{distance}");
        }
        assert_eq!(unwanted(0.049), Vec::<u32>::new());
    }
}
