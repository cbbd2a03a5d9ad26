//! Expectations of a job: bounds that a result must keep.

use super::{Error, pb};

impl pb::Expect {
    /// Refuses bounds that nothing could exceed, or everything, and a digest that no positions have. `place` is where the
    /// expectations stand.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the bound's path.
    pub fn check(&self, place: &str) -> Result<(), Error> {
        let bounds = [
            ("maxDistance", self.max_distance),
            ("meanDistance", self.mean_distance),
            ("normalDegrees", self.normal_degrees),
            ("volumeChange", self.volume_change),
        ];
        for (name, most) in bounds.into_iter().filter_map(|(name, most)| Some((name, most?))) {
            if !(most.is_finite() && most >= 0.0) {
                let problem = format!("is {most:?}, a finite number of at least 0 is needed");
                return Err(Error::invalid(format!("{place}.{name}"), problem));
            }
        }
        if !(self.digest.is_empty() || can_be_digest(&self.digest)) {
            let problem = format!(
                "is {:?}, \"xxh3:\" and 16 hexadecimal digits in small letters are needed, as reports print it",
                self.digest
            );
            return Err(Error::invalid(format!("{place}.digest"), problem));
        }
        Ok(())
    }
}

/// Whether positions can have this digest.
fn can_be_digest(text: &str) -> bool {
    let is_digit = |b: u8| b.is_ascii_digit() || (b'a'..=b'f').contains(&b);
    text.strip_prefix("xxh3:")
        .is_some_and(|digits| digits.len() == 16 && digits.bytes().all(is_digit))
}
