//! Pictures that an agent sees: a shape from several sides, with regions in colours.

use crate::words::VertexSet;
use glam::{DMat3, DVec3, Vec3};
use pliant_asset::{Geometry, is_hidden};
use pliant_core::engine::{Deformer, Error};
use pliant_exec::Exec;
use pliant_render::{
    Camera, Picture, PictureSize, Rgb, ShadedSurface, SurfaceDress, UpAxis, ViewDirection, draw_surface,
};
use std::sync::Arc;

/// Bytes of scratch for each render vertex while a picture is drawn: the welded surface, its normals and colours.
pub(crate) const BYTES_PER_VERTEX: u64 = 512;
/// Pixels of a tile, least and most along each side.
pub(crate) const SIDES: std::ops::RangeInclusive<u32> = 64..=2048;

/// Linear light of the surface, and of regions in turn.
const PLAIN: Vec3 = Vec3::new(0.42, 0.42, 0.42);
const COLOURS: [Vec3; 6] = [
    Vec3::new(0.9, 0.22, 0.02),
    Vec3::new(0.03, 0.2, 0.75),
    Vec3::new(0.05, 0.45, 0.08),
    Vec3::new(0.55, 0.04, 0.5),
    Vec3::new(0.7, 0.5, 0.02),
    Vec3::new(0.02, 0.45, 0.5),
];
/// The same as pixels, for words.
const INKS: [Rgb; 6] = [
    [228, 110, 20],
    [40, 110, 215],
    [50, 155, 65],
    [180, 45, 170],
    [195, 150, 20],
    [25, 155, 165],
];

/// From where a shape is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum View {
    /// What faces the figure's front.
    Front,
    Back,
    /// From the figure's own left.
    Left,
    Right,
    Top,
    Bottom,
    /// From the front, its left and a little above.
    ThreeQuarter,
}

impl View {
    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Front => "front",
            Self::Back => "back",
            Self::Left => "left",
            Self::Right => "right",
            Self::Top => "top",
            Self::Bottom => "bottom",
            Self::ThreeQuarter => "three-quarter",
        }
    }

    fn direction(self) -> Result<ViewDirection, pliant_render::Error> {
        let (azimuth, elevation) = match self {
            Self::Front => (0.0, 0.0),
            Self::Back => (180.0, 0.0),
            Self::Left => (90.0, 0.0),
            Self::Right => (-90.0, 0.0),
            Self::Top => (0.0, 90.0),
            Self::Bottom => (0.0, -90.0),
            Self::ThreeQuarter => (35.0, 18.0),
        };
        ViewDirection::new(azimuth, elevation, UpAxis::Y)
    }
}

/// A picture that is asked for.
#[derive(Debug, Clone)]
pub(crate) struct PictureOrder {
    /// One tile each, side by side.
    pub views: Vec<View>,
    /// Pixels of a tile.
    pub size: [u32; 2],
}

/// The triangles that are drawn: one that is hidden has one corner three times. Where everything is hidden, nothing is.
fn shown(geometry: &Geometry) -> Vec<[u32; 3]> {
    let mut triangles = geometry.triangles.clone();
    let hidden: Vec<_> = geometry
        .primitives
        .iter()
        .filter(|p| is_hidden(&p.name))
        .map(|p| p.vertices())
        .collect();
    if hidden.len() < geometry.primitives.len() {
        for t in &mut triangles {
            if hidden.iter().any(|own| own.contains(&(t[0] as usize))) {
                *t = [t[0]; 3];
            }
        }
    }
    triangles
}

/// Draws a shape, with regions in colours of their own and what they are called.
pub(crate) fn draw(
    deformer: &Deformer,
    positions: &[DVec3],
    upright: DMat3,
    regions: &[(String, VertexSet)],
    order: &PictureOrder,
    exec: &Exec<'_>,
) -> Result<Vec<u8>, Error> {
    let refuse = |e: pliant_render::Error| Error::Internal(format!("a picture: {e}"));
    let [width, height] = order.size;
    let size = PictureSize::new(width, height).map_err(refuse)?;
    let surface = match regions.is_empty() && !deformer.is_edited() {
        true => dressed(deformer, positions, upright, exec).map_err(refuse)?,
        false => None,
    };
    let surface = match surface {
        Some(surface) => surface,
        None => {
            let places: Vec<DVec3> = positions.iter().map(|p| upright * *p).collect();
            let colour = |v: usize| {
                let last = regions.iter().enumerate().rev().find(|(_, (_, set))| set.has(v));
                last.map_or(PLAIN, |(k, _)| COLOURS[k % COLOURS.len()])
            };
            let colours: Vec<Vec3> = (0..places.len()).map(colour).collect();
            let bare = ShadedSurface::new(&places, &shown(deformer.geometry()), exec.pool).map_err(refuse)?;
            bare.with_colours(&colours).map_err(refuse)?
        }
    };
    let directions: Result<Vec<ViewDirection>, _> = order.views.iter().map(|view| view.direction()).collect();
    let cameras = Camera::around_surfaces(&[&surface], &directions.map_err(refuse)?, size);
    let tiles = u32::try_from(cameras.len()).unwrap_or(1);
    let mut sheet = Picture::new(u64::from(width) * u64::from(tiles), u64::from(height), [255; 3]).map_err(refuse)?;
    for (k, (camera, view)) in (0u32..).zip(cameras.iter().zip(&order.views)) {
        exec.check()?;
        let mut tile = draw_surface(&surface, camera, exec.pool);
        let dot = (width.min(height) / 240).clamp(1, 4);
        let line = Picture::text_size(dot, "x").1 + 3 * dot;
        tile.write_text(4 * dot, 4 * dot, dot, view.name(), [60, 60, 60]);
        if k == 0 {
            for (row, (name, _)) in (1u32..).zip(regions.iter().take(12)) {
                let ink = INKS[(row as usize - 1) % INKS.len()];
                let shown: String = name.chars().filter(char::is_ascii).take(36).collect();
                tile.write_text(4 * dot, 4 * dot + row * line, dot, &shown, ink);
            }
        }
        sheet.paste_picture(&tile, k * width, 0);
    }
    sheet.encode_png().map_err(refuse)
}

/// The shape in its own base colours; `None` where it has none.
fn dressed(
    deformer: &Deformer,
    positions: &[DVec3],
    upright: DMat3,
    exec: &Exec<'_>,
) -> Result<Option<ShadedSurface>, pliant_render::Error> {
    let Ok(drawn) = deformer.model().drawn() else {
        return Ok(None);
    };
    if drawn.look.is_bare() {
        return Ok(None);
    }
    let own: Vec<DVec3> = drawn
        .vertices
        .iter()
        .filter_map(|v| positions.get(*v as usize).copied())
        .collect();
    if own.len() != drawn.vertices.len() {
        return Ok(None);
    }
    let rest = &drawn.geometry;
    let normals: Vec<Vec3> = match rest.normals.is_empty() {
        true => Vec::new(),
        false => (rest.deformed(&own).normals.iter())
            .map(|n| (upright * n.as_dvec3()).as_vec3())
            .collect(),
    };
    let places: Vec<DVec3> = own.iter().map(|p| upright * *p).collect();
    let mut faults = Vec::new();
    let dress = SurfaceDress::of_model(&drawn.look, &rest.primitives, &rest.triangles, &mut faults)?;
    let triangles = shown(rest);
    let surface = ShadedSurface::new(&places, &triangles, exec.pool)?;
    let shaded = surface.with_normals(&normals, &triangles, drawn.look.is_flat_without_normals)?;
    Ok(Some(shaded.with_dress(Arc::new(dress))))
}
