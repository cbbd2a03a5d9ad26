//! Kinds that files write by their names.

use serde::de::Error as _;
use serde::{Deserialize as _, Deserializer, Serializer};

/// A kind of which every value has a name in files.
pub trait Named: Copy + PartialEq + 'static {
    /// What a name that none has is not, for errors.
    const WHAT: &'static str;
    /// All values with their names.
    const NAMES: &'static [(Self, &'static str)];

    /// The value's name in files.
    fn name(self) -> &'static str {
        let own = Self::NAMES.iter().find(|(value, _)| *value == self);
        own.map_or("", |(_, name)| name)
    }

    /// Finds the value of a name.
    fn from_name(name: &str) -> Option<Self> {
        Self::NAMES
            .iter()
            .find(|(_, own)| *own == name)
            .map(|(value, _)| *value)
    }
}

/// Writes a value as its name.
pub(super) fn serialize<T: Named, S: Serializer>(value: &T, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(value.name())
}

/// Reads a value by its name.
pub(super) fn deserialize<'de, T: Named, D: Deserializer<'de>>(deserializer: D) -> Result<T, D::Error> {
    let name = String::deserialize(deserializer)?;
    T::from_name(&name).ok_or_else(|| D::Error::custom(format!("\"{name}\" is not {} of this version", T::WHAT)))
}
