//! TLS on the server's own port: its certificate, those of clients, and both replaced while it runs; and the program's own calls over
//! HTTP and HTTPS.

use arc_swap::ArcSwap;
use hyper_rustls::{HttpsConnector, HttpsConnectorBuilder};
use hyper_util::client::legacy::connect::HttpConnector;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use tokio::net::TcpStream;
use tokio_rustls::rustls::client::danger::{HandshakeSignatureValid, ServerCertVerified, ServerCertVerifier};
use tokio_rustls::rustls::crypto::{CryptoProvider, ring, verify_tls12_signature, verify_tls13_signature};
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName, UnixTime};
use tokio_rustls::rustls::server::{NoServerSessionStorage, WebPkiClientVerifier};
use tokio_rustls::rustls::{
    CertificateError, ClientConfig, DigitallySignedStruct, Error, RootCertStore, ServerConfig, SignatureScheme,
};
use tokio_rustls::server::TlsStream;
use x509_cert::Certificate;
use x509_cert::der::Decode as _;
use x509_cert::der::asn1::{Any, Utf8StringRef};
use x509_cert::ext::pkix::SubjectAltName;
use x509_cert::ext::pkix::name::GeneralName;

/// The files that TLS uses. They are checked at the start, and followed when they change.
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

/// Negotiates TLS with the files as they are now. Cloning shares them.
#[derive(Clone)]
pub(crate) struct TlsAcceptor(Arc<Acceptor>);

struct Acceptor {
    config: TlsConfig,
    files: Mutex<FollowedFiles>,
    now: ArcSwap<ServerConfig>,
}

struct FollowedFiles {
    /// What was read last, of each file that could be read.
    seen: TlsFiles,
    /// The files in use.
    used: TlsFiles,
    /// Why a file that was read last is not in use.
    problem: Option<String>,
}

/// The outcome of reading the files again.
pub(crate) struct TlsReload {
    /// Whether handshakes from now on use other files.
    pub has_changed: bool,
    /// The file that cannot be used, and why; what was read of it before stays in use.
    pub problem: Option<String>,
}

impl TlsAcceptor {
    /// Reads and checks the files.
    ///
    /// # Errors
    /// The file and what is wrong with it.
    pub fn open(config: &TlsConfig) -> Result<Self, String> {
        let files = TlsFiles::read(config)?;
        let now = files.server_config(config)?;
        Ok(Self(Arc::new(Acceptor {
            config: config.clone(),
            files: Mutex::new(FollowedFiles {
                seen: files.clone(),
                used: files,
                problem: None,
            }),
            now: ArcSwap::from_pointee(now),
        })))
    }

    /// Whether clients may show certificates.
    pub fn takes_certificates(&self) -> bool {
        self.0.config.client_ca.is_some()
    }

    /// Reads the files again. Handshakes from now on use the valid ones; open connections stay as they are. The certificate with
    /// its key, and the authorities of clients, are followed independently: a removed authority is no longer accepted, even if
    /// the certificate cannot be read.
    pub fn reload(&self) -> TlsReload {
        let config = &self.0.config;
        let (pair, client_ca) = (TlsFiles::read_pair(config), TlsFiles::read_client_ca(config));
        let unread = pair.as_ref().err().or(client_ca.as_ref().err()).cloned();
        let mut files = self.0.files.lock().unwrap_or_else(PoisonError::into_inner);
        let seen = TlsFiles {
            pair: pair.unwrap_or_else(|_| files.seen.pair.clone()),
            client_ca: client_ca.unwrap_or_else(|_| files.seen.client_ca.clone()),
        };
        let mut has_changed = false;
        if seen != files.seen {
            let (problem, usable) = self.usable(&seen, &files.used);
            files.seen = seen;
            files.problem = problem;
            if let Some((used, made)) = usable {
                files.used = used;
                self.0.now.store(Arc::new(made));
                has_changed = true;
            }
        }
        TlsReload {
            has_changed,
            problem: unread.or_else(|| files.problem.clone()),
        }
    }

    /// The valid part of the files in place of those in use now, and why it is not all of them.
    fn usable(&self, seen: &TlsFiles, used: &TlsFiles) -> (Option<String>, Option<(TlsFiles, ServerConfig)>) {
        let make = |files: &TlsFiles| files.server_config(&self.0.config);
        let problem = match make(seen) {
            Ok(made) => return (None, Some((seen.clone(), made))),
            Err(problem) => problem,
        };
        let with_old_pair = TlsFiles {
            pair: used.pair.clone(),
            ..seen.clone()
        };
        let with_old_ca = TlsFiles {
            client_ca: used.client_ca.clone(),
            ..seen.clone()
        };
        let parts = [with_old_pair, with_old_ca].into_iter();
        let mut parts = parts.filter(|files| files != used);
        let usable = parts.find_map(|files| make(&files).ok().map(|made| (files, made)));
        (Some(problem), usable)
    }

    /// Negotiates TLS on a connection, and returns the tenant that the client's certificate names. A certificate of
    /// another authority ends it.
    pub async fn accept(&self, socket: TcpStream) -> io::Result<(TlsStream<TcpStream>, Option<String>)> {
        let stream = tokio_rustls::TlsAcceptor::from(self.0.now.load_full())
            .accept(socket)
            .await?;
        let (_, session) = stream.get_ref();
        let shown = session.peer_certificates().and_then(|chain| chain.first());
        let tenant = shown.and_then(|leaf| certificate_tenant(leaf.as_ref(), self.0.config.client_tenant));
        Ok((stream, tenant))
    }
}

/// Largest of these files, bytes.
pub const LARGEST_TLS_FILE: u64 = 1 << 20;

/// The bytes of the files, to detect changes.
#[derive(Clone, PartialEq, Eq)]
struct TlsFiles {
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

    /// The configuration of a handshake.
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
                    // A client without a certificate may still send a token, or ask for the health.
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
            // A resumed session would not check the client's certificate again, even after its authority was removed.
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
    let unreadable = |problem: String| format!("cannot read the TLS {what} {}: {problem}", path.display());
    let size = std::fs::metadata(path).map_err(|e| unreadable(e.to_string()))?;
    if !size.is_file() || size.len() > LARGEST_TLS_FILE {
        return Err(unreadable("it must be a regular file of at most 1 MiB".into()));
    }
    std::fs::read(path).map_err(|e| unreadable(e.to_string()))
}

/// Longest name that is a tenant's, bytes.
const LONGEST_NAME: usize = 256;

/// The tenant that a certificate names. `None` where it names none, or two: nothing is guessed.
fn certificate_tenant(der: &[u8], field: CertificateField) -> Option<String> {
    let certificate = Certificate::from_der(der).ok()?;
    let certificate = certificate.tbs_certificate();
    let names: Vec<String> = match field {
        CertificateField::CommonName => {
            let attributes = certificate.subject().iter();
            let named = attributes.filter(|a| a.oid == COMMON_NAME);
            named.map(|a| printable(&a.value)).collect::<Option<_>>()?
        }
        CertificateField::Uri => {
            let (_, names) = certificate.get_extension::<SubjectAltName>().ok()??;
            let uris = names.0.into_iter().filter_map(|name| match name {
                GeneralName::UniformResourceIdentifier(uri) => Some(uri.as_str().to_owned()),
                _ => None,
            });
            uris.collect()
        }
    };
    match <[String; 1]>::try_from(names) {
        Ok([name]) if is_name(&name) => Some(name),
        _ => None,
    }
}

const COMMON_NAME: x509_cert::der::asn1::ObjectIdentifier =
    x509_cert::der::asn1::ObjectIdentifier::new_unwrap("2.5.4.3");

/// The text of an attribute in either of the encodings that authorities use today.
fn printable(value: &Any) -> Option<String> {
    let utf8 = value
        .decode_as::<Utf8StringRef<'_>>()
        .map(|text| text.as_str().to_owned());
    let ascii = || value.decode_as::<x509_cert::der::asn1::PrintableStringRef<'_>>();
    utf8.or_else(|_| ascii().map(|text| text.as_str().to_owned())).ok()
}

fn is_name(name: &str) -> bool {
    !name.is_empty() && name.len() <= LONGEST_NAME && !name.chars().any(char::is_control)
}

/// Makes connections to servers whose certificates are signed by an authority of this machine, or, where it is given, of the PEM
/// file `ca`. Authorities of the machine are those of the operating system, or of `SSL_CERT_FILE`.
///
/// # Errors
/// The file and what is wrong with it.
pub fn https_connector(ca: Option<&Path>) -> Result<HttpsConnector<HttpConnector>, String> {
    let mut roots = RootCertStore::empty();
    match ca {
        Some(path) => {
            let unusable = |problem: String| format!("cannot use the authorities in {}: {problem}", path.display());
            let found: Result<Vec<_>, _> = CertificateDer::pem_file_iter(path)
                .map_err(|e| unusable(e.to_string()))?
                .collect();
            for authority in found.map_err(|e| unusable(e.to_string()))? {
                roots.add(authority).map_err(|e| unusable(e.to_string()))?;
            }
            if roots.is_empty() {
                return Err(unusable("it holds no certificate in PEM".into()));
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

/// Accepts the server that has the private key of one certificate, under any name and with any issuer.
#[derive(Debug)]
struct OwnCertificate {
    certificate: CertificateDer<'static>,
    provider: Arc<CryptoProvider>,
}

impl OwnCertificate {
    /// Takes the first certificate of a PEM file, as a server does.
    fn read(path: &Path, provider: Arc<CryptoProvider>) -> Result<Self, String> {
        let unusable = |problem: String| format!("cannot use the certificate in {}: {problem}", path.display());
        let certificate = CertificateDer::from_pem_file(path).map_err(|e| unusable(e.to_string()))?;
        Ok(Self { certificate, provider })
    }
}

impl ServerCertVerifier for OwnCertificate {
    fn verify_server_cert(
        &self,
        shown: &CertificateDer<'_>,
        _: &[CertificateDer<'_>],
        _: &ServerName<'_>,
        _: &[u8],
        _: UnixTime,
    ) -> Result<ServerCertVerified, Error> {
        match *shown == self.certificate {
            true => Ok(ServerCertVerified::assertion()),
            false => Err(CertificateError::ApplicationVerificationFailure.into()),
        }
    }

    fn verify_tls12_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let algorithms = &self.provider.signature_verification_algorithms;
        verify_tls12_signature(message, certificate, signed, algorithms)
    }

    fn verify_tls13_signature(
        &self,
        message: &[u8],
        certificate: &CertificateDer<'_>,
        signed: &DigitallySignedStruct,
    ) -> Result<HandshakeSignatureValid, Error> {
        let algorithms = &self.provider.signature_verification_algorithms;
        verify_tls13_signature(message, certificate, signed, algorithms)
    }

    fn supported_verify_schemes(&self) -> Vec<SignatureScheme> {
        self.provider.signature_verification_algorithms.supported_schemes()
    }
}
