//! The server's configuration: the keys of file, environment and flags, checked once into typed values.
//!
//! Precedence: defaults < file < environment (`PLIANT_` and the key in capitals) < flags. An unknown key of a file is an
//! error; every error names the key, where its value came from, and what is allowed.

mod auth_settings;
mod keys;
mod server_config;
mod settings;
mod sources;

pub use auth_settings::MOST_TOKENS;
pub(super) use auth_settings::tokens_of_file;
pub use keys::{AuthTable, ConfigKeys, KeyValue, QuotaTable, TokenTable};
pub use keys::{ByteSize, TimeSpan, WordList};
pub use server_config::ServerConfig;
pub use settings::{LogFormat, ServeSettings, stored_in};
pub use sources::Error;
pub(super) use sources::{FileKeys, changed_keys, keys_of_file};
