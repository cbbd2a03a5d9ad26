//! `pliant health`: whether a server takes new sessions, for those who watch it where there is no other program to ask.

use super::terminal::{CliFailure, block_on};
use crate::server::config::{ConfigKeys, ServeSettings};
use crate::server::tls::{https_connector, own_connector};
use bytes::Bytes;
use clap::Args;
use http::{StatusCode, Uri};
use http_body_util::{BodyExt as _, Empty, Limited};
use hyper_rustls::HttpsConnector;
use hyper_util::client::legacy::Client;
use hyper_util::client::legacy::connect::HttpConnector;
use hyper_util::rt::TokioExecutor;
use std::io::Write as _;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::path::PathBuf;
use std::time::Duration;

type Connector = HttpsConnector<HttpConnector>;

/// How long an answer may take; what watches containers gives up after 30 s.
const PATIENCE: Duration = Duration::from_secs(5);
/// Longest answer that is read, in bytes.
const LONGEST: usize = 64 << 10;

/// Asks a server whether it takes new sessions: exit code 0 if it does, 1 if it does not or does not answer.
///
/// Without a URL it asks the server that `pliant serve` would be with the same configuration and environment, on this machine.
#[derive(Debug, Args)]
pub struct HealthArgs {
    /// URL of the server, such as https://pliant.example.com [default: the address in the configuration]
    url: Option<String>,
    /// Configuration file of the server (TOML)
    #[arg(long, value_name = "FILE", env = "PLIANT_CONFIG")]
    config: Option<PathBuf>,
    /// Check only that the process runs, not that it takes new sessions
    #[arg(long)]
    live: bool,
    /// CA certificates (PEM) to trust instead of the system's
    #[arg(long, value_name = "FILE")]
    ca: Option<PathBuf>,
}

pub(super) fn run_health(args: &HealthArgs) -> Result<(), CliFailure> {
    let (base, connector) = match &args.url {
        Some(url) => (
            url.trim_end_matches('/').to_owned(),
            https_connector(args.ca.as_deref()),
        ),
        None => own_address(args)?,
    };
    let asked = format!("{base}{}", if args.live { "/healthz" } else { "/readyz" });
    let uri = (asked.parse::<Uri>().ok())
        .filter(|uri| matches!(uri.scheme_str(), Some("http" | "https")) && uri.host().is_some_and(|h| !h.is_empty()))
        .ok_or_else(|| {
            CliFailure::Input(format!(
                "\"{base}\" is not the URL of a server, such as http://127.0.0.1:7411"
            ))
        })?;
    let connector = connector.map_err(CliFailure::Input)?;
    let client = Client::builder(TokioExecutor::new()).build::<_, Empty<Bytes>>(connector);
    let answered = block_on(async {
        let answer = async {
            let response = client.get(uri).await.map_err(|e| {
                let mut cause = std::error::Error::source(&e).map_or_else(String::new, |cause| format!(": {cause}"));
                if cause.contains("CaUsedAsEndEntity") {
                    cause += "; the server shows the certificate of an authority, and needs one of its own, which \
                              `openssl req -x509 -addext basicConstraints=critical,CA:FALSE …` makes (security.md)";
                }
                format!("does not answer{cause}")
            })?;
            let status = response.status();
            let body = Limited::new(response.into_body(), LONGEST).collect().await;
            Ok((
                status,
                body.map(http_body_util::Collected::to_bytes).unwrap_or_default(),
            ))
        };
        let late = format!("does not answer within {} s", PATIENCE.as_secs());
        tokio::time::timeout(PATIENCE, answer).await.unwrap_or(Err(late))
    })?;
    match answered {
        Ok((StatusCode::OK, body)) => {
            let mut out = std::io::stdout();
            let _ = writeln!(out, "{}", String::from_utf8_lossy(&body).trim());
            Ok(())
        }
        Ok((status, body)) => {
            let said: String = String::from_utf8_lossy(&body).chars().take(200).collect();
            Err(CliFailure::Check(format!(
                "{base} answers {}: {}",
                status.as_u16(),
                said.trim()
            )))
        }
        Err(problem) => Err(CliFailure::Check(format!("{base} {problem}"))),
    }
}

/// Where a server of this machine listens, as its configuration says, and how it is connected to.
fn own_address(args: &HealthArgs) -> Result<(String, Result<Connector, String>), CliFailure> {
    let reported = |e: crate::server::config::Error| CliFailure::Input(format!("configuration: {e}"));
    let settings = ServeSettings::load(args.config.as_deref(), &ConfigKeys::default()).map_err(reported)?;
    let mut address = settings.listen;
    match address.ip() {
        IpAddr::V4(ip) if ip.is_unspecified() => address.set_ip(Ipv4Addr::LOCALHOST.into()),
        IpAddr::V6(ip) if ip.is_unspecified() => address.set_ip(Ipv6Addr::LOCALHOST.into()),
        _ => {}
    }
    Ok(match &settings.server.tls {
        // Its certificate is for the name that others call it by; here it is known by the file.
        Some(tls) => (format!("https://{address}"), own_connector(&tls.certificate)),
        None => (format!("http://{address}"), https_connector(args.ca.as_deref())),
    })
}
