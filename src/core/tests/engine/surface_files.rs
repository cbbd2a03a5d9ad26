//! Surfaces as files.

use glam::DVec3;
use pliant_core::asset::{FileSet, shapes};

/// Places and triangles.
pub(crate) type Surface = (Vec<DVec3>, Vec<[u32; 3]>);

/// An OFF file of a surface.
pub(crate) fn file_of((points, triangles): &Surface) -> FileSet {
    let mut text = format!("OFF\n{} {} 0\n", points.len(), triangles.len());
    points
        .iter()
        .for_each(|p| text += &format!("{} {} {}\n", p.x, p.y, p.z));
    triangles
        .iter()
        .for_each(|[a, b, c]| text += &format!("3 {a} {b} {c}\n"));
    FileSet::single("model.off", text)
}

/// A model of some shapes, each moved, without anything that ties them.
pub(crate) fn file_of_parts(parts: &[(&shapes::Shape, DVec3)]) -> FileSet {
    let (mut text, mut first) = (String::new(), 1);
    for ((points, triangles), by) in parts {
        for p in points.iter().map(|p| *p + *by) {
            text += &format!("v {} {} {}\n", p.x as f32, p.y as f32, p.z as f32);
        }
        for [a, b, c] in triangles.iter().map(|t| t.map(|v| v + first)) {
            text += &format!("f {a} {b} {c}\n");
        }
        first += points.len() as u32;
    }
    FileSet::single("parts.obj", text)
}
