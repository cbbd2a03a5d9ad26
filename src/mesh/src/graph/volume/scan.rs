//! Nodes of a grid inside a closed hull, found row by row.
//!
//! A row of the grid enters and leaves a closed hull equally often, so walking along it and counting faces gives the
//! winding number of every node, a whole number. Nodes too near to the surface are then taken away face by face. Both
//! touch each face for the few nodes around it, so the work grows with the number of faces and of nodes, not with the
//! box around them, and nothing is searched. Sheets (all nodes of one height) are independent of each other.

use crate::graph::parallel::map_few;
use crate::graph::volume::caps::HullFaces;
use crate::graph::volume::lattice_grid::{LAST, LatticeGrid, LatticeNodes, NONE, TooFine, key};
use crate::graph::volume::shell::VolumeSite;
use crate::query::QueryStop;
use crate::query::closest_point::PreparedTriangle;
use crate::{Error, Lists};
use glam::DVec3;
use rayon::prelude::*;

/// Sheets looked at between two looks at the progress and at the number of nodes.
const BLOCK: usize = 256;
/// Nodes and crossings looked at between two looks at the progress inside of one sheet.
const CHECKED: usize = 1 << 13;

/// A row crosses a face here.
#[derive(Clone, Copy)]
struct RowCrossing {
    row: u32,
    /// In cells.
    x: f64,
    /// How much the winding number changes, seen along the row.
    turn: i32,
}

/// Nodes `first..first + count` of a row, all inside.
#[derive(Clone, Copy)]
struct InsideRun {
    row: u32,
    first: u32,
    count: u32,
    /// Length of the row inside the surface, in cells.
    length: f64,
}

/// The nodes of `grid` inside `hull` and deeper than `depth` below the whole surface, each with its clearance as
/// far as it matters. `Err(TooFine)` inside when there is too much to look at, or when there are more than about
/// `limit` nodes.
pub(in crate::graph) fn nodes(
    site: &VolumeSite,
    hull: HullFaces,
    grid: &LatticeGrid,
    depth: f64,
    limit: usize,
) -> Result<Result<LatticeNodes, TooFine>, Error> {
    // Clear by half an interval, no edge of a node needs to be tested against triangles.
    let reach = depth.max(0.501 * grid.interval) * 1.001;
    let all = HullFaces::of_mesh(site.mesh);
    let lists = faces_by_sheet(site, all, grid, reach).and_then(|faces| {
        // Where all parts are closed, the faces near a sheet are also those that cross it.
        let same = std::ptr::eq(all.faces, hull.faces);
        let crossing = if same {
            None
        } else {
            Some(faces_by_sheet(site, hull, grid, 0.0)?)
        };
        Ok((faces, crossing))
    });
    let (faces, crossing) = match lists {
        Ok(lists) => lists,
        Err(too_fine) => return Ok(Err(too_fine)),
    };
    let crossing = crossing.as_ref().unwrap_or(&faces);
    let mut nodes = LatticeNodes::default();
    let sheets: Vec<u32> = (0..faces.rows() as u32).collect();
    for block in sheets.chunks(BLOCK) {
        let scan = |sheet: u32| {
            let runs = runs(grid, crossings(site, hull, grid, crossing.of(sheet), sheet)?);
            let count = runs.iter().map(|r| r.count as usize).sum::<usize>();
            // A sheet alone that holds many times more than all may is not worth storing.
            if count > limit.saturating_mul(8).saturating_add(1 << 20) {
                return Ok::<_, QueryStop>(Err(count));
            }
            deep_nodes(site, grid, &runs, faces.of(sheet), sheet, [depth, reach]).map(Ok)
        };
        let found = map_few(block, site.exec, |&sheet| scan(sheet))?;
        for sheet in found {
            let count = nodes.keys.len() + sheet.as_ref().map_or_else(|count| *count, |s| s.keys.len());
            match sheet {
                Ok(sheet) if count <= limit => {
                    nodes.keys.extend(sheet.keys);
                    nodes.clearance.extend(sheet.clearance);
                    nodes.shallow.append_all(sheet.shallow);
                }
                // The sheets to come hold as much again, more or less.
                _ => return Ok(Err(TooFine::by(libm::cbrt(1.2 * count as f64 / limit.max(1) as f64)))),
            }
        }
    }
    Ok(Ok(nodes))
}

/// Volume inside `hull`, by the lengths of the rows of `grid`; `None` when there is too much to look at.
pub(in crate::graph) fn volume(site: &VolumeSite, hull: HullFaces, grid: &LatticeGrid) -> Result<Option<f64>, Error> {
    let Ok(faces) = faces_by_sheet(site, hull, grid, 0.0) else {
        return Ok(None);
    };
    let sheets: Vec<u32> = (0..faces.rows() as u32).collect();
    let measure = |sheet: u32| {
        let runs = runs(grid, crossings(site, hull, grid, faces.of(sheet), sheet)?);
        Ok::<_, QueryStop>(runs.iter().map(|r| r.length).sum::<f64>())
    };
    let lengths = map_few(&sheets, site.exec, |&sheet| measure(sheet))?;
    // Sheets are half a cell apart, rows of a sheet one.
    let cell = grid.interval * grid.interval * grid.interval;
    Ok(Some(0.5 * lengths.iter().sum::<f64>() * cell))
}

/// For each sheet the faces no further from it than `reach`, rising.
fn faces_by_sheet(site: &VolumeSite, of: HullFaces, grid: &LatticeGrid, reach: f64) -> Result<Lists, TooFine> {
    let HullFaces { positions, faces } = of;
    let count = 2 * (grid.cells[2] as usize + 2);
    let budget = (512 * faces.len() + (1 << 23)).min(u32::MAX as usize - 1) as f64;
    // First and last sheet of each face (none when the last is the smaller), and rows looked at for it.
    let spans: Vec<([u32; 2], f32)> = site.exec.pool.install(|| {
        let span = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| positions[v as usize]);
            let low = (a.min(b).min(c) - grid.origin - DVec3::splat(reach)) / grid.interval;
            let high = (a.max(b).max(c) - grid.origin + DVec3::splat(reach)) / grid.interval;
            let first = (low.z * 2.0).ceil().clamp(0.0, count as f64) as u32;
            let last = (high.z * 2.0).floor().clamp(-1.0, count as f64 - 1.0);
            let sheets = last - f64::from(first) + 1.0;
            let span = if sheets > 0.0 { [first, last as u32 + 1] } else { [0, 0] };
            (span, (sheets.max(0.0) * (high.y - low.y + 1.0)) as f32)
        };
        faces.par_iter().with_min_len(1024).map(span).collect()
    });
    let work: f64 = spans.iter().map(|s| f64::from(s.1)).sum();
    if work > budget || work.is_nan() {
        // Work at the surface grows fourfold when the interval is halved, with sheets and rows.
        return Err(TooFine::by((work / budget).sqrt()));
    }
    Ok(Lists::gather(count, || {
        let each = spans.iter().zip(0u32..);
        each.flat_map(|(([first, end], _), t)| (*first..*end).map(move |sheet| (sheet, t)))
    }))
}

/// Height of a sheet, and by how much of a cell its rows and nodes are shifted.
fn height(grid: &LatticeGrid, sheet: u32) -> (f64, f64) {
    let shift = f64::from(sheet % 2) * 0.5;
    (grid.origin.z + (f64::from(sheet / 2) + shift) * grid.interval, shift)
}

/// Where the rows of a sheet cross faces of `hull`. The sheet cuts each edge in the same way for both faces, so the
/// turns of a row add up to exactly zero, without special cases.
fn crossings(
    site: &VolumeSite,
    hull: HullFaces,
    grid: &LatticeGrid,
    near: &[u32],
    sheet: u32,
) -> Result<Vec<RowCrossing>, QueryStop> {
    let (z, shift) = height(grid, sheet);
    let (mut found, mut looked) = (Vec::new(), 0);
    for &t in near {
        let face = hull.faces[t as usize];
        let heights = face.map(|v| hull.positions[v as usize].z > z);
        if heights == [heights[0]; 3] {
            continue;
        }
        // The sheet cuts two edges, one on its way up and one on its way down.
        let mut cuts = [(0.0f64, 0.0f64); 2];
        for k in 0..3 {
            let (from, to) = (face[k], face[(k + 1) % 3]);
            if heights[k] != heights[(k + 1) % 3] {
                let [a, b] = [from.min(to), from.max(to)].map(|v| hull.positions[v as usize]);
                let cut = a + (b - a) * ((z - a.z) / (b.z - a.z));
                cuts[usize::from(heights[k])] = ((cut.y - grid.origin.y) / grid.interval - shift, cut.x);
            }
        }
        let [up, down] = cuts;
        let (low, high, turn) = if up.0 <= down.0 { (up, down, -1) } else { (down, up, 1) };
        let slope = (high.1 - low.1) / (high.0 - low.0);
        let (least, most) = (low.1.min(high.1), low.1.max(high.1));
        let mut row = low.0.ceil().max(0.0);
        // A row counts where it lies on or above one cut and below the other, so neighbours leave no gap.
        while row < high.0.min(f64::from(LAST)) {
            let x = (low.1 + slope * (row - low.0)).max(least).min(most);
            found.push(RowCrossing {
                row: row as u32,
                x: (x - grid.origin.x) / grid.interval - shift,
                turn,
            });
            row += 1.0;
        }
        looked += 1 + (row - low.0).max(0.0) as usize;
        if looked > CHECKED {
            looked = 0;
            site.budget.check()?;
        }
    }
    Ok(found)
}

/// What lies between crossings with a winding number other than 0.
fn runs(grid: &LatticeGrid, mut crossings: Vec<RowCrossing>) -> Vec<InsideRun> {
    crossings.sort_unstable_by(|a, b| a.row.cmp(&b.row).then(a.x.total_cmp(&b.x)).then(a.turn.cmp(&b.turn)));
    let mut runs: Vec<InsideRun> = Vec::new();
    let mut winding = 0i32;
    for pair in crossings.windows(2) {
        let [from, to] = [pair[0], pair[1]];
        winding += from.turn;
        if from.row != to.row {
            winding = 0;
            continue;
        }
        if winding == 0 || to.x <= from.x {
            continue;
        }
        let first = (from.x.floor() + 1.0).max(1.0);
        let last = (to.x.ceil() - 1.0).min(f64::from(grid.cells[0]));
        let (first, count) = (first as u32, (last - first + 1.0).max(0.0) as u32);
        runs.push(InsideRun {
            row: from.row,
            first,
            count,
            length: to.x - from.x,
        });
    }
    runs
}

/// The nodes of a sheet's runs that no face is nearer to than `depth`, and the others apart.
fn deep_nodes(
    site: &VolumeSite,
    grid: &LatticeGrid,
    runs: &[InsideRun],
    near: &[u32],
    sheet: u32,
    [depth, reach]: [f64; 2],
) -> Result<LatticeNodes, QueryStop> {
    let mut nodes = LatticeNodes::default();
    let (Some(first), Some(last)) = (runs.first(), runs.last()) else {
        return Ok(nodes);
    };
    let (z, shift) = height(grid, sheet);
    // Where each row's runs begin, and where each run's nodes do.
    let (low, rows) = (first.row, (last.row - first.row + 1) as usize);
    let mut row_starts = vec![0u32; rows + 1];
    let mut node_starts = Vec::with_capacity(runs.len() + 1);
    let mut total = 0usize;
    for run in runs {
        row_starts[(run.row - low) as usize + 1] += 1;
        node_starts.push(total);
        total += run.count as usize;
    }
    (0..rows).for_each(|r| row_starts[r + 1] += row_starts[r]);
    let mut nearest = vec![reach * reach; total];
    let mut faces = vec![NONE; total];

    let cell = |world: f64, axis: usize| (world - grid.origin[axis]) / grid.interval - shift;
    let world = |cell: f64, axis: usize| grid.origin[axis] + (cell + shift) * grid.interval;
    // Distances below this may be nothing but rounding.
    let noise = (1e-12 * reach) * (1e-12 * reach);
    let mut looked = 0;
    for &t in near {
        let corners = site.mesh.triangles[t as usize].map(|v| site.mesh.positions[v as usize]);
        let face = PreparedTriangle::new(corners);
        let [a, b, c] = corners;
        let (least, most) = (a.min(b).min(c), a.max(b).max(c));
        let normal = (b - a).cross(c - a).normalize_or_zero();
        let from = cell(least.y - reach, 1).ceil().max(f64::from(low));
        let to = cell(most.y + reach, 1).floor().min(f64::from(last.row));
        let mut row = from;
        while row <= to {
            let y = world(row, 1);
            // Along the row, the slab around the face's plane and the box around the face limit where it is near.
            let (mut x0, mut x1) = (least.x - reach, most.x + reach);
            let aside = normal.y * (y - a.y) + normal.z * (z - a.z);
            if normal.x.abs() > 1e-3 {
                let (at, half) = (a.x - aside / normal.x, reach * 1.000_001 / normal.x.abs());
                x0 = x0.max(at - half);
                x1 = x1.min(at + half);
            } else if aside.abs() > reach * 1.01 + (most.x - least.x + 2.0 * reach) * 1e-3 {
                row += 1.0;
                continue;
            }
            let (x0, x1) = (cell(x0, 0).ceil(), cell(x1, 0).floor());
            let r = (row - f64::from(low)) as usize;
            for k in row_starts[r] as usize..row_starts[r + 1] as usize {
                let run = runs[k];
                let begin = x0.max(f64::from(run.first));
                let end = x1.min(f64::from(run.first) + f64::from(run.count) - 1.0);
                looked += 1 + (end - begin).max(0.0) as u64;
                let mut i = begin;
                while i <= end {
                    let p = DVec3::new(world(i, 0), y, z);
                    let node = node_starts[k] + (i as u32 - run.first) as usize;
                    i += 1.0;
                    // The box and the plane of the face are no further away than the face.
                    let known = nearest[node] * (1.0 + 1e-6) + noise;
                    let (out, up) = ((least - p).max(p - most).max(DVec3::ZERO), normal.dot(p - a));
                    if (out.length_squared() > known) | (up * up > known) {
                        continue;
                    }
                    let square = face.closest_point(p).distance_squared(p);
                    if square < nearest[node] {
                        nearest[node] = square;
                        faces[node] = t;
                    }
                }
            }
            if looked > CHECKED as u64 {
                site.looked.add(std::mem::take(&mut looked));
                site.budget.check()?;
            }
            row += 1.0;
        }
    }
    let starts = runs.iter().zip(node_starts);
    starts.for_each(|(run, start)| part_by_depth(&mut nodes, run, sheet, &nearest[start..], &faces[start..], depth));
    Ok(nodes)
}

/// Adds the nodes of a run to those that no face is nearer to than `depth`, or to the shallow ones; `squares` has for each the square of
/// the distance to the nearest face, `faces` that face.
fn part_by_depth(nodes: &mut LatticeNodes, run: &InsideRun, sheet: u32, squares: &[f64], faces: &[u32], depth: f64) {
    for (i, (&square, &face)) in (0..run.count).zip(squares.iter().zip(faces)) {
        let key = key([run.first + i, run.row, sheet / 2], sheet % 2 == 1);
        let clearance = square.sqrt();
        if clearance > depth {
            nodes.keys.push(key);
            nodes.clearance.push(clearance);
        } else if face != NONE {
            nodes.shallow.keys.push(key);
            nodes.shallow.squares.push(square);
            nodes.shallow.triangles.push(face);
        }
    }
}
