//! Primitives of a model that are chosen by name, to be seen alone.

use super::failure::CliFailure;
use crate::asset::{Geometry, Primitive};
use std::collections::BTreeSet;

/// Most primitives that a refusal lists.
const LISTED: usize = 40;

/// The primitives that are named, in the order of the model; a number, as `pliant inspect` counts them, where none is named so.
///
/// # Errors
/// A name that none has, with those that there are; primitives without a triangle.
pub(super) fn choose_primitives(primitives: &[Primitive], names: &[String]) -> Result<Vec<usize>, CliFailure> {
    let refuse = |name: &str, problem: String| CliFailure::Input(format!("--primitive {name}: {problem}"));
    let mut chosen = BTreeSet::new();
    for name in names {
        let mut named: Vec<usize> = (0..primitives.len()).filter(|&k| primitives[k].name == *name).collect();
        if named.is_empty() {
            named.extend(name.parse::<usize>().ok().filter(|&k| k < primitives.len()));
        }
        if named.is_empty() {
            let listed = primitives.iter().take(LISTED).enumerate();
            let listed: Vec<String> = listed.map(|(k, p)| format!("{k} \"{}\"", p.name)).collect();
            let more = match primitives.len().saturating_sub(LISTED) {
                0 => String::new(),
                more => format!(" and {more} more, which pliant inspect --json lists"),
            };
            let there = format!("there are {}{more}", listed.join(", "));
            return Err(refuse(name, format!("no primitive is named so; {there}")));
        }
        if named.iter().all(|&k| primitives[k].index_count == 0) {
            return Err(refuse(name, "it has no triangle to draw".into()));
        }
        chosen.extend(named);
    }
    Ok(chosen.into_iter().collect())
}

/// Takes all other primitives out of sight: their vertices come to lie at one of those that are chosen, so that every vertex keeps its
/// number and a camera has nothing else to look at.
pub(super) fn keep_in_sight(geometry: &mut Geometry, chosen: &[usize]) {
    let runs = geometry.triangles_of_primitives().enumerate();
    let corner = runs
        .filter(|(k, _)| chosen.contains(k))
        .find_map(|(_, (_, run))| run.first());
    let Some(place) = corner.and_then(|corner| geometry.positions.get(corner[0] as usize).copied()) else {
        return;
    };
    for (k, primitive) in geometry.primitives.iter().enumerate() {
        if !chosen.contains(&k)
            && let Some(hidden) = geometry.positions.get_mut(primitive.vertices())
        {
            hidden.fill(place);
        }
    }
}
