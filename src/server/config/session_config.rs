//! The keys that concern sessions.

use super::Error;
use super::keys::KeyValue;
use super::sources::MergedKeys;
use super::units::ByteSize;
use crate::session::{self, TenantQuota, TenantQuotas};
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
