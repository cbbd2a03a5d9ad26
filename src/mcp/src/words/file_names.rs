//! Names that the model's file gives to vertices: of primitives, materials and blend shapes.

use super::figure::RestFigure;
use super::joints::name_words;
use super::vertex_set::VertexSet;
use pliant_core::engine::Error;
use std::collections::BTreeMap;

/// A shape moves a vertex that goes this share of its longest way, at least.
const MOVED: f32 = 0.02;

/// Blend shapes that are known by their names: each is a set of vertices.
const MOST_SHAPES: usize = 128;

/// What a file calls vertices, in the order of the file.
pub(crate) struct FileNames(pub Vec<FileName>);

/// A name, what has it, and its vertices.
pub(crate) struct FileName {
    pub name: String,
    pub kind: &'static str,
    pub set: VertexSet,
}

impl FileNames {
    /// The names of a model. Those of its blend shapes are known as long as no edit has changed it.
    pub fn of(figure: &RestFigure<'_>) -> Result<Self, Error> {
        let (deformer, count) = (figure.deformer, figure.count());
        let mut names: Vec<FileName> = Vec::new();
        let mut add = |name: &str, kind: &'static str, set: VertexSet| {
            let same = |own: &&mut FileName| own.kind == kind && own.name == name;
            match names.iter_mut().find(same) {
                Some(own) => own.set = own.set.clone().or(&set),
                None if !name.trim().is_empty() => names.push(FileName {
                    name: name.to_owned(),
                    kind,
                    set,
                }),
                None => {}
            }
        };
        for primitive in &deformer.geometry().primitives {
            let own = primitive.vertices();
            add(&primitive.name, "mesh", VertexSet::of(count, |v| own.contains(&v)));
        }
        if !deformer.is_edited() {
            let drawn = deformer.model().drawn()?;
            let mut by_material: BTreeMap<u32, VertexSet> = BTreeMap::new();
            for (primitive, material) in drawn.geometry.primitives.iter().zip(&drawn.look.material_of) {
                let list: Vec<u32> = drawn.vertices.get(primitive.vertices()).unwrap_or_default().to_vec();
                let set = VertexSet::of_list(count, &list);
                let known = by_material.remove(material).unwrap_or_else(|| VertexSet::none(count));
                by_material.insert(*material, known.or(&set));
            }
            for (material, set) in by_material {
                if let Some(own) = drawn.look.materials.get(material as usize) {
                    add(&own.name, "material", set);
                }
            }
            for shape in deformer.model().blend_shapes()?.shapes.into_iter().take(MOST_SHAPES) {
                let longest = shape.moves.iter().map(|m| m.length()).fold(0.0, f32::max);
                let moves = |v: usize| shape.moves.get(v).is_some_and(|m| m.length() > MOVED * longest);
                add(&shape.name, "blend shape", VertexSet::of(count, moves));
            }
        }
        for own in &mut names {
            own.set = own.set.clone().and(&figure.all);
        }
        names.retain(|own| own.set.count() > 0);
        Ok(Self(names))
    }

    /// What has exactly this name, whatever its capitals.
    pub fn exact(&self, name: &str) -> Option<&FileName> {
        self.0.iter().find(|own| own.name.trim().eq_ignore_ascii_case(name))
    }

    /// What has a name with all of the words.
    pub fn with_words(&self, words: &[&str]) -> Vec<&FileName> {
        let wanted: Vec<String> = words.iter().flat_map(|w| name_words(w)).collect();
        let fits = |own: &&FileName| {
            let words = name_words(&own.name);
            !wanted.is_empty() && wanted.iter().all(|w| words.contains(w))
        };
        let found: Vec<&FileName> = self.0.iter().filter(fits).collect();
        // Meshes before materials before shapes: one kind at a time.
        let kind = found.first().map(|own| own.kind);
        found.into_iter().filter(|own| Some(own.kind) == kind).collect()
    }
}
