//! Who a client's certificate says it is.

use super::tls_config::CertificateField;
use x509_cert::Certificate;
use x509_cert::der::Decode as _;
use x509_cert::der::asn1::{Any, Utf8StringRef};
use x509_cert::ext::pkix::SubjectAltName;
use x509_cert::ext::pkix::name::GeneralName;

/// Longest name that is a tenant's, bytes.
const LONGEST: usize = 256;

/// The tenant that a certificate names. `None` where it names none, or two: nothing is guessed.
pub(super) fn certificate_tenant(der: &[u8], field: CertificateField) -> Option<String> {
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
    !name.is_empty() && name.len() <= LONGEST && !name.chars().any(char::is_control)
}
