//! The keys of a server that is one of several nodes.

use super::Error;
use super::keys::KeyValue;
use super::sources::MergedKeys;
use super::units::TimeSpan;
use crate::session::store::NodeIdentity;
use http::Uri;
use std::time::Duration;

/// How long a node keeps its sessions without a word to the database.
const LEASE: Duration = Duration::from_secs(4);
/// How often it says one.
const HEARTBEAT: Duration = Duration::from_secs(1);
const MILLISECOND: Duration = Duration::from_millis(1);

/// This server as one of several nodes, if it is one.
pub(super) fn node_identity(merged: &MergedKeys) -> Result<Option<NodeIdentity>, Error> {
    let keys = &merged.keys;
    let Some(address) = KeyValue::read(&keys.advertise).filter(|url| !url.is_empty()) else {
        return Ok(None);
    };
    let authority = authority_of(&address).ok_or_else(|| {
        let problem =
            format!("\"{address}\" is not the address of a node; allowed is http:// or https:// with a host and a port, such as http://10.0.0.5:7411");
        merged.refuse("advertise", problem)
    })?;
    let name = KeyValue::read(&keys.node).unwrap_or(authority);
    let is_name = |c: char| c.is_ascii_alphanumeric() || "._:-[]".contains(c);
    if name.is_empty() || name.len() > 100 || !name.chars().all(is_name) {
        let problem = format!("\"{name}\" is not a name; allowed are 1 to 100 letters, digits, dots, colons, _ and -");
        return Err(merged.refuse("node", problem));
    }
    let time = |key: &str, value: &Option<KeyValue<TimeSpan>>, default: Duration, range: (Duration, Duration)| {
        let value = KeyValue::read(value).map_or(default, |span| span.0);
        if value >= range.0 && value <= range.1 {
            return Ok(value);
        }
        let [lowest, highest] = [range.0, range.1].map(humantime::format_duration);
        let problem = format!(
            "{} is out of range; allowed are {lowest} to {highest}",
            humantime::format_duration(value)
        );
        Err(merged.refuse(key, problem))
    };
    let lease = time(
        "lease",
        &keys.lease,
        LEASE,
        (500 * MILLISECOND, Duration::from_secs(300)),
    )?;
    // Two words may be lost before the lease has run out.
    let heartbeat = time(
        "heartbeat",
        &keys.heartbeat,
        HEARTBEAT.min(lease / 3),
        (50 * MILLISECOND, lease / 3),
    )?;
    Ok(Some(NodeIdentity {
        name,
        address: address.trim_end_matches('/').to_owned(),
        lease,
        heartbeat,
    }))
}

/// Host and port of an address that names nothing else.
fn authority_of(address: &str) -> Option<String> {
    let uri: Uri = address.parse().ok()?;
    let is_known = matches!(uri.scheme_str(), Some("http" | "https"));
    let is_bare = uri.path() == "/" && uri.query().is_none();
    let authority = uri.authority()?;
    let is_plain = !authority.as_str().contains('@') && !authority.host().is_empty();
    (is_known && is_bare && is_plain).then(|| authority.to_string())
}
