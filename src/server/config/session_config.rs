//! The keys that concern sessions, and those of a server that is one of several nodes.

use super::Error;
use super::keys::KeyValue;
use super::sources::MergedKeys;
use super::units::{ByteSize, TimeSpan};
use crate::session::store::NodeIdentity;
use crate::session::{self, TenantQuota, TenantQuotas};
use http::Uri;
use std::time::Duration;

/// Reads what each tenant may use.
fn quotas_from_keys(merged: &MergedKeys) -> Result<TenantQuotas, Error> {
    let check = |place: String, quota: TenantQuota| match quota.validate() {
        Ok(()) => Ok(quota),
        Err(error) => {
            let key = error.field.as_deref().unwrap_or_default();
            let problem = error.message.strip_prefix(key).unwrap_or(&error.message);
            Err(merged.refuse(
                &format!("{place}.{key}"),
                problem.trim_start_matches([':', ' ']).to_owned(),
            ))
        }
    };
    let default = merged.keys.quotas.clone().unwrap_or_default();
    let named = merged.keys.tenants.clone().unwrap_or_default().into_iter();
    Ok(TenantQuotas {
        default: check("quotas".into(), default.into())?,
        named: named
            .map(|(name, table)| Ok((name.clone(), check(format!("tenants.{name}"), table.into())?)))
            .collect::<Result<_, Error>>()?,
    })
}

/// Reads the keys that concern sessions; those that are absent leave the defaults.
pub(super) fn session_config_from_keys(merged: &MergedKeys) -> Result<session::SessionConfig, Error> {
    let keys = &merged.keys;
    let mut config = session::SessionConfig::default();
    let wide = |n: u64| usize::try_from(n).unwrap_or(usize::MAX);
    let set_bytes = |value: &Option<KeyValue<ByteSize>>, bytes: &mut u64| {
        *bytes = KeyValue::read(value).map_or(*bytes, |size| size.0);
    };
    let set_count = |value: &Option<KeyValue<u32>>, count: &mut usize| {
        *count = KeyValue::read(value).map_or(*count, |n| wide(n.into()));
    };
    set_bytes(&keys.upload_bytes, &mut config.upload_bytes);
    set_bytes(&keys.memory_bytes, &mut config.memory_bytes);
    set_bytes(&keys.message_bytes, &mut config.message_bytes);
    set_count(&keys.handles, &mut config.handles);
    set_count(&keys.history, &mut config.history);
    set_count(&keys.streams, &mut config.streams);
    set_count(&keys.animations, &mut config.animations);
    set_bytes(&keys.clip_bytes, &mut config.clip_bytes);
    set_count(&keys.clip_joints, &mut config.clip_joints);
    set_count(&keys.animation_frames, &mut config.animation_frames);
    config.animation_vertices = KeyValue::read(&keys.animation_vertices).unwrap_or(config.animation_vertices);
    set_count(&keys.threads, &mut config.compute_threads);
    if let Some(vertices) = KeyValue::read(&keys.vertices) {
        config.vertices = vertices;
        // A closed surface has about twice as many triangles as vertices.
        config.triangles = vertices.saturating_mul(2).max(1024);
    }
    config.sessions = KeyValue::read(&keys.sessions).map_or(config.sessions, wide);
    config.window = KeyValue::read(&keys.window).unwrap_or(config.window);
    config.max_ttl = KeyValue::read(&keys.max_ttl).map_or(config.max_ttl, |span| span.0);
    config.quotas = quotas_from_keys(merged)?;
    let default_ttl = config.default_ttl.min(config.max_ttl);
    config.default_ttl = KeyValue::read(&keys.ttl).map_or(default_ttl, |span| span.0);
    config.idle = KeyValue::read(&keys.idle).map_or(config.idle, |span| span.0);
    config.drain = KeyValue::read(&keys.drain_deadline).map_or(config.drain, |span| span.0);
    if let Some(ms) = KeyValue::read(&keys.solve_ms) {
        if !(1.0..=3_600_000.0).contains(&ms) {
            return Err(merged.refuse(
                "solve_ms",
                format!("{ms} is out of range; allowed are 1 to 3600000 milliseconds"),
            ));
        }
        config.solve = Duration::from_secs_f64(ms / 1e3);
    }
    if config.compute_threads > 1024 {
        return Err(merged.refuse(
            "threads",
            format!(
                "{} is out of range; allowed are 1 to 1024, and 0 for one per core",
                config.compute_threads
            ),
        ));
    }
    if config.message_bytes > 256 << 20 {
        return Err(merged.refuse(
            "message_bytes",
            format!("{} is out of range; allowed are 1KiB to 256MiB", config.message_bytes),
        ));
    }
    config.validate().map_err(|error| {
        let key = error.field.as_deref().unwrap_or_default();
        let problem = error.message.strip_prefix(key).unwrap_or(&error.message);
        merged.refuse(key, problem.trim_start_matches([':', ' ']).to_owned())
    })?;
    Ok(config)
}

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
