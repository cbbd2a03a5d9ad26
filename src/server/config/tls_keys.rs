//! The keys of TLS.

use super::Error;
use super::keys::KeyValue;
use super::sources::MergedKeys;
use crate::server::tls::{CertificateField, TlsConfig};
use std::path::PathBuf;

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
            let told = format!("\"{other}\" is not known; allowed are cn and uri");
            return Err(merged.refuse("tls_client_tenant", told));
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
            let told = "clients show certificates over TLS alone; set tls_certificate and tls_key as well";
            Err(merged.refuse("tls_client_ca", told.into()))
        }
        (None, None) => Ok(None),
    }
}
