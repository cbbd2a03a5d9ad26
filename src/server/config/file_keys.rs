//! The keys of a configuration file beside the tokens. The server follows the tokens while it runs; other keys count
//! from its next start on.

use figment::Figment;
use figment::providers::{Format as _, Toml};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// The keys of a file with their values; those of `auth` are flattened, without the tokens.
pub(in crate::server) type FileKeys = BTreeMap<String, Value>;

/// Reads them; `None` where the file cannot be read, which `tokens_of_file` reports.
pub(in crate::server) fn keys_of_file(file: &Path) -> Option<FileKeys> {
    let text = std::fs::read_to_string(file).ok()?;
    let mut keys: FileKeys = Figment::from(Toml::string(&text)).extract().ok()?;
    if let Some(Value::Object(auth)) = keys.remove("auth") {
        let fixed = auth.into_iter().filter(|(name, _)| name != "tokens");
        keys.extend(fixed.map(|(name, value)| (format!("auth.{name}"), value)));
    }
    Some(keys)
}

/// The names of the keys that differ. Values may be secrets.
pub(in crate::server) fn changed_keys(before: &FileKeys, now: &FileKeys) -> Vec<String> {
    let mut names: Vec<&String> = before.keys().chain(now.keys()).collect();
    names.sort_unstable();
    names.dedup();
    names.retain(|name| before.get(*name) != now.get(*name));
    names.into_iter().cloned().collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn keys(text: &str) -> FileKeys {
        let mut file = tempfile::NamedTempFile::new().expect("a file");
        file.write_all(text.as_bytes()).expect("written");
        keys_of_file(file.path()).expect("read")
    }

    #[test]
    fn what_a_server_follows_by_itself_is_no_change() {
        let before = keys("sessions = 3\nttl = \"1m\"\n[[auth.tokens]]\ntenant = \"a\"\n[auth.jwt]\nissuer = \"x\"\n");
        let same = keys("# words\nttl = \"1m\"\nsessions = 3\n[auth.jwt]\nissuer = \"x\"\n");
        assert_eq!(changed_keys(&before, &same), Vec::<String>::new());
        let other = keys("sessions = 4\nhistory = 2\n[auth.jwt]\nissuer = \"y\"\n");
        assert_eq!(
            changed_keys(&before, &other),
            ["auth.jwt", "history", "sessions", "ttl"]
        );
    }
}
