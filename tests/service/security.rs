//! Who may do what, from outside: tokens, certificates, and what a server refuses to be started as.

mod audit;
mod isolation;
mod jwt;
mod quotas;
mod start;
mod tokens;

use crate::support::program::ServedProgram;
use crate::support::server::*;
use pliant::server::auth::{AuthConfig, TokenEntry, token_digest};
use pliant::session::Tenant;
use std::path::Path;
use std::time::{Duration, SystemTime};

/// A file with some tables of the configuration; its path.
fn config_file(folder: &Path, tables: &str) -> String {
    let path = folder.join("pliant.toml");
    std::fs::write(&path, tables).expect("writable");
    path.to_string_lossy().into_owned()
}

/// A folder for sessions, and a configuration beside it.
struct ConfiguredPlace {
    folder: tempfile::TempDir,
    config: String,
}

impl ConfiguredPlace {
    fn new(tables: &str) -> Self {
        let folder = tempfile::tempdir().expect("a folder");
        let config = config_file(folder.path(), tables);
        Self { folder, config }
    }

    fn start(&self) -> ServedProgram {
        ServedProgram::start(&self.folder.path().join("data"), &["--config", &self.config])
    }
}

/// A token as such a file has it.
fn token_table(tenant: &str, token: &str, name: &str) -> String {
    let sha256: String = token_digest(token).iter().map(|byte| format!("{byte:02x}")).collect();
    format!("[[auth.tokens]]\ntenant = \"{tenant}\"\nname = \"{name}\"\nsha256 = \"{sha256}\"\n")
}

/// A token of a tenant that does not expire.
fn entry(tenant: &str, token: &str) -> TokenEntry {
    TokenEntry {
        tenant: Tenant(tenant.into()),
        sha256: token_digest(token),
        name: format!("{tenant}'s"),
        expires: None,
        metrics: false,
    }
}

/// A server that knows the token `a` of tenant `a`, `b` of `b`, `watcher`, who may read the counts, and one that has expired.
async fn guarded() -> Server {
    let past = SystemTime::now() - Duration::from_secs(1);
    let tokens = vec![
        entry("a", "a"),
        entry("b", "b"),
        TokenEntry {
            metrics: true,
            ..entry("watch", "watcher")
        },
        TokenEntry {
            expires: Some(past),
            ..entry("a", "expired")
        },
    ];
    Server::with(|_, config| {
        config.auth = AuthConfig {
            tokens,
            ..AuthConfig::default()
        };
    })
    .await
}
