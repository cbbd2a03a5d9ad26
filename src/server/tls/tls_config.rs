//! Which files TLS is made of.

use std::path::PathBuf;

/// This says which files TLS is made of. They are checked at the start, and followed when they change.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct TlsConfig {
    /// PEM file of the server's certificate, those that signed it after it.
    pub certificate: PathBuf,
    /// PEM file of its private key.
    pub key: PathBuf,
    /// PEM file of the authorities whose certificates clients may show.
    pub client_ca: Option<PathBuf>,
    /// What of a client's certificate is its tenant.
    pub client_tenant: CertificateField,
}

/// A field of a certificate that names whom it belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum CertificateField {
    /// The common name of its subject.
    #[default]
    CommonName,
    /// The one URI among its alternative names, such as a SPIFFE id.
    Uri,
}
