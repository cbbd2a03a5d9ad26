//! Expectations of a job: bounds that a result must keep.

use super::{Error, pb};

impl pb::Expect {
    /// Refuses bounds that nothing could exceed, or everything. `place` is where the expectations stand.
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
        Ok(())
    }
}
