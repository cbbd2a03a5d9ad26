//! The keys of connections, TLS, sessions and nodes that share a store, checked into typed values.

use super::Error;
use super::auth_settings::auth_from_keys;
use super::keys::KeyValue;
use super::keys::{ByteSize, TimeSpan};
use super::sources::MergedKeys;
use crate::auth::AuthConfig;
use crate::request_filter::{Hosts, Origins};
use crate::tls::{CertificateField, TlsConfig};
use http::Uri;
use pliant_session::store::NodeIdentity;
use pliant_session::{TenantQuota, TenantQuotas};
use std::net::IpAddr;
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How connections are treated. It is read by [`run`](crate::run); sessions have a configuration of their own.
#[derive(Debug, Clone, PartialEq)]
pub struct ServerConfig {
    /// Most connections at a time; further ones get 503.
    pub connections: u32,
    /// Most connections of one address at a time; further ones get 503.
    pub connections_per_peer: u32,
    /// HTTP/2 streams of one connection at a time.
    pub requests_per_connection: u32,
    /// How long a connection may take to send a request's head.
    pub header_timeout: Duration,
    /// Silence after which HTTP/2 and WebSocket peers are asked for a sign of life.
    pub keepalive_interval: Duration,
    /// How long that sign of life may take.
    pub keepalive_timeout: Duration,
    /// Slowest upload that is not given up, in bytes a second on average.
    pub upload_rate: u64,
    /// Longest time that an upload may take.
    pub upload_deadline: Duration,
    /// How long an answer may wait for its reader to take some more of it.
    pub unread_deadline: Duration,
    /// From the wish to stop until everything still open is dropped.
    pub drain_deadline: Duration,
    /// Names under which the server may be addressed.
    pub hosts: Hosts,
    /// Browser origins that may call.
    pub origins: Origins,
    /// Whether gRPC reflection answers.
    pub reflection: bool,
    /// Whether `/metrics` answers.
    pub metrics: bool,
    /// How callers prove who they are.
    pub auth: AuthConfig,
    /// TLS, where the server speaks it.
    pub tls: Option<TlsConfig>,
    /// Whether to serve every client that reaches the port, also beyond this machine.
    pub insecure_open: bool,
}

impl Default for ServerConfig {
    fn default() -> Self {
        Self {
            connections: 4096,
            connections_per_peer: 1024,
            requests_per_connection: 64,
            header_timeout: Duration::from_secs(10),
            keepalive_interval: Duration::from_secs(30),
            keepalive_timeout: Duration::from_secs(20),
            upload_rate: 4096,
            upload_deadline: Duration::from_secs(600),
            unread_deadline: Duration::from_secs(60),
            drain_deadline: Duration::from_secs(10),
            hosts: Hosts::default(),
            origins: Origins::default(),
            reflection: true,
            metrics: true,
            auth: AuthConfig::default(),
            tls: None,
            insecure_open: false,
        }
    }
}

const MILLISECOND: Duration = Duration::from_millis(1);
/// How long a node keeps its sessions without a heartbeat to the database.
const LEASE: Duration = Duration::from_secs(4);
/// How often it sends one.
const HEARTBEAT: Duration = Duration::from_secs(1);
const SECOND: Duration = Duration::from_secs(1);
const HOUR: Duration = Duration::from_secs(3600);

impl ServerConfig {
    /// Whether callers must prove who they are.
    pub fn authenticates(&self) -> bool {
        let by_certificate = self.tls.as_ref().is_some_and(|tls| tls.client_ca.is_some());
        by_certificate || self.auth.accepts_tokens()
    }

    /// Refuses to listen where others than this machine's users are, and serve them all unasked.
    ///
    /// # Errors
    /// What to do about it.
    pub fn check_address(&self, listen: IpAddr) -> Result<(), String> {
        if listen.to_canonical().is_loopback() || self.insecure_open || self.authenticates() {
            return Ok(());
        }
        Err(format!(
            "{listen} can be reached from other machines, and anyone could use the server; require tokens ([[auth.tokens]] \
             in the file, `pliant token` makes one, or [auth.jwt]) or client certificates (tls_client_ca), or serve everyone with \
             --insecure-open"
        ))
    }

    /// Reads the keys that concern connections; those that are absent leave the defaults. What can be reached from elsewhere
    /// has names that only its operator knows: without the key, it answers to all.
    pub(super) fn from_keys(merged: &MergedKeys, listen: IpAddr, file: Option<&Path>) -> Result<Self, Error> {
        let keys = &merged.keys;
        let mut config = Self::default();
        let set_count = |key: &str, value: &Option<KeyValue<u32>>, count: &mut u32, highest: u32| {
            let seen = KeyValue::read(value).unwrap_or(*count);
            if seen == 0 || seen > highest {
                return Err(merged.refuse(key, format!("{seen} is out of range; allowed are 1 to {highest}")));
            }
            *count = seen;
            Ok(())
        };
        set_count("connections", &keys.connections, &mut config.connections, 1_000_000)?;
        let (value, per_peer) = (&keys.connections_per_peer, &mut config.connections_per_peer);
        set_count("connections_per_peer", value, per_peer, 1_000_000)?;
        let (value, requests) = (&keys.requests_per_connection, &mut config.requests_per_connection);
        set_count("requests_per_connection", value, requests, 65_536)?;
        for (key, value, time, lowest) in [
            (
                "header_timeout",
                &keys.header_timeout,
                &mut config.header_timeout,
                10 * MILLISECOND,
            ),
            (
                "keepalive_interval",
                &keys.keepalive_interval,
                &mut config.keepalive_interval,
                SECOND,
            ),
            (
                "keepalive_timeout",
                &keys.keepalive_timeout,
                &mut config.keepalive_timeout,
                SECOND,
            ),
            (
                "upload_deadline",
                &keys.upload_deadline,
                &mut config.upload_deadline,
                10 * MILLISECOND,
            ),
            (
                "unread_deadline",
                &keys.unread_deadline,
                &mut config.unread_deadline,
                10 * MILLISECOND,
            ),
            (
                "drain_deadline",
                &keys.drain_deadline,
                &mut config.drain_deadline,
                10 * MILLISECOND,
            ),
        ] {
            *time = time_within(merged, key, value, *time, lowest..=HOUR)?;
        }
        if let Some(ByteSize(rate)) = KeyValue::read(&keys.upload_rate) {
            if rate == 0 {
                return Err(merged.refuse("upload_rate", "0 is out of range; allowed is 1 or more".into()));
            }
            config.upload_rate = rate;
        }
        match KeyValue::read(&keys.hosts) {
            Some(words) => config.hosts = Hosts::parse(&words.0).map_err(|e| merged.refuse("hosts", e))?,
            None if listen.is_loopback() => {}
            None => config.hosts = Hosts::any(),
        }
        if let Some(words) = KeyValue::read(&keys.cors_origins) {
            config.origins = Origins::parse(&words.0).map_err(|e| merged.refuse("cors_origins", e))?;
        }
        let is_set = |value: &Option<KeyValue<bool>>, default| KeyValue::read(value).unwrap_or(default);
        Ok(Self {
            reflection: is_set(&keys.reflection, config.reflection),
            metrics: is_set(&keys.metrics, config.metrics),
            insecure_open: is_set(&keys.insecure_open, config.insecure_open),
            auth: auth_from_keys(merged, file)?,
            tls: tls_from_keys(merged)?,
            ..config
        })
    }
}

/// The time of a key, or the default where it is absent, which must lie within a range.
fn time_within(
    merged: &MergedKeys,
    key: &str,
    value: &Option<KeyValue<TimeSpan>>,
    default: Duration,
    range: RangeInclusive<Duration>,
) -> Result<Duration, Error> {
    let time = KeyValue::read(value).map_or(default, |span| span.0);
    if range.contains(&time) {
        return Ok(time);
    }
    let [time, lowest, highest] = [time, *range.start(), *range.end()].map(humantime::format_duration);
    Err(merged.refuse(
        key,
        format!("{time} is out of range; allowed are {lowest} to {highest}"),
    ))
}

/// Reads the keys of TLS; `None` where there is none.
fn tls_from_keys(merged: &MergedKeys) -> Result<Option<TlsConfig>, Error> {
    let keys = &merged.keys;
    let path = |key: &Option<KeyValue<String>>| {
        let named = KeyValue::read(key).filter(|name| !name.is_empty());
        named.map(PathBuf::from)
    };
    let client_ca = path(&keys.tls_client_ca);
    let client_tenant = match KeyValue::read(&keys.tls_client_tenant).as_deref() {
        None | Some("cn") => CertificateField::CommonName,
        Some("uri") => CertificateField::Uri,
        Some(other) => {
            let problem = format!("\"{other}\" is not known; allowed are cn and uri");
            return Err(merged.refuse("tls_client_tenant", problem));
        }
    };
    match (path(&keys.tls_certificate), path(&keys.tls_key)) {
        (Some(certificate), Some(key)) => Ok(Some(TlsConfig {
            certificate,
            key,
            client_ca,
            client_tenant,
        })),
        (Some(_), None) => Err(merged.refuse("tls_certificate", "has no key beside it; set tls_key as well".into())),
        (None, Some(_)) => Err(merged.refuse("tls_key", "has no certificate; set tls_certificate as well".into())),
        (None, None) if client_ca.is_some() => {
            let problem = "clients show certificates over TLS alone; set tls_certificate and tls_key as well";
            Err(merged.refuse("tls_client_ca", problem.into()))
        }
        (None, None) => Ok(None),
    }
}

/// Reads what each tenant may use.
fn quotas_from_keys(merged: &MergedKeys) -> Result<TenantQuotas, Error> {
    let check = |place: String, quota: TenantQuota| match quota.validate() {
        Ok(()) => Ok(quota),
        Err(error) => Err(refuse_field(merged, &format!("{place}."), &error)),
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
pub(super) fn session_config_from_keys(merged: &MergedKeys) -> Result<pliant_session::SessionConfig, Error> {
    let keys = &merged.keys;
    let mut config = pliant_session::SessionConfig::default();
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
    config.validate().map_err(|error| refuse_field(merged, "", &error))?;
    Ok(config)
}

/// The refusal of a value that the sessions refuse: of the key that is called as its field, in the table `table`.
fn refuse_field(merged: &MergedKeys, table: &str, error: &pliant_session::Error) -> Error {
    let key = error.field.as_deref().unwrap_or_default();
    let problem = error.message.strip_prefix(key).unwrap_or(&error.message);
    merged.refuse(
        &format!("{table}{key}"),
        problem.trim_start_matches([':', ' ']).to_owned(),
    )
}

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
    let leases = 500 * MILLISECOND..=Duration::from_secs(300);
    let lease = time_within(merged, "lease", &keys.lease, LEASE, leases)?;
    // Two words may be lost before the lease has run out.
    let beats = 50 * MILLISECOND..=lease / 3;
    let heartbeat = time_within(merged, "heartbeat", &keys.heartbeat, HEARTBEAT.min(lease / 3), beats)?;
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
