//! Numbers as people read them in warnings and summaries; programs get them whole beside the text.

use glam::DVec3;

/// Writes a number with three significant digits, with thousands apart, and with an exponent where there would be many zeros.
///
/// ```
/// use pliant_core::mesh::brief_number;
///
/// let brief = [0.1565576, -203.39247, 0.0, 12345.6, 2.0, 1.5e-7].map(brief_number);
/// assert_eq!(brief, ["0.157", "-203", "0", "12,346", "2", "1.50e-7"]);
/// ```
#[must_use]
pub fn brief_number(x: f64) -> String {
    if x == 0.0 {
        return "0".into();
    }
    if !(1e-4..1e15).contains(&x.abs()) {
        return format!("{x:.2e}");
    }
    let magnitude = libm::floor(libm::log10(x.abs())) as i32;
    let digits = usize::try_from(2 - magnitude).unwrap_or(0);
    let plain = format!("{x:.digits$}");
    let short = match plain.contains('.') {
        true => plain.trim_end_matches('0').trim_end_matches('.'),
        false => &plain,
    };
    match (short.contains('.'), short.strip_prefix('-')) {
        (true, _) => short.to_owned(),
        (false, Some(size)) => format!("-{}", with_commas(size)),
        (false, None) => with_commas(short),
    }
}

/// Writes a count with thousands apart.
///
/// ```
/// assert_eq!(pliant_core::mesh::grouped_count(1_234_567), "1,234,567");
/// assert_eq!(pliant_core::mesh::grouped_count(999), "999");
/// ```
#[must_use]
pub fn grouped_count(n: u64) -> String {
    with_commas(&n.to_string())
}

/// Writes a place, each coordinate with three significant digits.
#[must_use]
pub fn brief_point(p: DVec3) -> String {
    let [x, y, z] = p.to_array().map(brief_number);
    format!("({x}, {y}, {z})")
}

/// Puts a comma before every three digits.
fn with_commas(digits: &str) -> String {
    let mut out = String::with_capacity(digits.len() * 4 / 3);
    for (k, digit) in digits.chars().enumerate() {
        if k > 0 && (digits.len() - k).is_multiple_of(3) {
            out.push(',');
        }
        out.push(digit);
    }
    out
}
