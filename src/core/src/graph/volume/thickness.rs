//! How thick parts are, and how wide the lattice inside of each is to be.
//!
//! The thickness of a part is its volume divided by its area, which says nothing of its triangles. Parts of about one thickness
//! share a lattice, and thinner ones have a finer one.

use crate::graph::volume::caps::HullFaces;
use crate::graph::volume::placing::SiteFacts;
use crate::graph::volume::shell::VolumeSite;
use crate::graph::volume::solid::PartKind;
use crate::mesh::BoundingBox;
use glam::DVec3;

/// Parts whose thickness differs by less than this factor share a lattice.
const ALIKE: f64 = 2.0;
/// Parts thinner than this share of the largest one are taken for as thick: lattices of more sizes cost more than they are worth.
const THINNEST: i32 = 8;

/// Hollows look for their solids among so many, the largest ones.
const MOST_SOLIDS: usize = 256;

/// Parts that share a lattice.
pub(in crate::graph) struct LatticeClass {
    /// Volume ÷ area.
    pub(in crate::graph) thickness: f64,
    pub(in crate::graph) volume: f64,
    /// The faces of closed parts and those whose holes have been closed.
    pub(in crate::graph) faces: Vec<[u32; 3]>,
    /// Whether soups belong to it.
    pub(in crate::graph) soup: bool,
    /// The box around all.
    pub(in crate::graph) bounds: BoundingBox,
}

/// Parts that belong together: a solid and its hollows.
#[derive(Clone, Copy, Default)]
struct MeasuredBody {
    volume: f64,
    area: f64,
}

impl MeasuredBody {
    fn thickness(&self) -> f64 {
        if self.volume > 0.0 && self.area > 0.0 {
            self.volume / self.area
        } else {
            0.0
        }
    }
}

/// How parts share lattices.
#[derive(Default)]
pub(in crate::graph) struct PartClasses {
    pub(in crate::graph) classes: Vec<LatticeClass>,
    /// For each part the number of its class.
    pub(in crate::graph) of_part: Vec<Option<usize>>,
}

/// The classes of all parts that enclose space, from that of the part with the most volume to thinner and to thicker ones.
/// `soup_volume` is what soups enclose.
pub(in crate::graph) fn lattice_classes(site: &VolumeSite, facts: &SiteFacts, soup_volume: f64) -> PartClasses {
    let turns = &facts.turns;
    let count = site.parts.components.count;
    let mut bodies = vec![MeasuredBody::default(); count + 1];
    let part = |t: &[u32; 3]| site.parts.components.of_vertex[t[0] as usize] as usize;
    let mut measured = vec![MeasuredBody::default(); count];
    let nothing = BoundingBox {
        min: DVec3::INFINITY,
        max: DVec3::NEG_INFINITY,
    };
    let mut boxes = vec![nothing; count];
    let hull = site.hull.unwrap_or(HullFaces {
        positions: &[],
        faces: &[],
    });
    for t in hull.faces {
        let [a, b, c] = t.map(|v| hull.positions[v as usize]);
        let middle = hull.positions[hull.faces[0][0] as usize];
        let own = &mut measured[part(t)];
        own.area += 0.5 * (b - a).cross(c - a).length();
        own.volume += (a - middle).cross(b - middle).dot(c - middle) / 6.0 * turns[part(t)];
        let around = &mut boxes[part(t)];
        *around = [a, b, c].into_iter().fold(*around, widened);
    }
    let body_of = solids_of_hollows(&measured, &boxes);
    for (own, &body) in measured.iter().zip(&body_of) {
        bodies[body].volume += own.volume;
        bodies[body].area += own.area;
    }
    if let Some(soup) = site.large_soup() {
        let area = |t: &[u32; 3]| {
            let [a, b, c] = t.map(|v| site.mesh.positions[v as usize]);
            0.5 * (b - a).cross(c - a).length()
        };
        bodies[count] = MeasuredBody {
            volume: soup_volume,
            // Soups are no thinner than their faces are long: more area than that lies inside of them.
            area: (soup.bvh().triangles().iter().map(area).sum::<f64>()).min(soup_volume / facts.mean_edge),
        };
    }
    let largest = bodies
        .iter()
        .copied()
        .reduce(|a, b| if b.volume > a.volume { b } else { a });
    let whole = largest.map_or(0.0, |b| b.thickness());
    if whole == 0.0 {
        return PartClasses {
            classes: Vec::new(),
            of_part: vec![None; count],
        };
    }
    let step = |body: &MeasuredBody| match body.thickness() {
        0.0 => 0,
        own => (libm::log2(whole / own) / libm::log2(ALIKE))
            .round()
            .clamp(-f64::from(THINNEST), f64::from(THINNEST)) as i32,
    };
    let mut steps: Vec<i32> = bodies.iter().filter(|b| b.area > 0.0).map(step).collect();
    steps.sort_unstable_by_key(|s| (s.abs(), *s));
    steps.dedup();
    let class = |&wanted: &i32| {
        let own = |body: usize| bodies[body].area > 0.0 && step(&bodies[body]) == wanted;
        let faces: Vec<[u32; 3]> = hull.faces.iter().filter(|t| own(body_of[part(t)])).copied().collect();
        let soup = site.large_soup().filter(|_| own(count));
        let in_soup = soup.iter().flat_map(|s| s.bvh().triangles()).flatten();
        let corners = faces.iter().flatten().map(|&v| hull.positions[v as usize]);
        let corners = corners.chain(in_soup.map(|&v| site.mesh.positions[v as usize]));
        LatticeClass {
            thickness: whole / libm::exp2(f64::from(wanted) * libm::log2(ALIKE)),
            volume: (0..=count).filter(|&b| own(b)).map(|b| bodies[b].volume.max(0.0)).sum(),
            soup: soup.is_some(),
            bounds: corners.fold(nothing, widened),
            faces,
        }
    };
    let body = |part: usize| match site.parts.kinds[part] {
        PartKind::Closed | PartKind::Holed => Some(body_of[part]),
        PartKind::Soup => Some(count),
        PartKind::Sheet => None,
    };
    let number = |part: usize| {
        let own = step(&bodies[body(part)?]);
        steps.iter().position(|s| *s == own)
    };
    PartClasses {
        classes: steps.iter().map(class).collect(),
        of_part: (0..count).map(number).collect(),
    }
}

fn widened(around: BoundingBox, p: DVec3) -> BoundingBox {
    BoundingBox {
        min: around.min.min(p),
        max: around.max.max(p),
    }
}

/// For each part the one that it belongs to: a hollow, whose normals lead out of it, to the smallest solid around it; any other to
/// itself.
fn solids_of_hollows(measured: &[MeasuredBody], boxes: &[BoundingBox]) -> Vec<usize> {
    let mut solids: Vec<usize> = (0..measured.len()).filter(|&p| measured[p].volume > 0.0).collect();
    solids.sort_by(|&a, &b| measured[b].volume.total_cmp(&measured[a].volume).then(a.cmp(&b)));
    solids.truncate(MOST_SOLIDS);
    let of = |part: usize| {
        let holds = |&&solid: &&usize| {
            let (outer, inner) = (&boxes[solid], &boxes[part]);
            outer.min.cmple(inner.min).all() && outer.max.cmpge(inner.max).all()
        };
        let is_hollow = measured[part].volume < 0.0;
        let around = is_hollow.then(|| solids.iter().rev().find(holds)).flatten();
        around.copied().unwrap_or(part)
    };
    (0..measured.len()).map(of).collect()
}
