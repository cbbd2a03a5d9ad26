//! Several views on one picture, by cameras that share a frame, with a key to the colours.

use super::Error;
use super::camera::{Camera, PictureSize, ViewDirection};
use super::colour_key::ColourKey;
use super::picture::{INK, Picture};
use super::raster::{background_end, draw_surface};
use super::ring_mark::RingMark;
use super::surface::ShadedSurface;
use pliant_exec::pool::Pool;

/// Views smaller than this have no key and no words.
const WORDS: u32 = 96;

/// A sheet shows one shape from one side or several, and beside it, where it is given, what the shape was before.
///
/// One view puts before and after side by side. Several make a strip, with the shape before above the one after.
#[derive(Debug, Clone)]
pub struct ViewSheet<'a> {
    /// The shape before; it is left out when it is `None`.
    pub before: Option<&'a ShadedSurface>,
    /// The shape that is shown.
    pub shape: &'a ShadedSurface,
    /// The directions from which it is seen; at least one.
    pub views: &'a [ViewDirection],
    /// Pixels of each view.
    pub size: PictureSize,
    /// The key to the colours, drawn below the views where there is room.
    pub key: Option<ColourKey>,
    /// Rings around places, drawn on every view of the shape.
    pub marks: Vec<RingMark>,
}

impl ViewSheet<'_> {
    /// Draws all views with one scale.
    ///
    /// # Errors
    /// [`Error::TooLarge`] when all views together have more than [`Picture::MOST`] pixels.
    pub fn draw_views(&self, pool: &Pool) -> Result<Picture, Error> {
        let surfaces: Vec<&ShadedSurface> = self.before.into_iter().chain([self.shape]).collect();
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let (columns, rows) = match self.views.len() {
            0 | 1 => (count(surfaces.len()), 1),
            views => (count(views), count(surfaces.len())),
        };
        let (width, height) = (self.size.width(), self.size.height());
        let side = |n: u32, pixels: u32| u64::from(n) * u64::from(pixels);
        let mut picture = Picture::new(side(columns, width), side(rows, height), background_end())?;
        let words = height >= WORDS && width >= WORDS;
        let strip = match self.key {
            Some(_) if words => (height / 16).clamp(14, 48),
            _ => 0,
        };
        let view_height = height - strip.div_ceil(rows);
        let cameras = Camera::around_surfaces(&surfaces, self.views, PictureSize::new(width, view_height)?);
        let dot = (width.min(height) / 240).clamp(1, 4);
        for (k, surface) in surfaces.iter().enumerate() {
            for (v, camera) in cameras.iter().enumerate() {
                let (column, row) = if rows > 1 || cameras.len() > 1 { (v, k) } else { (k, v) };
                let (x, y) = (count(column) * width, count(row) * view_height);
                picture.paste_picture(&draw_surface(surface, camera, pool), x, y);
                if k + 1 == surfaces.len() {
                    self.marks.iter().for_each(|m| m.draw_on(&mut picture, camera, x, y));
                }
                if words && surfaces.len() > 1 && v == 0 {
                    let word = ["before", "after"][k.min(1)];
                    picture.write_text(x + 4 * dot, y + 4 * dot, dot, word, INK);
                }
            }
        }
        if let (Some(key), true) = (&self.key, strip > 0) {
            let top = rows * view_height;
            key.draw_on(&mut picture, top, rows * height - top);
        }
        Ok(picture)
    }
}

#[cfg(test)]
mod tests {
    use super::super::camera::UpAxis;
    use super::super::colour::Rgb;
    use super::super::dress::STRETCH_RANGE;
    use super::*;
    use glam::DVec3;

    fn pool() -> Pool {
        Pool::new(2).expect("two threads")
    }

    fn surface(size: f64) -> ShadedSurface {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * size);
        ShadedSurface::new(&p, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], &pool()).expect("a surface")
    }

    /// A sheet of a shape alone, square views of so many pixels a side.
    fn sheet<'a>(shape: &'a ShadedSurface, views: &'a [ViewDirection], side: u32) -> ViewSheet<'a> {
        ViewSheet {
            before: None,
            shape,
            views,
            size: PictureSize::new(side, side).expect("in range"),
            key: None,
            marks: Vec::new(),
        }
    }

    /// How many pixels of a tile differ from the same row's first pixel of the picture: what is drawn there.
    fn drawn(picture: &Picture, x: u32, y: u32, size: u32) -> usize {
        let mut count = 0;
        for row in y..y + size {
            let sky = picture.pixel(0, row);
            count += (x..x + size)
                .filter(|&column| picture.pixel(column, row) != sky)
                .count();
        }
        count
    }

    #[test]
    fn before_and_after_share_a_scale() {
        let (small, large) = (surface(1.0), surface(2.0));
        let views = [ViewDirection::new(30.0, 20.0, UpAxis::Y).expect("in range")];
        let plate = ViewSheet {
            before: Some(&small),
            ..sheet(&large, &views, 64)
        };
        let picture = plate.draw_views(&pool()).expect("small");
        assert_eq!((picture.width(), picture.height()), (128, 64));
        let (before, after) = (drawn(&picture, 0, 0, 64), drawn(&picture, 64, 0, 64));
        let ratio = after as f64 / before as f64;
        assert!((3.4..4.6).contains(&ratio), "{before} and {after} pixels");
    }

    #[test]
    fn a_strip_has_a_tile_for_each_view() {
        let (small, large) = (surface(1.0), surface(2.0));
        let first = ViewDirection::new(0.0, 20.0, UpAxis::Z).expect("in range");
        let views: Vec<ViewDirection> = (0..5).map(|k| first.turned_by(72.0 * f64::from(k))).collect();
        let plate = sheet(&large, &views, 40);
        let strip = plate.draw_views(&pool()).expect("small");
        assert_eq!((strip.width(), strip.height()), (200, 40));
        assert!((0..5).all(|k| drawn(&strip, 40 * k, 0, 40) > 40));
        let two = ViewSheet {
            before: Some(&small),
            ..plate.clone()
        };
        assert_eq!(two.draw_views(&pool()).map(|p| (p.width(), p.height())), Ok((200, 80)));
        let many: Vec<ViewDirection> = (0..64).map(|k| first.turned_by(f64::from(k))).collect();
        let too_large = sheet(&large, &many, 8192).draw_views(&pool());
        assert!(matches!(too_large, Err(Error::TooLarge { .. })));
    }

    #[test]
    fn a_key_is_reported_where_there_is_room() {
        let shape = surface(1.0);
        let views = [ViewDirection::new(30.0, 20.0, UpAxis::Y).expect("in range")];
        let colours = |side: u32| {
            let plate = ViewSheet {
                key: Some(ColourKey::for_stretch(STRETCH_RANGE)),
                ..sheet(&shape, &views, side)
            };
            let picture = plate.draw_views(&pool()).expect("small");
            assert_eq!((picture.width(), picture.height()), (side, side));
            let strong = |p: &&Rgb| p[0].abs_diff(p[2]) > 100;
            picture.pixels().iter().filter(strong).count()
        };
        assert!(colours(320) > 100);
        assert_eq!(colours(64), 0);
    }
}
