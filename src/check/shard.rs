//! One shard of a suite: which of how many.

use std::fmt;
use std::str::FromStr;

/// Most shards that a suite is split into.
const MOST: u32 = 10_000;

/// A shard is one of the parts that a suite is split into, so that several machines run it together.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shard {
    number: u32,
    of: u32,
}

impl Shard {
    /// Makes a shard of its number, which begins at 1.
    ///
    /// # Errors
    /// What is allowed, where there is no such shard.
    pub fn new(number: u32, of: u32) -> Result<Self, String> {
        if of == 0 || of > MOST {
            return Err(format!("a suite has 1 to {MOST} shards, not {of}"));
        }
        if number == 0 || number > of {
            return Err(format!(
                "there is no shard {number} of {of}, allowed are 1/{of} to {of}/{of}"
            ));
        }
        Ok(Self { number, of })
    }

    /// Its number, from 1 on.
    pub fn number(self) -> u32 {
        self.number
    }

    /// How many there are.
    pub fn of(self) -> u32 {
        self.of
    }
}

impl fmt::Display for Shard {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

impl FromStr for Shard {
    type Err = String;

    /// Reads `3/8`, or `2+1/8` of a counter that begins at 0.
    ///
    /// ```
    /// use pliant::check::Shard;
    ///
    /// let shard: Shard = "2+1/8".parse()?;
    /// assert_eq!((shard.number(), shard.of(), shard), (3, 8, "3/8".parse()?));
    /// # Ok::<(), String>(())
    /// ```
    fn from_str(text: &str) -> Result<Self, String> {
        let form = || "K/N is needed, such as 3/8, or K+1/N where K begins at 0".to_owned();
        let number = |text: &str| match text.bytes().all(|b| b.is_ascii_digit()) {
            true => text.parse::<u32>().map_err(|_| form()),
            false => Err(form()),
        };
        let (which, of) = text.split_once('/').ok_or_else(form)?;
        let (which, more) = match which.strip_suffix("+1") {
            Some(index) => (index, 1),
            None => (which, 0),
        };
        Self::new(number(which)?.saturating_add(more), number(of)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shard_is_one_of_those_that_there_are() {
        for (text, shard) in [("1/1", (1, 1)), ("8/8", (8, 8)), ("0+1/8", (1, 8)), ("03/8", (3, 8))] {
            assert_eq!(
                text.parse(),
                Ok(Shard {
                    number: shard.0,
                    of: shard.1
                }),
                "{text}"
            );
        }
        for (text, words) in [
            ("0/8", "no shard 0 of 8, allowed are 1/8 to 8/8"),
            ("9/8", "no shard 9 of 8"),
            ("8+1/8", "no shard 9 of 8"),
            ("1/0", "1 to 10000 shards, not 0"),
            ("1/10001", "not 10001"),
            ("4294967295+1/4294967295", "1 to 10000 shards"),
            ("a/b", "K/N is needed, such as 3/8"),
            ("3", "K/N"),
            ("3/8/9", "K/N"),
            ("-1/8", "K/N"),
            ("+1/8", "K/N"),
            ("3/+8", "K/N"),
            ("1+2/8", "K/N"),
            ("/8", "K/N"),
            ("99999999999/8", "K/N"),
            ("", "K/N"),
        ] {
            let told = text.parse::<Shard>().expect_err(text);
            assert!(told.contains(words), "{text}: {told}");
        }
    }
}
