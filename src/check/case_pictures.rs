//! Pictures of a case: before, after, expected, and where the two differ.

use super::case_result::CaseResult;
use super::comparison::GoldenComparison;
use super::named::{self, Named};
use crate::mesh::BoundingBox;
use crate::mesh::query::TriangleBvh;
use crate::pool::Pool;
use crate::render::{
    Camera, ColourKey, ColourRamp, Error, Picture, PictureSize, RingMark, ShadedSurface, UpAxis, ViewDirection,
    background_end, draw_surface, vertex_displacements,
};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};

/// Rows below a picture for the key to its colours.
const KEY_ROWS: u32 = 30;
/// A close-up shows this share of the diagonal around its place.
const NEAR: f64 = 0.045;

/// Which of a case's pictures one is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[allow(missing_docs)]
pub enum PictureCaption {
    Before,
    After,
    Expected,
    Difference,
    WorstPlace,
}

impl Named for PictureCaption {
    const WHAT: &'static str = "a caption";
    const NAMES: &'static [(Self, &'static str)] = &[
        (Self::Before, "before"),
        (Self::After, "after"),
        (Self::Expected, "expected"),
        (Self::Difference, "difference"),
        (Self::WorstPlace, "worst place"),
    ];
}

/// A case picture is a picture with what it shows.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CasePicture {
    /// A word or two.
    #[serde(with = "named")]
    pub caption: PictureCaption,
    /// What it shows, for those who cannot see it.
    pub description: String,
    /// Pixels across and down.
    pub size: [u32; 2],
    /// A PNG file; base64 in JSON.
    #[serde(with = "png_text")]
    pub png: Vec<u8>,
}

/// PNG files as base64.
mod png_text {
    use base64::Engine as _;
    use base64::engine::general_purpose::STANDARD;
    use serde::de::Error as _;
    use serde::{Deserialize as _, Deserializer, Serializer};

    /// How every PNG file begins.
    const PNG: &[u8] = b"\x89PNG\r\n\x1a\n";

    pub(super) fn serialize<S: Serializer>(png: &[u8], serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&STANDARD.encode(png))
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<u8>, D::Error> {
        let text = String::deserialize(deserializer)?;
        let png = STANDARD
            .decode(text)
            .map_err(|e| D::Error::custom(format!("is not base64: {e}")))?;
        match png.starts_with(PNG) {
            true => Ok(png),
            false => Err(D::Error::custom("is not a PNG file")),
        }
    }
}

/// A viewpoint says from where a case is looked at.
#[derive(Debug, Clone, Copy)]
pub struct Viewpoint {
    /// What the case asks for; `None` = towards the worst place, else from the front.
    pub view: Option<ViewDirection>,
    /// The axis that points up.
    pub up: UpAxis,
}

/// Draws a finite result. Without a comparison, or where nothing differs, there are the shapes before and after only.
///
/// # Errors
/// What cannot be drawn, such as a result without any triangle.
pub fn draw_case_pictures(
    found: &CaseResult,
    comparison: Option<&GoldenComparison>,
    eye: Viewpoint,
    pool: &Pool,
) -> Result<Vec<CasePicture>, Error> {
    let after = ShadedSurface::new(&found.positions, &found.triangles, pool)?;
    let before = ShadedSurface::new(&found.before.0, &found.before.1, pool)?;
    let differing = comparison.filter(|c| c.stored != found.positions);
    let expected = match differing {
        Some(GoldenComparison {
            stored,
            triangles: Some(triangles),
            ..
        }) => Some(ShadedSurface::new(stored, triangles, pool)?),
        _ => None,
    };
    let worst: Vec<u32> = differing.map(|c| c.worst.clone()).unwrap_or_default();
    let view = eye.view.unwrap_or_else(|| match worst.first() {
        Some(&v) => view_from_beside(normal_at(found, v), eye.up),
        None => ViewDirection::facing(DVec3::new(0.47, 0.34, 0.81), eye.up),
    });
    let shapes: Vec<&ShadedSurface> = [Some(&before), Some(&after), expected.as_ref()]
        .into_iter()
        .flatten()
        .collect();
    let Some(camera) = Camera::around_surfaces(&shapes, &[view], PictureSize::new(480, 360)?)
        .into_iter()
        .next()
    else {
        return Ok(Vec::new());
    };
    let shown = [
        (PictureCaption::Before, "the model in the rest pose", Some(&before)),
        (PictureCaption::After, "the result", Some(&after)),
        (
            PictureCaption::Expected,
            "the result that the golden stores",
            expected.as_ref(),
        ),
    ];
    let mut pictures = Vec::new();
    for (caption, text, surface) in shown {
        if let Some(surface) = surface {
            pictures.push(encode_case_picture(
                caption,
                text.into(),
                draw_surface(surface, &camera, pool),
            )?);
        }
    }
    if let Some(comparison) = differing.filter(|c| c.stored.len() == found.positions.len()) {
        pictures.extend(draw_differences(found, comparison, after, &camera, eye.up, pool)?);
    }
    Ok(pictures)
}

/// Draws the result in colours that say how far each vertex is from its stored place, as a whole and near the worst place.
fn draw_differences(
    found: &CaseResult,
    comparison: &GoldenComparison,
    after: ShadedSurface,
    camera: &Camera,
    up: UpAxis,
    pool: &Pool,
) -> Result<Vec<CasePicture>, Error> {
    let worst = &comparison.worst;
    let far = vertex_displacements(&comparison.stored, &found.positions)?;
    let most = far.iter().copied().fold(0.0, f64::max);
    let unit = if most > 0.0 { most } else { 1.0 };
    let colours: Vec<Vec3> = far.iter().map(|d| ColourRamp::Amount.linear_colour(d / unit)).collect();
    let coloured = after.with_colours(&colours)?;
    let tree = TriangleBvh::build(&found.positions, &found.triangles, pool);
    let diagonal = BoundingBox::of(&found.positions).diagonal();
    let mark = |(&v, k): (&u32, u32)| {
        let at = found.positions[v as usize];
        let way = camera.towards_eye() * diagonal;
        RingMark {
            at,
            label: k.to_string(),
            hidden: tree.first_hit(at + way * 2e-3, at + way * 2.0, Some(v)).is_some(),
        }
    };
    let marks: Vec<RingMark> = worst.iter().zip(1..).map(mark).collect();
    let with_key = |surface: &ShadedSurface, camera: &Camera, marks: &[RingMark]| -> Result<Picture, Error> {
        let (width, height) = (camera.size().width(), camera.size().height());
        let mut picture = Picture::new(u64::from(width), u64::from(height + KEY_ROWS), background_end())?;
        picture.paste_picture(&draw_surface(surface, camera, pool), 0, 0);
        marks.iter().for_each(|m| m.draw_on(&mut picture, camera, 0, 0));
        ColourKey::for_distance(most).draw_on(&mut picture, height, KEY_ROWS);
        Ok(picture)
    };
    let places: Vec<String> = worst
        .iter()
        .zip(1..)
        .map(|(v, k)| format!("{k} is vertex {v}"))
        .collect();
    let text = format!(
        "distances from the expected shape as colours; marked: {}",
        places.join(", ")
    );
    let picture = with_key(&coloured, camera, &marks)?;
    let mut pictures = vec![encode_case_picture(PictureCaption::Difference, text, picture)?];
    if let (Some(&v), Some(mark)) = (worst.first(), marks.first()) {
        // From its own side, wherever the others are taken from.
        let view = view_from_beside(normal_at(found, v), up);
        let text = format!("the same with its triangles, near vertex {v}");
        let wired = coloured.with_wires();
        let near = Camera::around_surfaces(&[&wired], &[view], camera.size());
        let near = near.first().unwrap_or(camera).close_up(mark.at, NEAR * diagonal);
        let shown = RingMark {
            hidden: false,
            ..mark.clone()
        };
        let picture = with_key(&wired, &near, &[shown])?;
        pictures.push(encode_case_picture(PictureCaption::WorstPlace, text, picture)?);
    }
    Ok(pictures)
}

fn encode_case_picture(caption: PictureCaption, description: String, picture: Picture) -> Result<CasePicture, Error> {
    Ok(CasePicture {
        caption,
        description,
        size: [picture.width(), picture.height()],
        png: picture.encode_png()?,
    })
}

/// Looks at a place with this normal from a little above and beside it, so that the shape around it is seen as well.
fn view_from_beside(normal: DVec3, up: UpAxis) -> ViewDirection {
    let above = match up {
        UpAxis::Y => DVec3::Y,
        UpAxis::Z => DVec3::Z,
    };
    ViewDirection::facing(normal.normalize_or_zero() + above * 0.4, up).turned_by(25.0)
}

/// Computes the normal of the surface at a vertex, as long as the area around it.
fn normal_at(found: &CaseResult, vertex: u32) -> DVec3 {
    let place = found.positions[vertex as usize];
    let around = |t: &&[u32; 3]| t.iter().any(|&v| found.positions[v as usize] == place);
    let triangles = found.triangles.iter().filter(around);
    triangles
        .map(|t| {
            let [a, b, c] = t.map(|v| found.positions[v as usize]);
            (b - a).cross(c - a)
        })
        .sum()
}
