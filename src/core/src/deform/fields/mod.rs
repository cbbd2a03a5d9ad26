//! Bounded harmonic fields: how much each handle has to say at each node (paper section 2.1; Zayer et al. 2005).

pub(super) mod harmonic;
pub(super) mod solve;
pub(super) mod sparse;

pub use harmonic::HarmonicFields;
