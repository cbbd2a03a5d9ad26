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
        refuse_unknown_variables(&names)?;
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
        Kind::UnknownField(name, allowed) if error.path.len() > 1 => Error::Value {
            key,
            place,
            problem: match nearest_name(name, allowed) {
                Some(near) => format!("no such key; did you mean {near}?"),
                None => format!("no such key; allowed are {}", allowed.join(", ")),
            },
        },
        Kind::UnknownField(name, allowed) => {
            let file = sources
                .metadata()
                .next()
                .map_or_else(|| place.clone(), |m| m.name.to_string());
            Error::Value {
                key: name.clone(),
                place: if error.metadata.is_some() { place } else { file },
                problem: match nearest_name(name, allowed) {
                    Some(near) => format!("no such key; did you mean {near}?"),
                    None => format!(
                        "no such key; allowed are {}, and the tables auth, quotas and tenants",
                        ConfigKeys::names().join(", ")
                    ),
                },
            }
        }
        kind => Error::Value {
            problem: unreadable(&key, kind),
            key: if key.is_empty() { "(file)".into() } else { key },
            place,
        },
    }
}

/// The name that is most like a wrong one, if one is like it.
fn nearest_name<'a>(wrong: &str, names: &[&'a str]) -> Option<&'a str> {
    /// As like as clap wants names of flags to be.
    const LIKE: f64 = 0.8;
    let likeness = names.iter().map(|name| (strsim::jaro_winkler(wrong, name), *name));
    let nearest = likeness.max_by(|a, b| a.0.total_cmp(&b.0))?;
    (nearest.0 > LIKE).then_some(nearest.1)
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

/// Refuses environment variables that are called as keys are and which nothing reads: a slip in a name would leave a default in force
/// without a word.
fn refuse_unknown_variables(keys: &[String]) -> Result<(), Error> {
    let mut variables: Vec<(String, String)> = std::env::vars_os()
        .filter_map(|(name, value)| Some((name.into_string().ok()?, value.to_string_lossy().into_owned())))
        .collect();
    variables.sort_unstable();
    let unknown = variables
        .iter()
        .find(|(name, value)| is_unknown_variable(name, value, keys));
    let Some((name, _)) = unknown else { return Ok(()) };
    // What all of them begin with would make any two alike.
    let bare = |name: &'static str| name.trim_start_matches("PLIANT_").to_lowercase();
    let known: Vec<String> = keys.iter().cloned().chain(OTHERS.map(bare)).collect();
    let known: Vec<&str> = known.iter().map(String::as_str).collect();
    let seen = name.trim_start_matches("PLIANT_").to_lowercase();
    Err(Error::Variable {
        name: name.clone(),
        hint: match nearest_name(&seen, &known) {
            Some(near) => format!("did you mean PLIANT_{}?", near.to_uppercase()),
            None => "`pliant serve --help` lists the keys; each is a variable with PLIANT_ before its name in capitals"
                .into(),
        },
    })
}

/// Variables that are read by other commands, the clients, the build, the tests and the workflows, not by the server.
const OTHERS: [&str; 16] = [
    "PLIANT_BIN",
    "PLIANT_CONFIG",
    "PLIANT_COUNTS_OF",
    "PLIANT_CRASHES",
    "PLIANT_DATA",
    "PLIANT_FAULTS",
    "PLIANT_LONG",
    "PLIANT_RELEASE",
    "PLIANT_REPOSITORY",
    "PLIANT_SERVER",
    "PLIANT_TEST_ALONE",
    "PLIANT_TOKEN",
    "PLIANT_VERSION",
    "PLIANT_VIEWER",
    "PLIANT_VIEWER_OUT",
    "PLIANT_VIEWER_PAGE",
];

fn is_unknown_variable(name: &str, value: &str, keys: &[String]) -> bool {
    let Some(key) = name.strip_prefix("PLIANT_").map(str::to_lowercase) else {
        return false;
    };
    !OTHERS.contains(&name) && !keys.contains(&key) && !is_service_link(name, value)
}

/// Whether a variable is a service address that Kubernetes or Docker sets in every container, here of a service whose
/// name begins with `pliant`.
fn is_service_link(name: &str, value: &str) -> bool {
    let is_address = ["tcp://", "udp://", "sctp://"]
        .iter()
        .any(|scheme| value.starts_with(scheme));
    let names_protocol = ["_TCP", "_UDP", "_SCTP"].iter().any(|protocol| name.contains(protocol));
    name.ends_with("_SERVICE_HOST")
        || name.contains("_SERVICE_PORT")
        || name.contains("_PORT") && (is_address || names_protocol)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_variable_that_nothing_reads_is_unknown() {
        let keys = ConfigKeys::names();
        for (known, value) in [
            ("PATH", "/bin"),
            ("PLIANT_LISTEN", ""),
            ("PLIANT_MAX_TTL", ""),
            ("PLIANT_BIN", ""),
            ("PLIANT_SERVER", ""),
            ("PLIANT_TOKEN", ""),
            ("PLIANT_VIEWER_PAGE", ""),
            ("PLIANT_SERVICE_HOST", "10.0.0.1"),
            ("PLIANT_NODES_SERVICE_PORT_HTTP", "7411"),
            ("PLIANT_PORT", "tcp://10.0.0.1:7411"),
            ("PLIANT_PORT_7411_TCP_ADDR", "10.0.0.1"),
        ] {
            assert!(!is_unknown_variable(known, value, &keys), "{known}");
        }
        for unknown in [
            "PLIANT_LISTENS",
            "PLIANT_",
            "PLIANT_BINS",
            "PLIANT_PORT",
            "PLIANT_MEMRY_BYTES",
        ] {
            assert!(is_unknown_variable(unknown, "7411", &keys), "{unknown}");
        }
    }

    #[test]
    fn a_slip_has_a_nearest_name_and_another_word_has_none() {
        let names = ["listen", "sessions", "memory_bytes", "ttl"];
        assert_eq!(nearest_name("listn", &names), Some("listen"));
        assert_eq!(nearest_name("memory_byte", &names), Some("memory_bytes"));
        assert_eq!(nearest_name("zebra", &names), None);
    }
}
