//! From a hierarchy and constraints to a system: masks, diagonals and the coarsest factor.

pub(crate) mod mask;
pub(crate) mod system;

pub use self::system::LinearSystem;
