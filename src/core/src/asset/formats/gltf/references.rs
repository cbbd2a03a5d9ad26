//! Where a document names accessors and buffer views, as slices of its text.

use super::schema::DRACO;
use super::text::{JsonEdits, list_of, members, parse_index, value_at, value_of};

/// Numbers in one item of a section.
#[derive(Default)]
pub(super) struct References<'a> {
    /// Those that name accessors.
    pub(super) accessors: Vec<&'a str>,
    /// Those that name buffer views.
    pub(super) views: Vec<&'a str>,
}

fn member_values(object: &str) -> Vec<&str> {
    members(object).map_or_else(|_| Vec::new(), |list| list.into_iter().map(|m| m.value).collect())
}

/// In a mesh.
pub(super) fn of_mesh(mesh: &str) -> References<'_> {
    let mut places = References::default();
    for primitive in list_of(mesh, "primitives") {
        places
            .accessors
            .extend(value_of(primitive, "attributes").map(member_values).unwrap_or_default());
        places
            .accessors
            .extend(list_of(primitive, "targets").into_iter().flat_map(member_values));
        places.accessors.extend(value_of(primitive, "indices"));
        places
            .views
            .extend(value_at(primitive, &["extensions", DRACO, "bufferView"]));
    }
    places
}

/// In a skin.
pub(super) fn of_skin(skin: &str) -> References<'_> {
    References {
        accessors: value_of(skin, "inverseBindMatrices").into_iter().collect(),
        views: Vec::new(),
    }
}

/// In an animation.
pub(super) fn of_animation(animation: &str) -> References<'_> {
    let named = |sampler| {
        ["input", "output"]
            .into_iter()
            .filter_map(move |key| value_of(sampler, key))
    };
    References {
        accessors: list_of(animation, "samplers").into_iter().flat_map(named).collect(),
        views: Vec::new(),
    }
}

/// In a node: the attributes of its instances.
pub(super) fn of_node(node: &str) -> References<'_> {
    let attributes = value_at(node, &["extensions", "EXT_mesh_gpu_instancing", "attributes"]);
    References {
        accessors: attributes.map(member_values).unwrap_or_default(),
        views: Vec::new(),
    }
}

/// In an accessor.
pub(super) fn of_accessor(accessor: &str) -> References<'_> {
    let paths: [&[&str]; 3] = [
        &["bufferView"],
        &["sparse", "indices", "bufferView"],
        &["sparse", "values", "bufferView"],
    ];
    References {
        accessors: Vec::new(),
        views: paths.into_iter().filter_map(|path| value_at(accessor, path)).collect(),
    }
}

/// In an image.
pub(super) fn of_image(image: &str) -> References<'_> {
    References {
        accessors: Vec::new(),
        views: value_of(image, "bufferView").into_iter().collect(),
    }
}

/// The text with its references renumbered; those that have no new number stay.
pub(super) fn renumber_references<'a>(
    text: &'a str,
    of: impl Fn(&'a str) -> References<'a>,
    accessor: impl Fn(usize) -> Option<usize>,
    view: impl Fn(usize) -> Option<usize>,
) -> String {
    let places = of(text);
    let mut edits = JsonEdits::new(text);
    for place in places.accessors {
        if let Some(new) = parse_index(place).and_then(&accessor) {
            edits.replace(place, new.to_string());
        }
    }
    for place in places.views {
        if let Some(new) = parse_index(place).and_then(&view) {
            edits.replace(place, new.to_string());
        }
    }
    edits.apply()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reference_of_a_mesh_is_found_and_renumbered() {
        let mesh = r#"{"primitives":[{"attributes":{"POSITION":1,"_X":2},"indices":3,"targets":[{"POSITION":4}],
            "extensions":{"KHR_draco_mesh_compression":{"bufferView":1,"attributes":{"POSITION":1}}},"extras":{"indices":9}}]}"#;
        let new = renumber_references(mesh, of_mesh, |a| Some(a + 10), |v| Some(v + 20));
        let expected = r#"{"primitives":[{"attributes":{"POSITION":11,"_X":12},"indices":13,"targets":[{"POSITION":14}],
            "extensions":{"KHR_draco_mesh_compression":{"bufferView":21,"attributes":{"POSITION":1}}},"extras":{"indices":9}}]}"#;
        assert_eq!(new, expected);
    }
}
