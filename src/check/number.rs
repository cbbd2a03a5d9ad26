//! Numbers in reports as JSON has them, or, where it has none, by their names: a difference of finite numbers may be none.

use serde::{Deserialize, Deserializer, Serialize, Serializer};

#[derive(Serialize, Deserialize)]
#[serde(untagged, expecting = "a number, or \"Infinity\", \"-Infinity\" or \"NaN\"")]
enum Number {
    Finite(f64),
    Named(NumberName),
}

#[derive(Serialize, Deserialize)]
enum NumberName {
    Infinity,
    #[serde(rename = "-Infinity")]
    NegativeInfinity,
    NaN,
}

/// Writes a number.
pub(super) fn serialize<S: Serializer>(value: &Option<f64>, serializer: S) -> Result<S::Ok, S::Error> {
    let number = value.map(|value| match value {
        v if v.is_finite() => Number::Finite(v),
        v if v.is_nan() => Number::Named(NumberName::NaN),
        v if v > 0.0 => Number::Named(NumberName::Infinity),
        _ => Number::Named(NumberName::NegativeInfinity),
    });
    number.serialize(serializer)
}

/// Reads a number.
pub(super) fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Option<f64>, D::Error> {
    let number = Option::<Number>::deserialize(deserializer)?;
    Ok(number.map(|number| match number {
        Number::Finite(value) => value,
        Number::Named(NumberName::Infinity) => f64::INFINITY,
        Number::Named(NumberName::NegativeInfinity) => f64::NEG_INFINITY,
        Number::Named(NumberName::NaN) => f64::NAN,
    }))
}
