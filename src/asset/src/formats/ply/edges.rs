//! Edges of a PLY: the lines that they are, and how they go on where a vertex is gone.

use super::read::{edge_ends, read_table};
use crate::edited::FollowedLines;
use crate::{Error, Model};
use std::collections::BTreeMap;

/// Rows of edges, where two edges that meet at a vertex which is gone, and no other edge does, are one: the first of them, to the
/// end of the second. With how many each was.
pub(super) fn rewired(rows: &[Vec<f64>], [from, to]: [usize; 2], followed: &FollowedLines) -> Vec<(Vec<f64>, usize)> {
    let is_gone = |row: &[f64], end: usize| followed.vertex(row[end] as u32).is_none();
    let mut rows: Vec<Option<(Vec<f64>, usize)>> = rows.iter().cloned().map(|row| Some((row, 1))).collect();
    let mut at: BTreeMap<u32, Vec<usize>> = BTreeMap::new();
    for (r, row) in rows.iter().enumerate() {
        let Some((row, _)) = row else { continue };
        for end in [from, to].into_iter().filter(|end| is_gone(row, *end)) {
            at.entry(row[end] as u32).or_default().push(r);
        }
    }
    // The row that each has become a part of.
    let mut now: Vec<usize> = (0..rows.len()).collect();
    for (vertex, met) in at {
        let [mut first, mut second] = match met.as_slice() {
            [a, b] if a != b => [*a, *b],
            _ => continue,
        };
        while now[first] != first {
            first = now[first];
        }
        while now[second] != second {
            second = now[second];
        }
        if first == second {
            continue;
        }
        let (first, second) = (first.min(second), first.max(second));
        let Some((gone, count)) = rows[second].take() else {
            continue;
        };
        let other = if gone[from] as u32 == vertex {
            gone[to]
        } else {
            gone[from]
        };
        now[second] = first;
        if let Some((row, own)) = &mut rows[first] {
            let end = if row[from] as u32 == vertex { from } else { to };
            row[end] = other;
            *own += count;
        }
    }
    rows.into_iter().flatten().collect()
}

/// The segments of the edges of a model, by its vertices.
pub(super) fn segments(model: &Model) -> Result<Vec<[u32; 2]>, Error> {
    let table = read_table(&model.files.main, &model.geometry.positions)?;
    let ends = table
        .header
        .elements
        .iter()
        .filter(|e| e.name == "edge")
        .find_map(edge_ends);
    let count = model.geometry.positions.len();
    let rows = table.edges.iter().filter_map(|row| Some(ends?.map(|end| row[end])));
    let is_there = |ends: &[f64; 2]| ends.iter().all(|&v| v >= 0.0 && v < count as f64);
    Ok(rows.filter(is_there).map(|ends| ends.map(|v| v as u32)).collect())
}
