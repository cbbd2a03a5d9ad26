//! Where the keys of the configuration come from: file, environment and flags, the later winning.

use super::Error;
use super::keys::ConfigKeys;
use super::plain_words::unreadable;
use figment::error::Kind;
use figment::providers::{Format as _, Toml};
use figment::value::{Dict, Map, Value};
use figment::{Figment, Metadata, Profile, Provider};
use std::path::Path;

/// The flags of a command line, as texts.
struct FlagProvider<'a>(&'a ConfigKeys);

impl Provider for FlagProvider<'_> {
    fn metadata(&self) -> Metadata {
        Metadata::named(COMMAND_LINE)
    }

    fn data(&self) -> figment::Result<Map<Profile, Dict>> {
        let flags = Value::serialize(self.0)?.into_dict().unwrap_or_default();
        let given = flags
            .into_iter()
            .filter_map(|(key, text)| Some((key.clone(), read_text(&key, text.as_str()?))))
            .collect();
        Ok(Map::from([(Profile::Default, given)]))
    }
}

/// The keys that the environment names, as texts.
struct VariableProvider<'a>(&'a [String]);

impl Provider for VariableProvider<'_> {
    fn metadata(&self) -> Metadata {
        Metadata::named(ENVIRONMENT)
    }

    fn data(&self) -> figment::Result<Map<Profile, Dict>> {
        let given = self.0.iter().filter_map(|key| {
            let text = std::env::var_os(format!("PLIANT_{}", key.to_uppercase()))?;
            Some((key.clone(), read_text(key, &text.to_string_lossy())))
        });
        Ok(Map::from([(Profile::Default, given.collect())]))
    }
}

/// What a text says for a key: a number, a list and so on, or the text itself where the key takes no such thing, so that a
/// folder may be called 007.
fn read_text(key: &str, text: &str) -> Value {
    let parsed = text.parse::<Value>().unwrap_or_else(|never| match never {});
    let takes = |value: &Value| Figment::from((key, value)).extract::<ConfigKeys>().is_ok();
    let itself = Value::from(text);
    match !takes(&parsed) && takes(&itself) {
        true => itself,
        false => parsed,
    }
}

const ENVIRONMENT: &str = "the environment";

const COMMAND_LINE: &str = "the command line";

/// The keys as the last source that names each gives it. It remembers the sources, so that an error can say where a value
/// came from.
pub(super) struct MergedKeys {
    pub keys: ConfigKeys,
    sources: Figment,
}

impl MergedKeys {
    /// Merges file < environment < flags. A file that was named must exist.
    pub fn collect(file: Option<&Path>, flags: &ConfigKeys) -> Result<Self, Error> {
        let mut sources = Figment::new();
        if let Some(path) = file {
            let text = std::fs::read_to_string(path).map_err(|e| Error::File {
                path: path.display().to_string(),
                problem: e.to_string(),
            })?;
            sources = sources.merge(NamedToml {
                toml: Toml::string(&text),
                path: path.display().to_string(),
            });
        }
        let names = ConfigKeys::names();
        let sources = sources.merge(VariableProvider(&names)).merge(FlagProvider(flags));
        let keys = sources.extract().map_err(|error| refuse_unreadable(&sources, &error))?;
        Ok(Self { keys, sources })
    }

    /// The refusal of a key's value, with the source that it came from.
    pub fn refuse(&self, key: &str, problem: String) -> Error {
        // Of what stands in a list, the list is known.
        let listed = key.split('[').next().unwrap_or(key);
        let metadata = self.sources.find_metadata(listed);
        Error::Value {
            key: key.to_owned(),
            place: metadata.map_or_else(|| "the defaults".to_owned(), |m| describe_source(m, key)),
            problem,
        }
    }
}

/// The refusal of a key that does not exist or whose value is of the wrong kind.
fn refuse_unreadable(sources: &Figment, error: &figment::Error) -> Error {
    let key = error.path.join(".");
    let place = match &error.metadata {
        Some(metadata) => describe_source(metadata, &key),
        None => "the configuration".to_owned(),
    };
    match &error.kind {
        Kind::UnknownField(_, allowed) if error.path.len() > 1 => Error::Value {
            key,
            place,
            problem: format!("no such key; allowed are {}", allowed.join(", ")),
        },
        Kind::UnknownField(name, _) => {
            let file = sources
                .metadata()
                .next()
                .map_or_else(|| place.clone(), |m| m.name.to_string());
            Error::Value {
                key: name.clone(),
                place: if error.metadata.is_some() { place } else { file },
                problem: format!(
                    "no such key; allowed are {}, and the tables auth, quotas and tenants",
                    ConfigKeys::names().join(", ")
                ),
            }
        }
        kind => Error::Value {
            problem: unreadable(&key, kind),
            key: if key.is_empty() { "(file)".into() } else { key },
            place,
        },
    }
}

fn describe_source(metadata: &Metadata, key: &str) -> String {
    if metadata.name == ENVIRONMENT {
        return format!("environment variable PLIANT_{}", key.to_uppercase());
    }
    if metadata.name == COMMAND_LINE {
        return format!("flag --{}", key.replace('_', "-"));
    }
    metadata.name.to_string()
}

/// A TOML text that remembers the file it came from.
struct NamedToml {
    toml: figment::providers::Data<Toml>,
    path: String,
}

impl Provider for NamedToml {
    fn metadata(&self) -> Metadata {
        Metadata::named(format!("file {}", self.path))
    }

    fn data(&self) -> figment::Result<Map<Profile, Dict>> {
        self.toml.data()
    }
}

/// Environment variables that look like keys and are none.
pub(super) fn unknown_variables() -> Vec<String> {
    let keys = ConfigKeys::names();
    std::env::vars_os()
        .filter_map(|(name, _)| name.into_string().ok())
        .filter(|name| is_unknown_variable(name, &keys))
        .collect()
}

fn is_unknown_variable(name: &str, keys: &[String]) -> bool {
    // Read by the other commands, the Python package, the build, the tests and the workflows, not by the server.
    const OTHERS: [&str; 8] = [
        "PLIANT_BIN",
        "PLIANT_CONFIG",
        "PLIANT_DATA",
        "PLIANT_REPOSITORY",
        "PLIANT_SERVER",
        "PLIANT_TOKEN",
        "PLIANT_VIEWER",
        "PLIANT_VIEWER_PAGE",
    ];
    let key = name.strip_prefix("PLIANT_").map(str::to_lowercase);
    key.is_some_and(|ref key| !OTHERS.contains(&name) && !keys.contains(key))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_variable_that_nothing_reads_is_unknown() {
        let keys = ConfigKeys::names();
        for known in [
            "PATH",
            "PLIANT_LISTEN",
            "PLIANT_MAX_TTL",
            "PLIANT_BIN",
            "PLIANT_SERVER",
            "PLIANT_TOKEN",
            "PLIANT_VIEWER_PAGE",
        ] {
            assert!(!is_unknown_variable(known, &keys), "{known}");
        }
        for unknown in ["PLIANT_LISTENS", "PLIANT_", "PLIANT_BINS"] {
            assert!(is_unknown_variable(unknown, &keys), "{unknown}");
        }
    }
}
