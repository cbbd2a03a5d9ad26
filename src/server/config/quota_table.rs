//! The tables `quotas` and `tenants` of the configuration's file, as they stand there.

use super::units::{ByteSize, TimeSpan};
use crate::session::TenantQuota;
use serde::Deserialize;

/// What a tenant may use, as it stands in the file.
#[derive(Debug, Clone, Default, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct QuotaTable {
    sessions: Option<u64>,
    memory_bytes: Option<ByteSize>,
    stored_bytes: Option<ByteSize>,
    upload_bytes_per_minute: Option<ByteSize>,
    solve_seconds_per_minute: Option<f64>,
    streams: Option<u64>,
    ttl: Option<TimeSpan>,
    max_ttl: Option<TimeSpan>,
    audit_age: Option<TimeSpan>,
}

impl From<QuotaTable> for TenantQuota {
    fn from(table: QuotaTable) -> Self {
        let bytes = |size: Option<ByteSize>| size.map(|size| size.0);
        let span = |span: Option<TimeSpan>| span.map(|span| span.0);
        Self {
            sessions: table.sessions,
            memory_bytes: bytes(table.memory_bytes),
            stored_bytes: bytes(table.stored_bytes),
            upload_bytes_per_minute: bytes(table.upload_bytes_per_minute),
            solve_seconds_per_minute: table.solve_seconds_per_minute,
            streams: table.streams,
            ttl: span(table.ttl),
            max_ttl: span(table.max_ttl),
            audit_age: span(table.audit_age),
        }
    }
}
