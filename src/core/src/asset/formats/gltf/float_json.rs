//! 32-bit floats as JSON, so that they read back as exactly the same floats.

use super::text::json_array;

/// The least and the largest value of each lane as JSON, which read back as exactly the same floats.
pub(super) fn bounds(values: &[f32], lanes: usize) -> (String, String) {
    let mut least = vec![f32::INFINITY; lanes];
    let mut most = vec![f32::NEG_INFINITY; lanes];
    for element in values.chunks_exact(lanes) {
        for (lane, &v) in element.iter().enumerate() {
            least[lane] = least[lane].min(v);
            most[lane] = most[lane].max(v);
        }
    }
    (json_floats(&least), json_floats(&most))
}

/// As doubles: readers of doubles and of floats get the same number.
pub(super) fn json_floats(values: &[f32]) -> String {
    json_array(values.iter().map(|&v| format!("{:?}", f64::from(v))))
}
