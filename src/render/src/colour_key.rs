//! The key to the colours of a picture: a bar with the least number, the largest, and what they are of.

use super::colour::{ColourRamp, SrgbTable, crossing_colour, linear_from_hex};
use super::font;
use super::picture::{INK, Picture};
use glam::Vec3;
use pliant_mesh::Crossing;

/// A key shows what the colours of a picture mean.
#[derive(Debug, Clone, PartialEq)]
pub struct ColourKey(KeyForm);

#[derive(Debug, Clone, PartialEq)]
enum KeyForm {
    Ramp(RampKey),
    /// Colours that stand for one thing each, as linear light.
    Things(Vec<(Vec3, String)>),
}

/// A bar of all colours of a ramp.
#[derive(Debug, Clone, PartialEq)]
struct RampKey {
    ramp: ColourRamp,
    title: String,
    least: String,
    most: String,
}

impl ColourKey {
    /// Makes the key for triangles that cross; `has_rest` where those that crossed before have a colour of their own.
    pub fn for_crossings(has_rest: bool) -> Self {
        let one = |kind, text: &str| crossing_colour(kind).map(|colour| (colour, text.to_owned()));
        let new = one(Crossing::New, "crosses another triangle");
        let old = one(Crossing::AtRest, "crossed before").filter(|_| has_rest);
        Self(KeyForm::Things(new.into_iter().chain(old).collect()))
    }

    /// Makes the key for values of [`super::edge_stretch`], with `factor` at the end of the colours.
    pub fn for_stretch(factor: f64) -> Self {
        Self(KeyForm::Ramp(RampKey {
            ramp: ColourRamp::Stretch,
            title: "edge length".into(),
            least: format!("x{}", format_tick(1.0 / factor)),
            most: format!("x{}", format_tick(factor)),
        }))
    }

    /// Makes the key for distances from 0 to `most`.
    pub fn for_distance(most: f64) -> Self {
        Self::for_amount("distance", most)
    }

    /// Makes the key for how deep triangles cross, from 0 to `most`.
    pub fn for_depth(most: f64) -> Self {
        Self::for_amount("depth", most)
    }

    fn for_amount(title: &str, most: f64) -> Self {
        Self(KeyForm::Ramp(RampKey {
            ramp: ColourRamp::Amount,
            title: title.into(),
            least: "0".into(),
            most: format_tick(most),
        }))
    }

    /// Draws the key in the middle of `height` rows from `top` on: title, least number, bar, largest number; or each colour with what
    /// it stands for. Nothing is drawn where there is no room.
    pub fn draw_on(&self, picture: &mut Picture, top: u32, height: u32) {
        match &self.0 {
            KeyForm::Ramp(ramp) => ramp.draw_on(picture, top, height),
            KeyForm::Things(things) => draw_things(things, picture, top, height),
        }
    }
}

/// Draws squares of colours, each with its words behind.
fn draw_things(things: &[(Vec3, String)], picture: &mut Picture, top: u32, height: u32) {
    let screen = SrgbTable::new();
    let side = |dot: u32| font::HEIGHT * dot + 2;
    let width_at = |dot: u32| {
        let words = things.iter().map(|(_, text)| Picture::text_size(dot, text).0);
        words.map(|width| width + side(dot) + 12 * dot).sum::<u32>()
    };
    let largest = (height / 14).clamp(1, 3);
    let Some(dot) = (1..=largest).rev().find(|&dot| width_at(dot) <= picture.width()) else {
        return;
    };
    let mut x = picture.width().saturating_sub(width_at(dot)) / 2 + 3 * dot;
    let y = top + height.saturating_sub(side(dot)) / 2;
    for (colour, text) in things {
        picture.fill_rectangle(x, y, side(dot), side(dot), screen.to_srgb(*colour));
        x = picture.write_text(x + side(dot) + 3 * dot, y + 1, dot, text, INK) + 9 * dot;
    }
}

impl RampKey {
    fn draw_on(&self, picture: &mut Picture, top: u32, height: u32) {
        let screen = SrgbTable::new();
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
            x = picture.write_text(x, y + 1, dot, &self.title, INK) + 2 * gap;
        }
        x = picture.write_text(x, y + 1, dot, &self.least, INK) + gap;
        let least = self.ramp.lower_end();
        for k in 0..bar {
            let value = least + (1.0 - least) * (f64::from(k) + 0.5) / f64::from(bar);
            picture.fill_rectangle(x + k, y, 1, bar_height, screen.to_srgb(self.ramp.linear_colour(value)));
        }
        if least < 0.0 {
            // Where nothing has changed.
            picture.fill_rectangle(
                x + bar / 2,
                y,
                1,
                bar_height,
                screen.to_srgb(linear_from_hex(0x80_80_80)),
            );
        }
        picture.write_text(x + bar + gap, y + 1, dot, &self.most, INK);
    }
}

/// Writes a number in few characters: about three digits.
fn format_tick(x: f64) -> String {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_few_characters() {
        let texts = [
            (0.0, "0"),
            (1.5, "1.5"),
            (2.0 / 3.0, "0.667"),
            (1234.6, "1235"),
            (1.234e-7, "1.23e-7"),
        ];
        for (x, text) in texts {
            assert_eq!(format_tick(x), text);
        }
        assert_eq!(
            (format_tick(100.0), format_tick(10.0), format_tick(0.5)),
            ("100".into(), "10".into(), "0.5".into())
        );
    }
}
