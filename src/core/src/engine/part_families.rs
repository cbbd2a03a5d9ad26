//! Which parts of a model were one: pieces that an edit has separated are not tied to each other again.

use super::error::{Error, InputPlace};
use super::riding::number_of_primitives;
use super::settings::KeptApart;
use crate::asset::Primitive;
use crate::deform::TieFamilies;
use crate::edit::{PatchedSurface, SurfacePatch, SurfaceView};
use crate::graph::LOOSE;
use crate::mesh::{Components, Mesh, NONE};
use std::sync::Arc;

/// The family of each point of a model. A connected part is of one family; so are the pieces that a cut makes of it, and
/// what an edit joins.
#[derive(Debug, Clone, Default)]
pub(super) struct PartFamilies {
    /// By point, or [`LOOSE`] on parts that get no ties; `None` where there is one family only.
    of_point: Option<Arc<Vec<u32>>>,
}

impl PartFamilies {
    /// Those of a model that no edit has touched: each part is a family, but for those to be kept apart.
    ///
    /// # Errors
    /// [`Error::Invalid`] for a primitive or part that there is not.
    pub fn of_model(
        mesh: &Mesh,
        parts: &Components,
        primitives: &[Primitive],
        kept_apart: &KeptApart,
    ) -> Result<Self, Error> {
        let loose = loose_parts(mesh, parts, primitives, kept_apart)?;
        if parts.count < 2 {
            return Ok(Self::default());
        }
        let family = |&part: &u32| if loose[part as usize] { LOOSE } else { part };
        Ok(Self {
            of_point: Some(Arc::new(parts.of_vertex.iter().map(family).collect())),
        })
    }

    /// Those after an edit of `before`, whose first `points` are those of this value.
    pub fn after_edit(
        &self,
        points: usize,
        before: &SurfaceView<'_>,
        applied: &PatchedSurface,
        patch: &SurfacePatch,
    ) -> Self {
        let merged = before.points as usize > points;
        if self.of_point.is_none() && !merged {
            return self.clone();
        }
        let known = self
            .of_point
            .as_ref()
            .map_or_else(|| vec![0; points], |f| f.as_ref().clone());
        let known = with_merged_parts(known, before);
        let old = before.positions.len();
        // Of a render vertex after the edit the family before it: its own, or that of what it is blended from.
        let family_before = |v: usize| {
            let was = applied.old_from_vertex[v] as usize;
            let source = match was.checked_sub(old) {
                None => was,
                Some(new) => {
                    let new = patch.vertices.get(new)?;
                    let heaviest = (0..3).reduce(|a, b| if new.weights[b] > new.weights[a] { b } else { a })?;
                    new.of[heaviest] as usize
                }
            };
            let point = *before.point_of.get(source)?;
            known.get(point as usize).copied().map(|family| (family, was < old))
        };
        let mut met: Vec<(u32, u32, bool)> = Vec::new();
        let corner = |v: &u32| applied.point_of[*v as usize];
        let triangles: Vec<[u32; 3]> = applied
            .triangles
            .iter()
            .map(|t| [0, 1, 2].map(|k| corner(&t[k])))
            .collect();
        let parts = Components::of_triangles(applied.points as usize, &triangles);
        for (v, &point) in applied.point_of.iter().enumerate().filter(|p| *p.1 != NONE) {
            if let Some((family, own)) = family_before(v) {
                met.push((parts.of_vertex[point as usize], family, own));
            }
        }
        met.sort_unstable();
        met.dedup();
        Self::joined_by_parts(&parts, &met)
    }

    /// One family for all that some part has vertices of. `met` has parts with the families of their vertices, sorted, and
    /// whether they are old vertices; those of new ones count where a part has no others.
    fn joined_by_parts(parts: &Components, met: &[(u32, u32, bool)]) -> Self {
        let families = met
            .iter()
            .map(|m| m.1)
            .filter(|f| *f != LOOSE)
            .max()
            .map_or(0, |f| f as usize + 1);
        // The last one stands for what is kept apart.
        let index = |family: u32| if family == LOOSE { families as u32 } else { family };
        let mut first = vec![NONE; parts.count];
        let mut same: Vec<(u32, u32)> = Vec::new();
        for own in [true, false] {
            let whole = first.clone();
            for &(part, family, _) in met
                .iter()
                .filter(|m| m.2 == own && (own || whole[m.0 as usize] == NONE))
            {
                let first = &mut first[part as usize];
                if *first == NONE {
                    *first = index(family);
                } else {
                    same.push((*first, index(family)));
                }
            }
        }
        let sets = Components::of_edges(families + 1, same.into_iter());
        let loose = sets.of_vertex[families];
        let family = |&part: &u32| match first[part as usize] {
            NONE => LOOSE,
            f if sets.of_vertex[f as usize] == loose => LOOSE,
            f => sets.of_vertex[f as usize],
        };
        let of_point: Vec<u32> = parts.of_vertex.iter().map(family).collect();
        let several = of_point.windows(2).any(|pair| pair[0] != pair[1]);
        Self {
            of_point: several.then(|| Arc::new(of_point)),
        }
    }

    /// As the body takes them.
    pub fn tie_families(&self) -> TieFamilies {
        self.of_point.clone().map_or(TieFamilies::One, TieFamilies::Of)
    }

    /// Bytes held.
    pub fn byte_size(&self) -> u64 {
        self.of_point.as_ref().map_or(0, |f| 4 * f.capacity() as u64)
    }
}

/// Appends families of their own for the parts that an edit brings in.
fn with_merged_parts(mut known: Vec<u32>, before: &SurfaceView<'_>) -> Vec<u32> {
    let first = known.len();
    let points = before.points as usize;
    if points <= first {
        return known;
    }
    let next = known.iter().filter(|f| **f != LOOSE).max().map_or(0, |f| f + 1);
    let triangles: Vec<[u32; 3]> = before
        .triangles
        .iter()
        .map(|t| t.map(|v| before.point_of[v as usize]))
        .filter(|t| t[0] as usize >= first)
        .map(|t| t.map(|p| p - first as u32))
        .collect();
    let parts = Components::of_triangles(points - first, &triangles);
    known.extend(parts.of_vertex.iter().map(|part| next + part));
    known
}

/// Which parts get no ties.
fn loose_parts(
    mesh: &Mesh,
    parts: &Components,
    primitives: &[Primitive],
    kept_apart: &KeptApart,
) -> Result<Vec<bool>, Error> {
    let mut loose = vec![false; parts.count];
    for (k, &part) in kept_apart.components.iter().enumerate() {
        let Some(loose) = loose.get_mut(part as usize) else {
            let problem = format!(
                "is {part}, the model has {} connected parts, counted from 0",
                parts.count
            );
            return Err(Error::invalid(InputPlace::KeptComponent(k), problem));
        };
        *loose = true;
    }
    for (k, &primitive) in kept_apart.primitives.iter().enumerate() {
        let Some(primitive) = primitives.get(primitive as usize) else {
            let problem = format!(
                "is {primitive}, the model has {}, counted from 0",
                number_of_primitives(primitives.len())
            );
            return Err(Error::invalid(InputPlace::KeptPrimitive(k), problem));
        };
        for v in primitive.vertices() {
            if let Some(&point) = mesh.solver_from_render.get(v).filter(|p| **p != NONE) {
                loose[parts.of_vertex[point as usize] as usize] = true;
            }
        }
    }
    Ok(loose)
}
