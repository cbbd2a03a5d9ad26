//! The files of TLS, read and checked.

use super::tls_config::TlsConfig;
use std::path::Path;
use std::sync::Arc;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};
use tokio_rustls::rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use tokio_rustls::rustls::{RootCertStore, ServerConfig};

/// Largest of these files, bytes.
pub const LARGEST_TLS_FILE: u64 = 1 << 20;

/// The bytes of the files, to detect changes.
#[derive(Clone, PartialEq, Eq)]
pub(super) struct TlsFiles {
    /// The server's certificate and its key, which go together.
    pub pair: [Vec<u8>; 2],
    /// The authorities of clients, which are followed whatever becomes of the pair.
    pub client_ca: Option<Vec<u8>>,
}

impl TlsFiles {
    /// Reads the files.
    ///
    /// # Errors
    /// The file and what the operating system said.
    pub fn read(config: &TlsConfig) -> Result<Self, String> {
        Ok(Self {
            pair: Self::read_pair(config)?,
            client_ca: Self::read_client_ca(config)?,
        })
    }

    /// Reads the certificate and its key.
    ///
    /// # Errors
    /// As [`TlsFiles::read`].
    pub fn read_pair(config: &TlsConfig) -> Result<[Vec<u8>; 2], String> {
        Ok([
            read_file("certificate", &config.certificate)?,
            read_file("key", &config.key)?,
        ])
    }

    /// Reads the authorities of clients.
    ///
    /// # Errors
    /// As [`TlsFiles::read`].
    pub fn read_client_ca(config: &TlsConfig) -> Result<Option<Vec<u8>>, String> {
        let path = config.client_ca.as_deref();
        path.map(|path| read_file("clients' authorities", path)).transpose()
    }

    /// What a handshake needs.
    ///
    /// # Errors
    /// The file and what is wrong with it; also a key that is not the certificate's.
    pub fn server_config(&self, paths: &TlsConfig) -> Result<ServerConfig, String> {
        let provider = Arc::new(ring::default_provider());
        let chain = certificates("certificate", &self.pair[0], &paths.certificate)?;
        let key = PrivateKeyDer::from_pem_slice(&self.pair[1])
            .map_err(|e| format!("the TLS key {} is not a private key in PEM: {e}", paths.key.display()))?;
        let builder = ServerConfig::builder_with_provider(Arc::clone(&provider))
            .with_safe_default_protocol_versions()
            .map_err(|e| e.to_string())?;
        let builder = match (&self.client_ca, &paths.client_ca) {
            (Some(bytes), Some(path)) => {
                let mut roots = RootCertStore::empty();
                for authority in certificates("clients' authorities", bytes, path)? {
                    roots
                        .add(authority)
                        .map_err(|e| format!("the clients' authorities in {}: {e}", path.display()))?;
                }
                let verifier = WebPkiClientVerifier::builder_with_provider(Arc::new(roots), provider)
                    // Who shows none may still bring a token, or ask for the health.
                    .allow_unauthenticated()
                    .build()
                    .map_err(|e| format!("the clients' authorities in {}: {e}", path.display()))?;
                builder.with_client_cert_verifier(verifier)
            }
            _ => builder.with_no_client_auth(),
        };
        let mut config = builder.with_single_cert(chain, key).map_err(|e| {
            format!(
                "the TLS certificate {} and the key {} do not go together: {e}",
                paths.certificate.display(),
                paths.key.display()
            )
        })?;
        config.alpn_protocols = vec![b"h2".to_vec(), b"http/1.1".to_vec()];
        if self.client_ca.is_some() {
            // A resumed session would not look at the client's certificate again, also after its authority is gone.
            config.session_storage = Arc::new(NoServerSessionStorage {});
            config.send_tls13_tickets = 0;
        }
        Ok(config)
    }
}

fn certificates(what: &str, bytes: &[u8], path: &Path) -> Result<Vec<CertificateDer<'static>>, String> {
    let found: Result<Vec<_>, _> = CertificateDer::pem_slice_iter(bytes).collect();
    match found {
        Ok(found) if !found.is_empty() => Ok(found),
        Ok(_) => Err(format!("the TLS {what} {} holds no certificate in PEM", path.display())),
        Err(e) => Err(format!("the TLS {what} {} is not PEM: {e}", path.display())),
    }
}

fn read_file(what: &str, path: &Path) -> Result<Vec<u8>, String> {
    let told = |problem: String| format!("cannot read the TLS {what} {}: {problem}", path.display());
    let size = std::fs::metadata(path).map_err(|e| told(e.to_string()))?;
    if !size.is_file() || size.len() > LARGEST_TLS_FILE {
        return Err(told("it must be a regular file of at most 1 MiB".into()));
    }
    std::fs::read(path).map_err(|e| told(e.to_string()))
}
