//! Interior nodes within the memory that there is, and what a user should know of them.

use super::facts::{DeformerWarning, WarningPlace};
use super::limits::DeformerLimits;
use crate::deform::{DeformableBody, VolumeMode};
use crate::mesh::{brief_number, brief_point};
use glam::DVec3;

/// Bytes that a graph node costs at the peak of building: graph, hierarchy, fields, systems and scratch. Measured as
/// 1,150 on a solid of 128 K nodes, rounded up.
pub(super) const BYTES_PER_NODE: u64 = 1400;

/// How many places one warning spells out.
const PLACES: usize = 16;

/// The most nodes that a graph may have to fit into `limits` beside `other` bytes, with a fifth left for the fields of
/// handles.
pub(super) fn most_nodes(other: u64, limits: &DeformerLimits) -> usize {
    let bytes = limits.graph_bytes.unwrap_or(limits.memory_bytes);
    let nodes = bytes.saturating_sub(other) / (BYTES_PER_NODE / 4 * 5);
    usize::try_from(nodes).unwrap_or(usize::MAX)
}

/// What is unusual about the interior of a body that was built in `mode`.
pub(super) fn interior_warnings(body: &DeformableBody, mode: VolumeMode) -> Vec<DeformerWarning> {
    let warning = |code: &str, message: String, place: String| DeformerWarning::new(code, message, place);
    if mode == VolumeMode::Off {
        return Vec::new();
    }
    let (graph, stats) = (&body.graph, &body.graph.stats);
    if let Some(reason) = &body.too_large {
        let message = format!("{reason}; the model deforms as a surface");
        return vec![warning("volume-graph-too-large", message, String::new())];
    }
    if graph.surface == body.nodes() && stats.struts == 0 {
        let message = "the model encloses no volume, so it deforms as a surface";
        return vec![warning("no-volume-graph", message.into(), String::new())];
    }
    let mut warnings = Vec::new();
    // A lattice is widened by more than rounding, or not at all.
    if stats.interval > stats.wanted_interval * 1.001 {
        let message = format!(
            "interior nodes are {} apart instead of {}, because more of them do not fit",
            brief_number(stats.interval),
            brief_number(stats.wanted_interval)
        );
        warnings.push(warning("volume-graph-coarse", message, String::new()));
    }
    // Ties make one component of several parts.
    let (component, has_volume) = match &graph.ties {
        Some(ties) => (ties.untied_component(), ties.component_has_volume()),
        None => (&graph.component[..], &stats.component_has_volume[..]),
    };
    let sheets = has_volume.iter().filter(|has| !**has).count();
    if sheets > 0 {
        let mut first = vec![None; has_volume.len()];
        for (node, &c) in component[..graph.surface].iter().enumerate().rev() {
            first[c as usize] = Some(graph.positions[node]);
        }
        let points: Vec<DVec3> = first
            .iter()
            .zip(has_volume)
            .filter_map(|(p, has)| p.filter(|_| !has))
            .take(PLACES)
            .collect();
        let places: Vec<String> = points.iter().map(|&p| format!("at {}", brief_point(p))).collect();
        let message = match has_volume.len() {
            1 => "its only part encloses no volume or too little, so it deforms as a surface".into(),
            parts => format!("{sheets} of {parts} parts enclose no volume or too little, so they deform as surfaces"),
        };
        let more = sheets.saturating_sub(PLACES);
        let more = if more > 0 {
            format!("; and {more} more")
        } else {
            String::new()
        };
        let text = places.join("; ") + &more;
        warnings.push(DeformerWarning {
            place: WarningPlace::Points { text, points },
            ..warning("surface-parts", message, String::new())
        });
    }
    warnings
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::asset::{FileSet, shapes};
    use crate::engine::Deformer;
    use crate::engine::{Error, OpenOptions};
    use crate::exec::Exec;
    use crate::graph::InteriorKind;
    use crate::pool::Pool;
    use crate::progress::Silent;

    /// A cube of 1,538 vertices, with an open square beside it when asked for.
    fn open(memory_bytes: u64, mode: VolumeMode, sheet: bool) -> Result<Deformer, Error> {
        open_as(InteriorKind::Shape, memory_bytes, mode, sheet)
    }

    fn open_as(kind: InteriorKind, memory_bytes: u64, mode: VolumeMode, sheet: bool) -> Result<Deformer, Error> {
        let (positions, triangles) = shapes::box_with_cells(DVec3::ONE, [16; 3]);
        let mut text = String::new();
        positions
            .iter()
            .for_each(|p| text += &format!("v {} {} {}\n", p.x, p.y, p.z));
        triangles
            .iter()
            .for_each(|t| text += &format!("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1));
        if sheet {
            text += "v 3 0 0\nv 4 0 0\nv 4 1 0\nv 3 1 0\nf -4 -3 -2 -1\n";
        }
        let mut options = OpenOptions::default();
        options.body.volume = mode;
        options.body.graph.kind = kind;
        let limits = DeformerLimits {
            memory_bytes,
            ..Default::default()
        };
        let pool = Pool::new(1).unwrap();
        Deformer::open(
            FileSet::single("cube.obj", text),
            &options,
            &limits,
            &Exec::new(&pool, &Silent),
        )
    }

    fn codes(bench: &Deformer) -> Vec<String> {
        bench.facts().warnings.into_iter().map(|w| w.code).collect()
    }

    #[test]
    fn what_does_not_fit_gets_a_wider_lattice_then_none_and_says_so() {
        let whole = open(1 << 30, VolumeMode::Auto, false).unwrap();
        assert!(codes(&whole).is_empty(), "{:?}", codes(&whole));
        let open = |bytes: u64, mode: VolumeMode, sheet: bool| open_as(InteriorKind::Paper, bytes, mode, sheet);
        let surface = whole.body().graph.surface as u64;
        // What files, vertices and so many nodes take.
        let room = |nodes: u64| {
            let beside = whole.estimate() - whole.body().nodes() as u64 * BYTES_PER_NODE;
            beside + nodes * BYTES_PER_NODE / 4 * 5
        };
        let coarse = open_as(InteriorKind::Shape, room(surface * 5 / 4), VolumeMode::Auto, false).unwrap();
        assert_eq!(codes(&coarse), ["volume-graph-coarse"]);
        assert!(coarse.body().nodes() < whole.body().nodes() && coarse.body().graph.stats.lattice_nodes > 0);
        let whole = open(1 << 30, VolumeMode::Auto, false).unwrap();
        let coarse = open(room(surface * 5 / 2), VolumeMode::Auto, false).unwrap();
        assert_eq!(codes(&coarse), ["volume-graph-coarse"]);
        assert!(coarse.body().nodes() < whole.body().nodes() && coarse.body().graph.stats.lattice_nodes > 0);
        let none = open(room(surface * 3 / 2), VolumeMode::Auto, false).unwrap();
        assert_eq!(codes(&none), ["volume-graph-too-large"]);
        assert_eq!(none.body().nodes() as u64, surface);
        assert!(open(room(surface * 3 / 2), VolumeMode::Required, false).is_err());
        assert!(matches!(
            open(room(surface / 2), VolumeMode::Auto, false),
            Err(Error::TooLarge { .. })
        ));
    }

    #[test]
    fn parts_without_an_inside_are_counted_and_placed() {
        let bench = open(1 << 30, VolumeMode::Auto, true).unwrap();
        let facts = bench.facts();
        let warning = facts.warnings.iter().find(|w| w.code == "surface-parts").unwrap();
        assert_eq!(
            warning.message,
            "1 of 2 parts enclose no volume or too little, so they deform as surfaces"
        );
        let place = WarningPlace::Points {
            text: "at (3, 0, 0)".into(),
            points: vec![DVec3::X * 3.0],
        };
        assert_eq!(warning.place, place);
        assert!(!codes(&open(1 << 30, VolumeMode::Off, true).unwrap()).contains(&"surface-parts".into()));
    }
}
