//! From where pictures are taken, as arguments say it.

use crate::render::{self, PictureSize, UpAxis, ViewDirection};
use clap::ValueEnum;

/// Most views of one picture.
const MOST_VIEWS: usize = 64;

/// An axis that can point up.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub(in crate::cli) enum UpAxisChoice {
    Y,
    Z,
}

impl From<UpAxisChoice> for UpAxis {
    fn from(choice: UpAxisChoice) -> Self {
        match choice {
            UpAxisChoice::Y => Self::Y,
            UpAxisChoice::Z => Self::Z,
        }
    }
}

/// The views that one argument names.
#[derive(Debug, Clone, PartialEq)]
pub(in crate::cli) struct ViewList(Vec<[f64; 2]>);

impl ViewList {
    /// The views by the axis that points up.
    pub(in crate::cli) fn directions(&self, up: UpAxisChoice) -> Result<Vec<ViewDirection>, render::Error> {
        let one = |[azimuth, elevation]: &[f64; 2]| ViewDirection::new(*azimuth, *elevation, up.into());
        self.0.iter().map(one).collect()
    }

    /// One view.
    pub(in crate::cli) fn of(angles: [f64; 2]) -> Self {
        Self(vec![angles])
    }
}

/// Reads the width and height of a picture.
pub(in crate::cli) fn parse_size(text: &str) -> Result<PictureSize, String> {
    let sides = text.split_once(['x', 'X']);
    let number = |side: &str| side.trim().parse::<u32>().ok();
    match sides.and_then(|(w, h)| Some((number(w)?, number(h)?))) {
        Some((w, h)) => PictureSize::new(w, h).map_err(|e| e.to_string()),
        None => Err("two whole numbers with an x between them are needed, such as 800x600".into()),
    }
}

/// Views by the names that modelling programs have for them; right is the side that faces +x.
const NAMED_VIEWS: [(&str, [f64; 2]); 8] = [
    ("front", [0.0, 0.0]),
    ("back", [180.0, 0.0]),
    ("side", [90.0, 0.0]),
    ("right", [90.0, 0.0]),
    ("left", [-90.0, 0.0]),
    ("top", [0.0, 90.0]),
    ("bottom", [0.0, -90.0]),
    ("three-quarter", [45.0, 20.0]),
];

/// Reads views: names, and pairs of angles, with commas between them.
pub(in crate::cli) fn parse_views(text: &str) -> Result<ViewList, String> {
    let mut views = Vec::new();
    let mut words = text.split(',').map(str::trim);
    while let Some(word) = words.next() {
        if let Some((_, angles)) = NAMED_VIEWS.iter().find(|(name, _)| *name == word) {
            views.push(*angles);
            continue;
        }
        let number = |word: &str| word.parse::<f64>().ok();
        let (Some(azimuth), Some(elevation)) = (number(word), words.next().and_then(number)) else {
            let names = NAMED_VIEWS.map(|(name, _)| name).join(", ");
            return Err(format!(
                "allowed are two numbers with a comma between them, such as 30,20, and {names}; several with commas between them"
            ));
        };
        // Whether they are in range does not depend on the up axis.
        ViewDirection::new(azimuth, elevation, UpAxis::Y).map_err(|e| e.to_string())?;
        views.push([azimuth, elevation]);
    }
    if views.len() > MOST_VIEWS {
        return Err(format!(
            "{} views are named, at most {MOST_VIEWS} are allowed",
            views.len()
        ));
    }
    Ok(ViewList(views))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_angles_mix() {
        let views = |text: &str| parse_views(text).map(|list| list.0);
        assert_eq!(views("front"), Ok(vec![[0.0, 0.0]]));
        assert_eq!(views("-45,10"), Ok(vec![[-45.0, 10.0]]));
        let mixed = vec![[90.0, 0.0], [30.0, 20.0], [0.0, 90.0]];
        assert_eq!(views("side, 30,20,top"), Ok(mixed));
        for text in ["", "fron", "30", "30,top", "front,", "0,95"] {
            assert!(views(text).is_err(), "{text:?}");
        }
        let names: Vec<&str> = NAMED_VIEWS.map(|(name, _)| name).to_vec();
        assert!(views("?").is_err_and(|e| names.iter().all(|name| e.contains(name))));
    }
}
