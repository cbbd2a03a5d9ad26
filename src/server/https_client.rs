//! Calls that this program makes itself, over HTTP and HTTPS.

use super::own_certificate::OwnCertificate;
use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::connect::HttpConnector;
use std::path::Path;
use std::sync::Arc;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::CertificateDer;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// Makes connections to servers whose certificates are signed by an authority of this machine, or, where it is given, of the PEM
/// file `ca`. Authorities of the machine are those of the operating system, or of `SSL_CERT_FILE`.
///
/// # Errors
/// The file and what is wrong with it.
pub fn https_connector(ca: Option<&Path>) -> Result<HttpsConnector<HttpConnector>, String> {
    let mut roots = RootCertStore::empty();
    match ca {
        Some(path) => {
            let told = |problem: String| format!("cannot use the authorities in {}: {problem}", path.display());
            let found: Result<Vec<_>, _> = CertificateDer::pem_file_iter(path)
                .map_err(|e| told(e.to_string()))?
                .collect();
            for authority in found.map_err(|e| told(e.to_string()))? {
                roots.add(authority).map_err(|e| told(e.to_string()))?;
            }
            if roots.is_empty() {
                return Err(told("it holds no certificate in PEM".into()));
            }
        }
        // A machine without any can still speak HTTP.
        None => {
            roots.add_parsable_certificates(rustls_native_certs::load_native_certs().certs);
        }
    }
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .map_err(|e| e.to_string())?
        .with_root_certificates(roots)
        .with_no_client_auth();
    Ok(connector_of(config))
}

/// Makes connections to the server whose own certificate is in the PEM file, whatever name it is called by.
///
/// # Errors
/// The file and what is wrong with it.
pub fn own_connector(certificate: &Path) -> Result<HttpsConnector<HttpConnector>, String> {
    let provider = Arc::new(ring::default_provider());
    let verifier = OwnCertificate::read(certificate, Arc::clone(&provider))?;
    let config = ClientConfig::builder_with_provider(provider)
        .with_safe_default_protocol_versions()
        .map_err(|e| e.to_string())?
        .dangerous()
        .with_custom_certificate_verifier(Arc::new(verifier))
        .with_no_client_auth();
    Ok(connector_of(config))
}

fn connector_of(config: ClientConfig) -> HttpsConnector<HttpConnector> {
    let connector = HttpsConnectorBuilder::new()
        .with_tls_config(config)
        .https_or_http()
        .enable_http1();
    connector.build()
}
