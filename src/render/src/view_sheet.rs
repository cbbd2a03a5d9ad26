//! Several views on one picture, by cameras that share a frame, with a key to the colours.

use super::Error;
use super::camera::{Camera, PictureSize, ViewDirection};
use super::caption::Caption;
use super::colour_key::ColourKey;
use super::picture::Picture;
use super::raster::{background_end, draw_surface};
use super::ring_mark::RingMark;
use super::surface::ShadedSurface;
use glam::DVec3;
use pliant_exec::pool::Pool;

/// Views smaller than this have no key and no words.
const WORDS: u32 = 96;
/// Words take at most this part of a view's height.
const WORDY: u32 = 3;

/// A place that a picture shows from near by.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CloseView {
    /// Its middle.
    pub at: DVec3,
    /// How far it reaches, in units of the model.
    pub radius: f64,
}

/// A shape on a sheet.
#[derive(Debug, Clone)]
pub struct SheetShape<'a> {
    /// What is drawn.
    pub surface: &'a ShadedSurface,
    /// What stands in the corner of its first view, where there is room; nothing when it is empty.
    pub caption: String,
    /// Rings around places, drawn on each of its views.
    pub marks: Vec<RingMark>,
    /// The place that its views show; all of it without.
    pub near: Option<CloseView>,
}

impl<'a> SheetShape<'a> {
    /// A shape without anything beside it.
    pub fn plain(surface: &'a ShadedSurface) -> Self {
        Self {
            surface,
            caption: String::new(),
            marks: Vec::new(),
            near: None,
        }
    }
}

/// A sheet shows shapes, each from one side or several, by cameras that share a frame.
///
/// The views of a shape are side by side. Shapes of one view fill rows; shapes of several views are above each other, unless
/// [`ViewSheet::columns`] says otherwise.
#[derive(Debug, Clone)]
pub struct ViewSheet<'a> {
    /// The shapes in order; at least one.
    pub shapes: Vec<SheetShape<'a>>,
    /// The directions from which each is seen; at least one.
    pub views: &'a [ViewDirection],
    /// Pixels of each view.
    pub size: PictureSize,
    /// Shapes in a row; without, as many as make a picture of usual sides.
    pub columns: Option<u32>,
    /// Whether each shape fills its own views, so that sizes cannot be compared.
    pub fits_each: bool,
    /// The key to the colours, drawn below the views where there is room.
    pub key: Option<ColourKey>,
}

impl ViewSheet<'_> {
    /// Draws all views with one scale.
    ///
    /// # Errors
    /// [`Error::TooLarge`] when all views together have more than [`Picture::MOST`] pixels.
    pub fn draw_views(&self, pool: &Pool) -> Result<Picture, Error> {
        let surfaces: Vec<&ShadedSurface> = self.shapes.iter().map(|s| s.surface).collect();
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let (width, height) = (self.size.width(), self.size.height());
        let views = count(self.views.len().max(1));
        let in_row = match (self.columns, surfaces.len()) {
            (Some(columns), shapes) => columns.clamp(1, count(shapes).max(1)),
            (None, _) if views > 1 => 1,
            (None, shapes @ 0..=2) => count(shapes).max(1),
            (None, shapes) => count(sheet_columns(shapes, f64::from(width) / f64::from(height))),
        };
        let rows = count(surfaces.len()).div_ceil(in_row).max(1);
        let side = |n: u32, pixels: u32| u64::from(n) * u64::from(pixels);
        let mut picture = Picture::new(
            side(in_row, width).saturating_mul(views.into()),
            side(rows, height),
            background_end(),
        )?;
        let words = height >= WORDS && width >= WORDS;
        let strip = match self.key {
            Some(_) if words => (height / 16).clamp(14, 48),
            _ => 0,
        };
        let view_height = height - strip.div_ceil(rows);
        let size = PictureSize::new(width, view_height)?;
        let shared = Camera::around_surfaces(&surfaces, self.views, size);
        let dot = (width.min(height) / 240).clamp(1, 4);
        for (k, shape) in (0u32..).zip(&self.shapes) {
            let (column, row) = (k % in_row * views, k / in_row);
            let own = match self.fits_each {
                true => Camera::around_surfaces(&[shape.surface], self.views, size),
                false => shared.clone(),
            };
            for (v, camera) in (0u32..).zip(&own) {
                let camera = &match shape.near {
                    Some(near) => camera.close_up(near.at, near.radius),
                    None => camera.clone(),
                };
                let (x, y) = ((column + v) * width, row * view_height);
                picture.paste_picture(&draw_surface(shape.surface, camera, pool), x, y);
                shape.marks.iter().for_each(|m| m.draw_on(&mut picture, camera, x, y));
                if words && v == 0 {
                    let room = width.saturating_sub(8 * dot);
                    let caption = Caption::fitting(&shape.caption, room, view_height / WORDY, dot);
                    caption.draw_on(&mut picture, x + 4 * dot, y + 4 * dot);
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

/// Columns of a sheet of so many tiles, each `aspect` times as wide as high: as few places left empty as can be, then about twice as wide
/// as high.
pub fn sheet_columns(tiles: usize, aspect: f64) -> usize {
    let most = tiles.max(1);
    let is_wide = |c: &usize| (c * c) as f64 * aspect >= tiles as f64;
    let least = (1..most).find(is_wide).unwrap_or(most);
    let choices = least..=most.min(2 * least);
    let off = |c: usize| ((c * c) as f64 * aspect - 2.0 * tiles as f64).abs();
    let empty = |c: usize| c * tiles.div_ceil(c) - tiles;
    choices
        .min_by(|a, b| empty(*a).cmp(&empty(*b)).then(off(*a).total_cmp(&off(*b))))
        .unwrap_or(most)
}

#[cfg(test)]
mod tests {
    use super::super::camera::UpAxis;
    use super::super::colour::Rgb;
    use super::super::dress::STRETCH_RANGE;
    use super::*;

    fn pool() -> Pool {
        Pool::new(2).expect("two threads")
    }

    fn surface(size: f64) -> ShadedSurface {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * size);
        ShadedSurface::new(&p, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], &pool()).expect("a surface")
    }

    /// A sheet of shapes, square views of so many pixels a side.
    fn sheet<'a>(shapes: &[&'a ShadedSurface], views: &'a [ViewDirection], side: u32) -> ViewSheet<'a> {
        ViewSheet {
            shapes: shapes.iter().map(|s| SheetShape::plain(s)).collect(),
            views,
            size: PictureSize::new(side, side).expect("in range"),
            columns: None,
            fits_each: false,
            key: None,
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
        let plate = sheet(&[&small, &large], &views, 64);
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
        let plate = sheet(&[&large], &views, 40);
        let strip = plate.draw_views(&pool()).expect("small");
        assert_eq!((strip.width(), strip.height()), (200, 40));
        assert!((0..5).all(|k| drawn(&strip, 40 * k, 0, 40) > 40));
        let two = sheet(&[&small, &large], &views, 40);
        assert_eq!(two.draw_views(&pool()).map(|p| (p.width(), p.height())), Ok((200, 80)));
        let many: Vec<ViewDirection> = (0..64).map(|k| first.turned_by(f64::from(k))).collect();
        let too_large = sheet(&[&large], &many, 8192).draw_views(&pool());
        assert!(matches!(too_large, Err(Error::TooLarge { .. })));
    }

    #[test]
    fn shapes_fill_rows_by_one_scale_or_each_by_its_own() {
        let (small, large) = (surface(1.0), surface(2.0));
        let views = [ViewDirection::new(30.0, 20.0, UpAxis::Y).expect("in range")];
        let shapes = [&small, &large, &large, &small, &large];
        let tile = |plate: &ViewSheet<'_>, k: u32, columns: u32| {
            let picture = plate.draw_views(&pool()).expect("small");
            drawn(&picture, k % columns * 64, k / columns * 64, 64)
        };
        let mut plate = sheet(&shapes, &views, 64);
        plate.columns = Some(2);
        let size = plate.draw_views(&pool()).map(|p| (p.width(), p.height()));
        assert_eq!(size, Ok((128, 192)));
        assert_eq!(
            tile(&plate, 0, 2),
            tile(&plate, 3, 2),
            "equal shapes are drawn alike, wherever they are"
        );
        assert!(tile(&plate, 0, 2) * 3 < tile(&plate, 1, 2));
        plate.fits_each = true;
        assert_eq!(tile(&plate, 0, 2), tile(&plate, 1, 2));
        // Several views are side by side, below each other for each shape.
        let two = [views[0], views[0].turned_by(90.0)];
        let plate = sheet(&shapes, &two, 64);
        let size = plate.draw_views(&pool()).map(|p| (p.width(), p.height()));
        assert_eq!(size, Ok((128, 320)));
    }

    #[test]
    fn a_close_up_shows_its_place_in_the_middle() {
        let shape = surface(1.0);
        let views = [ViewDirection::new(0.0, 0.0, UpAxis::Y).expect("in range")];
        let mut plate = sheet(&[&shape], &views, 64);
        plate.shapes[0].near = Some(CloseView {
            at: DVec3::new(0.2, 0.2, 0.0),
            radius: 0.01,
        });
        let picture = plate.draw_views(&pool()).expect("small");
        assert_eq!(
            drawn(&picture, 0, 0, 64),
            0,
            "all of it is surface, of one colour in each row"
        );
        assert_ne!(
            picture.pixel(0, 0),
            sheet(&[&shape], &views, 64)
                .draw_views(&pool())
                .expect("small")
                .pixel(0, 0)
        );
    }

    #[test]
    fn a_sheet_has_no_more_empty_places_than_it_must() {
        let columns = |tiles: [usize; 7], aspect: f64| tiles.map(|count| sheet_columns(count, aspect));
        assert_eq!(columns([1, 2, 6, 9, 12, 16, 64], 1.0), [1, 2, 3, 3, 4, 4, 8]);
        for tiles in 1..=256 {
            for aspect in [0.75, 1.0, 1.5] {
                let columns = sheet_columns(tiles, aspect);
                let empty = columns * tiles.div_ceil(columns) - tiles;
                assert!(empty < columns, "{tiles}");
            }
        }
    }

    #[test]
    fn sheets_of_high_tiles_have_more_columns_than_sheets_of_wide_ones() {
        assert_eq!(sheet_columns(16, 0.75), 8);
        assert_eq!(sheet_columns(16, 3.0), 4);
        assert_eq!(sheet_columns(6, 1.5), 3);
    }

    #[test]
    fn a_key_is_reported_where_there_is_room() {
        let shape = surface(1.0);
        let views = [ViewDirection::new(30.0, 20.0, UpAxis::Y).expect("in range")];
        let colours = |side: u32| {
            let plate = ViewSheet {
                key: Some(ColourKey::for_stretch(STRETCH_RANGE)),
                ..sheet(&[&shape], &views, side)
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
