//! Where a store is.

use super::ownership::NodeIdentity;
use std::path::PathBuf;

/// Where a store is.
#[derive(Clone, Default, PartialEq, Eq)]
pub struct StoreLocation {
    /// The folder of what has no place of its own; made if it is missing.
    pub data_dir: Option<PathBuf>,
    /// The URL of the database, `postgres://USER:PASSWORD@HOST/DATABASE`; `None`: SQLite in the folder.
    pub database: Option<String>,
    /// The URL of the objects, `s3://BUCKET/PREFIX`; `None`: in the folder.
    pub objects: Option<String>,
    /// Which build and processor makes results; `None`: this one.
    pub build: Option<String>,
    /// Which of several nodes opens it; `None`: one process has it for itself.
    pub node: Option<NodeIdentity>,
}

impl StoreLocation {
    /// Everything in a folder.
    pub fn in_folder(folder: impl Into<PathBuf>) -> Self {
        Self {
            data_dir: Some(folder.into()),
            ..Self::default()
        }
    }

    /// The same, for a node that was to take a free port and got `port`.
    pub fn on_port(&self, port: u16) -> Self {
        let mut there = self.clone();
        if let Some(node) = &mut there.node {
            for told in [&mut node.address, &mut node.name] {
                if let Some(host) = told.strip_suffix(":0") {
                    *told = format!("{host}:{port}");
                }
            }
        }
        there
    }
}

impl std::fmt::Display for StoreLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let folder = self.data_dir.as_ref().map(|d| d.display().to_string());
        // A URL may hold a password.
        let database = self.database.as_ref().map(|_| "PostgreSQL".to_owned());
        let places = [&database, &self.objects, &folder];
        let shown: Vec<&str> = places.into_iter().flatten().map(String::as_str).collect();
        f.write_str(&shown.join(", "))
    }
}

impl std::fmt::Debug for StoreLocation {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        std::fmt::Display::fmt(self, f)
    }
}
