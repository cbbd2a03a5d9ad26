//! Words that are brought to the room that there is for them.

use super::font;
use super::picture::{INK, Picture};

/// Lines of words, none longer than there is room for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caption {
    /// Pixels of a dot of a letter.
    dot: u32,
    lines: Vec<String>,
}

/// Lines end behind these where they can.
const ENDS: [char; 6] = [' ', '/', ',', ':', '_', '-'];

impl Caption {
    /// Words in letters with dots of `dot` pixels; of fewer, where they would not fit a line of `width` pixels; of one and in several
    /// lines, as many as `height` pixels hold, where even these are too long. Of words for which that is not enough the end stays, by
    /// which names of files differ.
    pub fn fitting(words: &str, width: u32, height: u32, dot: u32) -> Self {
        let fits = |dot: &u32| Picture::text_size(*dot, words).0 <= width;
        if let Some(dot) = (1..=dot.max(1)).rev().find(fits) {
            let lines = vec![words.to_owned()];
            return Self { dot, lines };
        }
        let in_line = ((width + 1) / (font::WIDTH + 1)).max(1) as usize;
        let most = (height / line_height(1)).max(1) as usize;
        let letters: Vec<char> = words.chars().collect();
        let mut lines = Vec::new();
        let mut rest = &letters[..];
        while !rest.is_empty() {
            let full = rest.len().min(in_line);
            let ends_at = |n: &usize| *n == rest.len() || ENDS.contains(&rest[n - 1]);
            let length = (1..=full).rev().find(ends_at).unwrap_or(full);
            lines.push(rest[..length].iter().collect::<String>().trim_end().to_owned());
            rest = &rest[length..];
        }
        if lines.len() > most {
            let left_out = letters.len().saturating_sub((most * in_line).saturating_sub(2));
            let end: Vec<char> = "..".chars().chain(letters[left_out..].iter().copied()).collect();
            let whole = end.chunks(in_line).take(most);
            lines = whole.map(|line| line.iter().collect()).collect();
        }
        Self { dot: 1, lines }
    }

    /// Pixels from the top of the first line to the end of the last.
    pub fn height(&self) -> u32 {
        let lines = u32::try_from(self.lines.len()).unwrap_or(u32::MAX);
        lines.saturating_mul(line_height(self.dot))
    }

    /// Writes the lines, with the corner of the first at these pixels.
    pub fn draw_on(&self, picture: &mut Picture, x: u32, y: u32) {
        for (k, line) in (0u32..).zip(&self.lines) {
            picture.write_text(x, y.saturating_add(k * line_height(self.dot)), self.dot, line, INK);
        }
    }
}

/// Pixels from a line to the next.
fn line_height(dot: u32) -> u32 {
    (font::HEIGHT + 2) * dot
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lines(words: &str, width: u32, height: u32) -> Vec<String> {
        Caption::fitting(words, width, height, 1).lines
    }

    #[test]
    fn letters_shrink_then_lines_break_and_ends_are_kept_where_that_is_not_enough() {
        let words = "a long path/new/dog.glb";
        let wide = Picture::text_size(3, words).0;
        assert_eq!(Caption::fitting(words, wide, 9, 3).dot, 3);
        let smaller = Caption::fitting(words, wide - 1, 9, 3);
        assert_eq!((smaller.dot, smaller.lines.len()), (2, 1));
        assert_eq!(lines("new/dog.glb", 192, 9), ["new/dog.glb"]);
        assert_eq!(lines(words, 72, 9), ["..ew/dog.glb"]);
        assert_eq!(lines(words, 72, 40), ["a long path/", "new/dog.glb"]);
        assert_eq!(
            lines("after: 17 new crossings", 60, 40),
            ["after: 17", "new", "crossings"]
        );
        assert_eq!(lines("unbreakable", 30, 40), ["unbre", "akabl", "e"]);
        for (width, height) in [(0, 0), (1, 1), (6, 300)] {
            let caption = Caption::fitting(words, width, height, 4);
            assert!(caption.lines.iter().all(|line| line.chars().count() <= 1));
            assert!(caption.height() <= height.max(line_height(1)));
        }
        assert_eq!(lines("", 0, 0), [""]);
    }
}
