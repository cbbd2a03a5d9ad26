//! Several views on one picture, by cameras that share a frame, with a key to the colours.

use super::colour::{Rgb, Screen, light};
use super::raster::ground;
use super::{Camera, Error, Mark, Picture, Ramp, Size, Surface, View, draw, font};
use crate::pool::Pool;

/// Views smaller than this have no key and no words.
const WORDS: u32 = 96;
const INK: Rgb = [52, 58, 66];

/// What the colours of a picture mean.
#[derive(Debug, Clone, PartialEq)]
pub struct Key {
    ramp: Ramp,
    title: String,
    least: String,
    most: String,
}

impl Key {
    /// Of [`super::edge_stretch`], with a factor at the end of the colours.
    pub fn stretch(factor: f64) -> Self {
        Self {
            ramp: Ramp::Stretch,
            title: "edge length".into(),
            least: format!("x{}", number(1.0 / factor)),
            most: format!("x{}", number(factor)),
        }
    }

    /// Of distances from 0 to `most`.
    pub fn distance(most: f64) -> Self {
        Self {
            ramp: Ramp::Amount,
            title: "distance".into(),
            least: "0".into(),
            most: number(most),
        }
    }

    /// Draws the key in the middle of `height` rows from `top` on: title, least, bar, most. Draws nothing where there is
    /// no room.
    pub fn draw(&self, picture: &mut Picture, top: u32, height: u32) {
        let screen = Screen::new();
        let dot = (height / 14).clamp(1, 3);
        let gap = 6 * dot;
        let bar_height = font::HEIGHT * dot + 2;
        let width_of = |text: &str| Picture::text_size(dot, text).0;
        let words = width_of(&self.least) + width_of(&self.most) + 4 * gap;
        let room = picture.width().saturating_sub(words);
        let bar = room.min(120 * dot);
        if bar < 16 {
            return;
        }
        let title = width_of(&self.title) + 2 * gap;
        let titled = room >= bar + title;
        let whole = words + bar + if titled { title } else { 0 };
        let mut x = picture.width().saturating_sub(whole) / 2 + gap;
        let y = top + height.saturating_sub(bar_height) / 2;
        if titled {
            x = picture.write(x, y + 1, dot, &self.title, INK) + 2 * gap;
        }
        x = picture.write(x, y + 1, dot, &self.least, INK) + gap;
        let least = self.ramp.least();
        for k in 0..bar {
            let value = least + (1.0 - least) * (f64::from(k) + 0.5) / f64::from(bar);
            picture.fill(x + k, y, 1, bar_height, screen.rgb(self.ramp.light(value)));
        }
        if least < 0.0 {
            // Where nothing has changed.
            picture.fill(x + bar / 2, y, 1, bar_height, screen.rgb(light(0x80_80_80)));
        }
        picture.write(x + bar + gap, y + 1, dot, &self.most, INK);
    }
}

/// A number in few characters: about three digits.
fn number(x: f64) -> String {
    let size = x.abs();
    if size == 0.0 {
        "0".into()
    } else if (1e-2..1e4).contains(&size) {
        let digits = if size < 1.0 {
            3
        } else if size < 100.0 {
            2
        } else {
            0
        };
        let text = format!("{x:.digits$}");
        match text.contains('.') {
            true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
            false => text,
        }
    } else {
        format!("{x:.2e}")
    }
}

/// A shape, maybe beside what it was before, seen from one side or several.
///
/// One view puts before and after side by side. Several make a strip, with the shape before above the one after.
#[derive(Debug, Clone)]
pub struct Plate<'a> {
    /// The shape before.
    pub before: Option<&'a Surface>,
    /// The shape.
    pub shape: &'a Surface,
    /// From where; at least one.
    pub views: &'a [View],
    /// Pixels of each view.
    pub size: Size,
    /// What the colours mean, told below the views where there is room.
    pub key: Option<Key>,
    /// Places to point at, on every view of the shape.
    pub marks: Vec<Mark>,
}

impl Plate<'_> {
    /// Draws all views with one scale.
    ///
    /// # Errors
    /// [`Error::TooLarge`] when all views together have more than [`Picture::MOST`] pixels.
    pub fn draw(&self, pool: &Pool) -> Result<Picture, Error> {
        let surfaces: Vec<&Surface> = self.before.into_iter().chain([self.shape]).collect();
        let count = |n: usize| u32::try_from(n).unwrap_or(u32::MAX);
        let (columns, rows) = match self.views.len() {
            0 | 1 => (count(surfaces.len()), 1),
            views => (count(views), count(surfaces.len())),
        };
        let (width, height) = (self.size.width(), self.size.height());
        let side = |n: u32, pixels: u32| u64::from(n) * u64::from(pixels);
        let mut picture = Picture::new(side(columns, width), side(rows, height), ground())?;
        let words = height >= WORDS && width >= WORDS;
        let strip = match self.key {
            Some(_) if words => (height / 16).clamp(14, 48),
            _ => 0,
        };
        let view_height = height - strip.div_ceil(rows);
        let cameras = Camera::around(&surfaces, self.views, Size::new(width, view_height)?);
        let dot = (width.min(height) / 240).clamp(1, 4);
        for (k, surface) in surfaces.iter().enumerate() {
            for (v, camera) in cameras.iter().enumerate() {
                let (column, row) = if rows > 1 || cameras.len() > 1 { (v, k) } else { (k, v) };
                let (x, y) = (count(column) * width, count(row) * view_height);
                picture.paste(&draw(surface, camera, pool), x, y);
                if k + 1 == surfaces.len() {
                    self.marks.iter().for_each(|m| m.draw(&mut picture, camera, x, y));
                }
                if words && surfaces.len() > 1 && v == 0 {
                    let word = ["before", "after"][k.min(1)];
                    picture.write(x + 4 * dot, y + 4 * dot, dot, word, INK);
                }
            }
        }
        if let (Some(key), true) = (&self.key, strip > 0) {
            let top = rows * view_height;
            key.draw(&mut picture, top, rows * height - top);
        }
        Ok(picture)
    }
}

#[cfg(test)]
mod tests {
    use super::super::{STRETCH_RANGE, Up};
    use super::*;
    use glam::DVec3;

    fn pool() -> Pool {
        Pool::new(2).expect("two threads")
    }

    fn surface(size: f64) -> Surface {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z].map(|p| p * size);
        Surface::new(&p, &[[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]], &pool()).expect("a surface")
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
        let views = [View::new(30.0, 20.0, Up::Y).expect("in range")];
        let plate = Plate {
            before: Some(&small),
            shape: &large,
            views: &views,
            size: Size::new(64, 64).expect("in range"),
            key: None,
            marks: Vec::new(),
        };
        let picture = plate.draw(&pool()).expect("small");
        assert_eq!((picture.width(), picture.height()), (128, 64));
        let (before, after) = (drawn(&picture, 0, 0, 64), drawn(&picture, 64, 0, 64));
        let ratio = after as f64 / before as f64;
        assert!((3.4..4.6).contains(&ratio), "{before} and {after} pixels");
    }

    #[test]
    fn a_strip_has_a_tile_for_each_view() {
        let (small, large) = (surface(1.0), surface(2.0));
        let first = View::new(0.0, 20.0, Up::Z).expect("in range");
        let views: Vec<View> = (0..5).map(|k| first.turned(72.0 * f64::from(k))).collect();
        let size = Size::new(40, 40).expect("in range");
        let plate = Plate {
            before: None,
            shape: &large,
            views: &views,
            size,
            key: None,
            marks: Vec::new(),
        };
        let strip = plate.draw(&pool()).expect("small");
        assert_eq!((strip.width(), strip.height()), (200, 40));
        assert!((0..5).all(|k| drawn(&strip, 40 * k, 0, 40) > 40));
        let two = Plate {
            before: Some(&small),
            ..plate.clone()
        };
        assert_eq!(two.draw(&pool()).map(|p| (p.width(), p.height())), Ok((200, 80)));
        let many: Vec<View> = (0..64).map(|k| first.turned(f64::from(k))).collect();
        let too_large = Plate {
            views: &many,
            size: Size::new(8192, 8192).expect("in range"),
            ..plate
        };
        assert!(matches!(too_large.draw(&pool()), Err(Error::TooLarge { .. })));
    }

    #[test]
    fn a_key_is_told_where_there_is_room() {
        let shape = surface(1.0);
        let views = [View::new(30.0, 20.0, Up::Y).expect("in range")];
        let colours = |side: u32| {
            let plate = Plate {
                before: None,
                shape: &shape,
                views: &views,
                size: Size::new(side, side).expect("in range"),
                key: Some(Key::stretch(STRETCH_RANGE)),
                marks: Vec::new(),
            };
            let picture = plate.draw(&pool()).expect("small");
            assert_eq!((picture.width(), picture.height()), (side, side));
            let strong = |p: &&Rgb| p[0].abs_diff(p[2]) > 100;
            picture.pixels().iter().filter(strong).count()
        };
        assert!(colours(320) > 100);
        assert_eq!(colours(64), 0);
        let texts = [
            (0.0, "0"),
            (1.5, "1.5"),
            (2.0 / 3.0, "0.667"),
            (1234.6, "1235"),
            (1.234e-7, "1.23e-7"),
        ];
        for (x, text) in texts {
            assert_eq!(number(x), text);
        }
        assert_eq!(
            (number(100.0), number(10.0), number(0.5)),
            ("100".into(), "10".into(), "0.5".into())
        );
    }
}
