//! How connections are treated, and the keys of TLS.

use super::Error;
use super::auth_settings::auth_from_keys;
use super::keys::KeyValue;
use super::sources::MergedKeys;
use super::units::{ByteSize, TimeSpan};
use crate::server::auth::AuthConfig;
use crate::server::request_filter::{Hosts, Origins};
use crate::server::tls::{CertificateField, TlsConfig};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// How connections are treated. It is read by [`run`](crate::server::run); sessions have a configuration of their own.
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
        let (keys, defaults) = (&merged.keys, Self::default());
        let count = |key: &str, value: &Option<KeyValue<u32>>, default: u32, highest: u32| match KeyValue::read(value) {
            Some(value) if value == 0 || value > highest => {
                Err(merged.refuse(key, format!("{value} is out of range; allowed are 1 to {highest}")))
            }
            value => Ok(value.unwrap_or(default)),
        };
        let time =
            |key: &str, value: &Option<KeyValue<TimeSpan>>, default: Duration, lowest: Duration| match KeyValue::read(
                value,
            ) {
                Some(TimeSpan(value)) if value < lowest || value > HOUR => {
                    let problem = format!(
                        "{} is out of range; allowed are {} to {}",
                        humantime::format_duration(value),
                        humantime::format_duration(lowest),
                        humantime::format_duration(HOUR)
                    );
                    Err(merged.refuse(key, problem))
                }
                value => Ok(value.map_or(default, |span| span.0)),
            };
        let origins = KeyValue::read(&keys.cors_origins).map(|words| Origins::parse(&words.0));
        let hosts = KeyValue::read(&keys.hosts).map(|words| Hosts::parse(&words.0));
        Ok(Self {
            connections: count("connections", &keys.connections, defaults.connections, 1_000_000)?,
            connections_per_peer: count(
                "connections_per_peer",
                &keys.connections_per_peer,
                defaults.connections_per_peer,
                1_000_000,
            )?,
            requests_per_connection: count(
                "requests_per_connection",
                &keys.requests_per_connection,
                defaults.requests_per_connection,
                65_536,
            )?,
            header_timeout: time(
                "header_timeout",
                &keys.header_timeout,
                defaults.header_timeout,
                10 * MILLISECOND,
            )?,
            keepalive_interval: time(
                "keepalive_interval",
                &keys.keepalive_interval,
                defaults.keepalive_interval,
                SECOND,
            )?,
            keepalive_timeout: time(
                "keepalive_timeout",
                &keys.keepalive_timeout,
                defaults.keepalive_timeout,
                SECOND,
            )?,
            upload_rate: match KeyValue::read(&keys.upload_rate) {
                Some(ByteSize(0)) => {
                    return Err(merged.refuse("upload_rate", "0 is out of range; allowed is 1 or more".into()));
                }
                rate => rate.map_or(defaults.upload_rate, |rate| rate.0),
            },
            upload_deadline: time(
                "upload_deadline",
                &keys.upload_deadline,
                defaults.upload_deadline,
                10 * MILLISECOND,
            )?,
            unread_deadline: time(
                "unread_deadline",
                &keys.unread_deadline,
                defaults.unread_deadline,
                10 * MILLISECOND,
            )?,
            drain_deadline: time(
                "drain_deadline",
                &keys.drain_deadline,
                defaults.drain_deadline,
                10 * MILLISECOND,
            )?,
            hosts: match hosts {
                Some(hosts) => hosts.map_err(|problem| merged.refuse("hosts", problem))?,
                None if listen.is_loopback() => defaults.hosts,
                None => Hosts::any(),
            },
            origins: match origins {
                Some(origins) => origins.map_err(|problem| merged.refuse("cors_origins", problem))?,
                None => defaults.origins,
            },
            reflection: KeyValue::read(&keys.reflection).unwrap_or(defaults.reflection),
            metrics: KeyValue::read(&keys.metrics).unwrap_or(defaults.metrics),
            auth: auth_from_keys(merged, file)?,
            tls: tls_from_keys(merged)?,
            insecure_open: KeyValue::read(&keys.insecure_open).unwrap_or(defaults.insecure_open),
        })
    }
}

/// Reads the keys of TLS; `None` where there is none.
pub(super) fn tls_from_keys(merged: &MergedKeys) -> Result<Option<TlsConfig>, Error> {
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
