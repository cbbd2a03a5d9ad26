//! TLS on the server's own port: its certificate, those of clients, and both replaced while it runs.

mod certificate_tenant;
mod tls_config;
mod tls_door;
mod tls_files;

pub use tls_config::{CertificateField, TlsConfig};
pub(super) use tls_door::TlsDoor;
pub use tls_files::LARGEST_TLS_FILE;
