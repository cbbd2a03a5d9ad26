//! Where a document names accessors and buffer views, as slices of its text; and checks of all references and ranges, so that
//! nothing later can read past a buffer or miss an index.

use super::document::GltfDocument;
use super::schema::{Attributes, BufferView, DRACO, ViewCompression};
use super::text::{JsonEdits, items, members, parse_index, value_of};
use crate::Error;

/// A way from an item down to a number: keys, and `*` for every member of an object or item of a list.
type ReferencePath = &'static [&'static str];

/// Where items of one section name accessors and buffer views.
pub(super) struct ReferencePlaces {
    accessors: &'static [ReferencePath],
    views: &'static [ReferencePath],
}

pub(super) const IN_MESH: ReferencePlaces = ReferencePlaces {
    accessors: &[
        &["primitives", "*", "attributes", "*"],
        &["primitives", "*", "targets", "*", "*"],
        &["primitives", "*", "indices"],
    ],
    views: &[&["primitives", "*", "extensions", DRACO, "bufferView"]],
};
pub(super) const IN_SKIN: ReferencePlaces = ReferencePlaces {
    accessors: &[&["inverseBindMatrices"]],
    views: &[],
};
pub(super) const IN_ANIMATION: ReferencePlaces = ReferencePlaces {
    accessors: &[&["samplers", "*", "input"], &["samplers", "*", "output"]],
    views: &[],
};
/// The attributes of a node's instances.
pub(super) const IN_NODE: ReferencePlaces = ReferencePlaces {
    accessors: &[&["extensions", "EXT_mesh_gpu_instancing", "attributes", "*"]],
    views: &[],
};
pub(super) const IN_ACCESSOR: ReferencePlaces = ReferencePlaces {
    accessors: &[],
    views: &[
        &["bufferView"],
        &["sparse", "indices", "bufferView"],
        &["sparse", "values", "bufferView"],
    ],
};
pub(super) const IN_IMAGE: ReferencePlaces = ReferencePlaces {
    accessors: &[],
    views: &[&["bufferView"]],
};

/// Finds the values at a path below a value.
fn find_at<'a>(value: &'a str, path: &[&str], found: &mut Vec<&'a str>) {
    match path {
        [] => found.push(value),
        ["*", rest @ ..] => match members(value) {
            Ok(list) => list.iter().for_each(|member| find_at(member.value, rest, found)),
            Err(_) => items(value)
                .into_iter()
                .flatten()
                .for_each(|item| find_at(item, rest, found)),
        },
        [key, rest @ ..] => {
            if let Some(value) = value_of(value, key) {
                find_at(value, rest, found);
            }
        }
    }
}

fn find_all<'a>(item: &'a str, paths: &[ReferencePath]) -> Vec<&'a str> {
    let mut found = Vec::new();
    paths.iter().for_each(|path| find_at(item, path, &mut found));
    found
}

impl ReferencePlaces {
    /// The accessors that an item names, once for each place.
    pub(super) fn accessors(&self, item: &str) -> Vec<usize> {
        let found = find_all(item, self.accessors).into_iter();
        found.filter_map(parse_index).collect()
    }

    /// The buffer views that an item names, once for each place.
    pub(super) fn views(&self, item: &str) -> Vec<usize> {
        let found = find_all(item, self.views).into_iter();
        found.filter_map(parse_index).collect()
    }

    /// The item with its references renumbered; those that have no new number stay.
    pub(super) fn renumber(
        &self,
        item: &str,
        accessor: impl Fn(usize) -> Option<usize>,
        view: impl Fn(usize) -> Option<usize>,
    ) -> String {
        let mut edits = JsonEdits::new(item);
        let mut replace = |paths, new: &dyn Fn(usize) -> Option<usize>| {
            for place in find_all(item, paths) {
                if let Some(new) = parse_index(place).and_then(new) {
                    edits.replace(place, new.to_string());
                }
            }
        };
        replace(self.accessors, &accessor);
        replace(self.views, &view);
        edits.apply()
    }
}

/// The accessors that nodes, skins and animations of a document name, once for each place.
pub(super) fn accessors_beside_meshes(doc: &GltfDocument<'_>) -> impl Iterator<Item = usize> {
    let animations = doc.items(&doc.animations).flat_map(|text| IN_ANIMATION.accessors(text));
    let skins = doc.items(&doc.skins).flat_map(|text| IN_SKIN.accessors(text));
    let nodes = doc.items(&doc.nodes).flat_map(|text| IN_NODE.accessors(text));
    animations.chain(skins).chain(nodes)
}

/// Checks every reference between buffers, views, accessors, meshes, nodes and scenes, and every byte range.
pub(super) fn check(doc: &GltfDocument<'_>) -> Result<(), Error> {
    for (i, view) in doc.views.values.iter().enumerate() {
        check_view(doc, i, view)?;
    }
    for i in 0..doc.accessors.len() {
        check_accessor(doc, i)?;
    }
    for mesh in 0..doc.meshes.len() {
        check_mesh(doc, mesh)?;
    }
    check_nodes(doc)
}

/// Refuses the index of something that the document does not have; `what` names one of its sections, nodes where it names none.
fn in_range(doc: &GltfDocument<'_>, place: impl Fn() -> String, index: usize, what: &str) -> Result<(), Error> {
    let count = match what {
        "buffer" => doc.buffers.len(),
        "buffer view" => doc.views.len(),
        "accessor" => doc.accessors.len(),
        "mesh" => doc.meshes.len(),
        "skin" => doc.skins.len(),
        "scene" => doc.scenes.len(),
        _ => doc.nodes.len(),
    };
    if index < count {
        return Ok(());
    }
    Err(doc
        .fault
        .malformed(place(), format!("{what} {index} does not exist, there are {count}")))
}

/// `offset + length <= size`, without overflow.
fn fits(offset: u64, length: u64, size: u64) -> bool {
    offset.checked_add(length).is_some_and(|end| end <= size)
}

fn check_view(doc: &GltfDocument<'_>, i: usize, view: &BufferView) -> Result<(), Error> {
    let place = || format!("bufferViews/{i}");
    in_range(doc, || place() + "/buffer", view.buffer.index(), "buffer")?;
    let size = doc.buffers.values[view.buffer.index()].byte_length.0;
    if !fits(view.offset(), view.byte_length.0, size) {
        let problem = format!(
            "{} bytes from {} on do not fit into buffer {} of {size} bytes",
            view.byte_length.0,
            view.offset(),
            view.buffer.0
        );
        return Err(doc.fault.malformed(place(), problem));
    }
    if let Some(stride) = view.byte_stride
        && (!(4..=252).contains(&stride.0) || stride.0 % 4 != 0)
    {
        let problem = format!("{} is not a multiple of 4 from 4 to 252", stride.0);
        return Err(doc.fault.malformed(place() + "/byteStride", problem));
    }
    view.compression()
        .map_or(Ok(()), |c| check_compression(doc, i, view, c))
}

fn check_compression(doc: &GltfDocument<'_>, i: usize, view: &BufferView, c: &ViewCompression) -> Result<(), Error> {
    let place = || format!("bufferViews/{i}/extensions/meshopt_compression");
    in_range(doc, || place() + "/buffer", c.buffer.index(), "buffer")?;
    let size = doc.buffers.values[c.buffer.index()].byte_length.0;
    if !fits(c.offset(), c.byte_length.0, size) {
        let problem = format!(
            "{} bytes from {} on do not fit into {size} bytes",
            c.byte_length.0,
            c.offset()
        );
        return Err(doc.fault.malformed(place(), problem));
    }
    let decoded = c.count.0.checked_mul(c.byte_stride.0);
    if decoded != Some(view.byte_length.0) {
        let problem = format!(
            "{} elements of {} bytes do not make the view's {} bytes",
            c.count.0, c.byte_stride.0, view.byte_length.0
        );
        return Err(doc.fault.malformed(place(), problem));
    }
    Ok(())
}

fn check_accessor(doc: &GltfDocument<'_>, i: usize) -> Result<(), Error> {
    let place = || format!("accessors/{i}");
    let accessor = &doc.accessors.values[i];
    if let Some(view) = accessor.buffer_view {
        in_range(doc, || place() + "/bufferView", view.index(), "buffer view")?;
    }
    // An accessor of a type we do not know is that of an extension; where it is used as geometry it is refused.
    let Some(layout) = doc.layout(i) else {
        return Ok(());
    };
    let component = layout.component.size() as u64;
    if let Some(view) = accessor.buffer_view {
        let view = &doc.views.values[view.index()];
        if layout.stride < layout.element {
            let problem = format!("elements of {} bytes at a stride of {}", layout.element, layout.stride);
            return Err(doc.fault.malformed(place(), problem));
        }
        if !accessor.offset().is_multiple_of(component) || !view.offset().is_multiple_of(component) {
            let problem = format!("byte offset {} is not a multiple of {component}", accessor.offset());
            return Err(doc.fault.malformed(place(), problem));
        }
        let last = accessor.count.0.saturating_sub(1).checked_mul(layout.stride);
        let needed = if accessor.count.0 == 0 {
            Some(0)
        } else {
            last.and_then(|l| l.checked_add(layout.element))
        };
        if !needed.is_some_and(|needed| fits(accessor.offset(), needed, view.byte_length.0)) {
            let problem = format!(
                "{} elements of {} bytes at a stride of {} from byte {} on do not fit into a view of {} bytes",
                accessor.count.0,
                layout.element,
                layout.stride,
                accessor.offset(),
                view.byte_length.0
            );
            return Err(doc.fault.malformed(place(), problem));
        }
    }
    let Some(sparse) = &accessor.sparse else { return Ok(()) };
    let place = || format!("accessors/{i}/sparse");
    if sparse.count.0 > accessor.count.0 {
        let problem = format!("{} of {} elements are replaced", sparse.count.0, accessor.count.0);
        return Err(doc.fault.malformed(place() + "/count", problem));
    }
    let index_size = match sparse.indices.component_type.0 {
        5121 => 1,
        5123 => 2,
        5125 => 4,
        other => {
            let problem = format!("{other} is not one of 5121, 5123 and 5125");
            return Err(doc.fault.malformed(place() + "/indices/componentType", problem));
        }
    };
    let parts = [
        (
            "indices",
            sparse.indices.buffer_view,
            sparse.indices.byte_offset,
            index_size,
        ),
        (
            "values",
            sparse.values.buffer_view,
            sparse.values.byte_offset,
            layout.element,
        ),
    ];
    for (what, view, offset, size) in parts {
        let place = || format!("accessors/{i}/sparse/{what}");
        in_range(doc, place, view.index(), "buffer view")?;
        let available = doc.views.values[view.index()].byte_length.0;
        if !sparse
            .count
            .0
            .checked_mul(size)
            .is_some_and(|needed| fits(offset.0, needed, available))
        {
            let problem = format!(
                "{} elements of {size} bytes from byte {} on do not fit into a view of {available} bytes",
                sparse.count.0, offset.0
            );
            return Err(doc.fault.malformed(place(), problem));
        }
    }
    Ok(())
}

fn check_mesh(doc: &GltfDocument<'_>, mesh: usize) -> Result<(), Error> {
    for (p, primitive) in doc.meshes.values[mesh].primitives.iter().enumerate() {
        let place = || format!("meshes/{mesh}/primitives/{p}");
        if primitive.mode() > 6 {
            let problem = format!("{} is not a mode from 0 to 6", primitive.mode());
            return Err(doc.fault.malformed(place() + "/mode", problem));
        }
        if let Some(indices) = primitive.indices {
            in_range(doc, || place() + "/indices", indices.index(), "accessor")?;
        }
        let vertices = primitive
            .attribute("POSITION")
            .and_then(|a| doc.accessors.get(a))
            .map(|a| a.count.0);
        check_attributes(doc, || place() + "/attributes", &primitive.attributes, vertices)?;
        for (t, target) in primitive.targets.iter().enumerate() {
            check_attributes(doc, || format!("{}/targets/{t}", place()), target, vertices)?;
        }
    }
    Ok(())
}

fn check_attributes(
    doc: &GltfDocument<'_>,
    place: impl Fn() -> String,
    attributes: &Attributes,
    vertices: Option<u64>,
) -> Result<(), Error> {
    for (name, accessor) in attributes {
        in_range(doc, || format!("{}/{name}", place()), accessor.index(), "accessor")?;
        let count = doc.accessors.values[accessor.index()].count.0;
        // Without POSITION the first attribute is as good as any to compare with; such a primitive draws nothing.
        if vertices.is_some_and(|vertices| vertices != count) {
            let problem = format!("{count} elements, POSITION has {}", vertices.unwrap_or_default());
            return Err(doc.fault.malformed(format!("{}/{name}", place()), problem));
        }
    }
    Ok(())
}

fn check_nodes(doc: &GltfDocument<'_>) -> Result<(), Error> {
    for (i, node) in doc.nodes.values.iter().enumerate() {
        for child in &node.children {
            in_range(doc, || format!("nodes/{i}/children"), child.index(), "node")?;
        }
        if let Some(mesh) = node.mesh {
            in_range(doc, || format!("nodes/{i}/mesh"), mesh.index(), "mesh")?;
        }
        if let Some(skin) = node.skin {
            in_range(doc, || format!("nodes/{i}/skin"), skin.index(), "skin")?;
        }
    }
    for (i, scene) in doc.scenes.values.iter().enumerate() {
        for node in &scene.nodes {
            in_range(doc, || format!("scenes/{i}/nodes"), node.index(), "node")?;
        }
    }
    if let Some(scene) = doc.scene {
        in_range(doc, || "scene".into(), scene, "scene")?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_reference_of_a_mesh_is_found_and_renumbered() {
        let mesh = r#"{"primitives":[{"attributes":{"POSITION":1,"_X":2},"indices":3,"targets":[{"POSITION":4}],
            "extensions":{"KHR_draco_mesh_compression":{"bufferView":1,"attributes":{"POSITION":1}}},"extras":{"indices":9}}]}"#;
        let new = IN_MESH.renumber(mesh, |a| Some(a + 10), |v| Some(v + 20));
        let expected = r#"{"primitives":[{"attributes":{"POSITION":11,"_X":12},"indices":13,"targets":[{"POSITION":14}],
            "extensions":{"KHR_draco_mesh_compression":{"bufferView":21,"attributes":{"POSITION":1}}},"extras":{"indices":9}}]}"#;
        assert_eq!(new, expected);
    }
}
