//! What is wrong with a configuration, in the words of those who write one.

use figment::error::{Actual, Kind, OneOf};

/// The default port of a server.
const PORT: u16 = 7411;

/// Why a value cannot be read.
pub(super) fn unreadable(key: &str, kind: &Kind) -> String {
    match kind {
        Kind::InvalidType(Actual::Unsigned(port), _) if key == "listen" => no_address(&port.to_string()),
        Kind::InvalidType(Actual::Signed(port), _) if key == "listen" => no_address(&port.to_string()),
        Kind::InvalidType(seen, wanted) | Kind::InvalidValue(seen, wanted) => {
            format!("is {}, {} is allowed", seen_value(seen), wanted_value(wanted))
        }
        Kind::UnknownVariant(seen, allowed) => format!("is \"{seen}\", {} is allowed", OneOf(allowed)),
        Kind::MissingField(name) => format!("{name} is missing"),
        Kind::Message(text) => toml_problem(text).unwrap_or_else(|| text.clone()),
        other => other.to_string(),
    }
}

/// Reports an invalid listen address, and which one it may have meant.
pub(super) fn no_address(text: &str) -> String {
    let meant = meant_address(text).unwrap_or_else(|| format!("127.0.0.1:{PORT} or [::]:{PORT}"));
    format!("{text} is not an address; write an IP address and a port: {meant}")
}

fn meant_address(text: &str) -> Option<String> {
    let text = text.trim();
    if let Ok(address) = text.parse::<std::net::IpAddr>() {
        return Some(std::net::SocketAddr::new(address, PORT).to_string());
    }
    let (host, port) = text.rsplit_once(':').unwrap_or(match text.parse::<u16>() {
        Ok(_) => ("", text),
        Err(_) => (text, ""),
    });
    let port = if port.is_empty() { PORT } else { port.parse().ok()? };
    match host {
        "" | "localhost" => Some(format!("127.0.0.1:{port}")),
        "*" => Some(format!("0.0.0.0:{port}")),
        _ => None,
    }
}

fn seen_value(seen: &Actual) -> String {
    match seen {
        Actual::Bool(value) => value.to_string(),
        Actual::Unsigned(value) => value.to_string(),
        Actual::Signed(value) => value.to_string(),
        Actual::Float(value) => value.to_string(),
        Actual::Str(text) => format!("\"{text}\""),
        Actual::Seq => "a list".into(),
        Actual::Map => "a table".into(),
        other => other.to_string(),
    }
}

fn wanted_value(wanted: &str) -> String {
    match wanted {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number from 0".into(),
        "f32" | "f64" => "a number".into(),
        "a boolean" => "true or false".into(),
        "a string" => "a text in quotes".into(),
        "a sequence" => "a list".into(),
        "a map" => "a table".into(),
        wanted => wanted.strip_prefix("struct ").map_or(wanted, |_| "a table").to_owned(),
    }
}

/// What the reader of TOML says over several lines, with a picture of the place, in one.
fn toml_problem(text: &str) -> Option<String> {
    let mut lines = text.lines();
    let place = lines.next()?.strip_prefix("TOML parse error at ")?;
    let is_picture = |line: &&str| {
        line.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ')
            .starts_with('|')
    };
    let problem: Vec<&str> = lines.skip_while(is_picture).map(str::trim).collect();
    Some(format!("{place}: {}", problem.join(", ")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_may_have_been_meant_is_told() {
        for (text, meant) in [
            ("7412", "port: 127.0.0.1:7412"),
            (":7412", "port: 127.0.0.1:7412"),
            ("localhost", "port: 127.0.0.1:7411"),
            ("localhost:80", "port: 127.0.0.1:80"),
            ("*:80", "port: 0.0.0.0:80"),
            ("10.0.0.7", "port: 10.0.0.7:7411"),
            ("::1", "port: [::1]:7411"),
            ("mesh.example.org:80", "127.0.0.1:7411 or [::]:7411"),
            ("99999", "127.0.0.1:7411 or [::]:7411"),
            ("", "127.0.0.1:7411"),
        ] {
            let told = no_address(text);
            assert!(
                told.starts_with(&format!("{text} is not an address")) && told.contains(meant),
                "{told}"
            );
        }
    }
}
