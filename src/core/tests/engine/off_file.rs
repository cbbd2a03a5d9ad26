//! Surfaces as files.

use glam::DVec3;
use pliant_core::asset::FileSet;

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
