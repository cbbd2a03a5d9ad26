//! The server's configuration: the keys of file, environment and flags, checked once into typed values.
//!
//! Precedence: defaults < file < environment (`PLIANT_` and the key in capitals) < flags. An unknown key of a file is an
//! error; every error names the key, where its value came from, and what is allowed.

mod auth_settings;
mod auth_table;
mod error;
mod file_keys;
mod keys;
mod node_keys;
mod plain_words;
mod quota_table;
mod server_config;
mod session_config;
mod settings;
mod sources;
mod tls_keys;
mod units;

pub use auth_settings::MOST_TOKENS;
pub(super) use auth_settings::tokens_of_file;
pub use auth_table::{AuthTable, TokenTable};
pub use error::Error;
pub(super) use file_keys::{FileKeys, changed_keys, keys_of_file};
pub use keys::{ConfigKeys, KeyValue};
pub use quota_table::QuotaTable;
pub use server_config::ServerConfig;
pub use settings::{LogFormat, ServeSettings, stored_in};
pub use units::{ByteSize, TimeSpan, WordList};
