//! Authorities and certificates for tests, and handshakes with them.

use ::ring::rand::SystemRandom;
use ::ring::rsa::PublicKeyComponents;
use ::ring::signature::{
    ECDSA_P256_SHA256_FIXED_SIGNING, EcdsaKeyPair, Ed25519KeyPair, KeyPair as _, RSA_PKCS1_SHA256, RSA_PSS_SHA256,
    RsaEncoding, RsaKeyPair,
};
use base64::Engine as _;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use pliant::server::{CertificateField, TlsConfig};
use rcgen::{BasicConstraints, CertificateParams, DnType, IsCa, Issuer, KeyPair, SanType, SerialNumber};
use serde_json::{Value, json};
use std::fs;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};
use tokio::net::TcpStream;
use tokio_rustls::TlsConnector;
use tokio_rustls::client::TlsStream;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::PemObject as _;
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer, ServerName};
use tokio_rustls::rustls::{ClientConfig, RootCertStore};

/// An authority that signs certificates.
pub struct Authority {
    issuer: Issuer<'static, KeyPair>,
    pub pem: String,
}

/// A certificate and its key, in PEM.
pub struct Identity {
    pub certificate: String,
    pub key: String,
}

impl Authority {
    pub fn new(name: &str) -> Self {
        let mut params = CertificateParams::new(Vec::new()).expect("no names");
        params.is_ca = IsCa::Ca(BasicConstraints::Unconstrained);
        params.distinguished_name.push(DnType::CommonName, name);
        let key = KeyPair::generate().expect("a key");
        let pem = params.self_signed(&key).expect("a certificate").pem();
        Self {
            issuer: Issuer::new(params, key),
            pem,
        }
    }

    /// A certificate of a server on this machine.
    pub fn server(&self, serial: u64) -> Identity {
        let mut params = CertificateParams::new(["localhost".to_owned(), "127.0.0.1".to_owned()]).expect("names");
        params.serial_number = Some(SerialNumber::from(serial));
        self.sign(&params)
    }

    /// A certificate of a client: its common names, and the URIs among its alternative names.
    pub fn client(&self, names: &[&str], uris: &[&str]) -> Identity {
        let mut params = CertificateParams::new(Vec::new()).expect("no names");
        params.distinguished_name = rcgen::DistinguishedName::new();
        for (k, name) in names.iter().enumerate() {
            // The same attribute by its number, since a second one would replace the first.
            let again = DnType::CustomDnType(vec![2, 5, 4, 3]);
            let field = if k == 0 { DnType::CommonName } else { again };
            params.distinguished_name.push(field, *name);
        }
        for uri in uris {
            params
                .subject_alt_names
                .push(SanType::URI((*uri).try_into().expect("ASCII")));
        }
        self.sign(&params)
    }

    fn sign(&self, params: &CertificateParams) -> Identity {
        let key = KeyPair::generate().expect("a key");
        Identity {
            certificate: params.signed_by(&key, &self.issuer).expect("a certificate").pem(),
            key: key.serialize_pem(),
        }
    }

    /// What a client needs that trusts this authority, and shows `identity`.
    pub fn trusting(&self, identity: Option<&Identity>, protocols: &[&str]) -> Arc<ClientConfig> {
        let mut roots = RootCertStore::empty();
        roots
            .add(CertificateDer::from_pem_slice(self.pem.as_bytes()).expect("PEM"))
            .expect("an authority");
        let builder = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
            .with_safe_default_protocol_versions()
            .expect("versions")
            .with_root_certificates(roots);
        let mut config = match identity {
            None => builder.with_no_client_auth(),
            Some(identity) => {
                let chain = vec![CertificateDer::from_pem_slice(identity.certificate.as_bytes()).expect("PEM")];
                let key = PrivateKeyDer::from_pem_slice(identity.key.as_bytes()).expect("PEM");
                builder.with_client_auth_cert(chain, key).expect("a pair")
            }
        };
        config.alpn_protocols = protocols.iter().map(|name| name.as_bytes().to_vec()).collect();
        Arc::new(config)
    }
}

/// A folder with a server's certificate and key.
pub struct Files {
    folder: tempfile::TempDir,
}

impl Files {
    pub fn new(identity: &Identity) -> Self {
        let files = Self {
            folder: tempfile::tempdir().expect("a folder"),
        };
        files.replace(identity);
        files
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Puts another pair in place, as a program does that renews certificates.
    pub fn replace(&self, identity: &Identity) {
        replace_file(&self.path("server.pem"), &identity.certificate);
        replace_file(&self.path("server.key"), &identity.key);
    }

    /// The server's keys of TLS; with an authority, clients may show its certificates.
    pub fn tls(&self, authority: Option<&Authority>, field: CertificateField) -> TlsConfig {
        let client_ca = authority.map(|authority| {
            let path = self.path("clients.pem");
            replace_file(&path, &authority.pem);
            path
        });
        TlsConfig {
            certificate: self.path("server.pem"),
            key: self.path("server.key"),
            client_ca,
            client_tenant: field,
        }
    }
}

/// Writes beside, then renames.
pub fn replace_file(path: &Path, text: &str) {
    let beside = path.with_extension("new");
    fs::write(&beside, text).expect("written");
    fs::rename(beside, path).expect("renamed");
}

/// A connection with TLS to a server on this machine.
pub async fn shake_hands(address: SocketAddr, config: Arc<ClientConfig>) -> std::io::Result<TlsStream<TcpStream>> {
    let socket = TcpStream::connect(address).await?;
    let name = ServerName::try_from("localhost").expect("a name");
    TlsConnector::from(config).connect(name, socket).await
}

/// One call over HTTP/1.1 by such a connection: status and body.
pub async fn ask(
    address: SocketAddr,
    config: Arc<ClientConfig>,
    path: &str,
    token: Option<&str>,
) -> std::io::Result<(u16, String)> {
    use http_body_util::{BodyExt as _, Empty};
    let stream = shake_hands(address, config).await?;
    let io = hyper_util::rt::TokioIo::new(stream);
    let (mut send, connection) = hyper::client::conn::http1::handshake(io)
        .await
        .map_err(std::io::Error::other)?;
    tokio::spawn(connection);
    let mut request = http::Request::get(path).header("host", "localhost");
    if let Some(token) = token {
        request = request.header("authorization", format!("Bearer {token}"));
    }
    let request = request.body(Empty::<bytes::Bytes>::new()).expect("a request");
    let answer = send.send_request(request).await.map_err(std::io::Error::other)?;
    let status = answer.status().as_u16();
    let body = answer
        .into_body()
        .collect()
        .await
        .map_err(std::io::Error::other)?
        .to_bytes();
    Ok((status, String::from_utf8_lossy(&body).into_owned()))
}

/// Who signs tokens, under the name of its key.
pub struct Signer {
    pub id: &'static str,
    key: Key,
}

enum Key {
    Ed(Ed25519KeyPair),
    Ec(EcdsaKeyPair),
    Rsa(RsaKeyPair),
}

fn encoded(bytes: impl AsRef<[u8]>) -> String {
    URL_SAFE_NO_PAD.encode(bytes)
}

impl Signer {
    pub fn ed25519(id: &'static str) -> Self {
        let bytes = Ed25519KeyPair::generate_pkcs8(&SystemRandom::new()).expect("a key");
        let key = Key::Ed(Ed25519KeyPair::from_pkcs8(bytes.as_ref()).expect("a key"));
        Self { id, key }
    }

    pub fn p256(id: &'static str) -> Self {
        let random = SystemRandom::new();
        let bytes = EcdsaKeyPair::generate_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, &random).expect("a key");
        let key = EcdsaKeyPair::from_pkcs8(&ECDSA_P256_SHA256_FIXED_SIGNING, bytes.as_ref(), &random).expect("a key");
        Self { id, key: Key::Ec(key) }
    }

    /// The same key always: making one takes a while.
    pub fn rsa(id: &'static str) -> Self {
        let pem = include_bytes!("../service/security/signing-key.pem");
        let key = PrivateKeyDer::from_pem_slice(pem).expect("PEM");
        let key = RsaKeyPair::from_pkcs8(key.secret_der()).expect("a key");
        Self { id, key: Key::Rsa(key) }
    }

    /// The public key as it is published.
    pub fn published(&self) -> Value {
        match &self.key {
            Key::Ed(key) => json!({"kty": "OKP", "crv": "Ed25519", "kid": self.id, "x": encoded(key.public_key())}),
            Key::Ec(key) => {
                let point = &key.public_key().as_ref()[1..];
                let (x, y) = point.split_at(32);
                json!({"kty": "EC", "crv": "P-256", "kid": self.id, "x": encoded(x), "y": encoded(y)})
            }
            Key::Rsa(key) => {
                let public: PublicKeyComponents<Vec<u8>> = key.public().into();
                json!({"kty": "RSA", "kid": self.id, "use": "sig", "n": encoded(public.n), "e": encoded(public.e)})
            }
        }
    }

    /// A token with these claims, signed by an algorithm of this key.
    pub fn token(&self, algorithm: &str, claims: &Value) -> String {
        self.signed(&json!({"alg": algorithm, "typ": "JWT", "kid": self.id}), claims)
    }

    /// A token with this header.
    pub fn signed(&self, header: &Value, claims: &Value) -> String {
        let message = format!("{}.{}", encoded(header.to_string()), encoded(claims.to_string()));
        let random = SystemRandom::new();
        let signature = match &self.key {
            Key::Ed(key) => key.sign(message.as_bytes()).as_ref().to_vec(),
            Key::Ec(key) => key.sign(&random, message.as_bytes()).expect("signed").as_ref().to_vec(),
            Key::Rsa(key) => {
                let padding: &dyn RsaEncoding = match header["alg"].as_str() {
                    Some("PS256") => &RSA_PSS_SHA256,
                    _ => &RSA_PKCS1_SHA256,
                };
                let mut signature = vec![0; key.public().modulus_len()];
                key.sign(padding, &random, message.as_bytes(), &mut signature)
                    .expect("signed");
                signature
            }
        };
        format!("{message}.{}", encoded(signature))
    }
}

/// A token signed with a secret, or not at all where there is none.
pub fn token_without_key(header: &Value, claims: &Value, secret: Option<&[u8]>) -> String {
    let message = format!("{}.{}", encoded(header.to_string()), encoded(claims.to_string()));
    let signature = secret.map(|secret| {
        let key = ::ring::hmac::Key::new(::ring::hmac::HMAC_SHA256, secret);
        encoded(::ring::hmac::sign(&key, message.as_bytes()))
    });
    format!("{message}.{}", signature.unwrap_or_default())
}

/// The set that publishes these keys.
pub fn key_set(signers: &[&Signer]) -> String {
    let keys: Vec<Value> = signers.iter().map(|signer| signer.published()).collect();
    json!({"keys": keys}).to_string()
}

/// Seconds since 1970, and some more.
pub fn in_seconds(more: i64) -> i64 {
    let now = SystemTime::now().duration_since(UNIX_EPOCH).expect("after 1970");
    i64::try_from(now.as_secs()).expect("soon") + more
}
