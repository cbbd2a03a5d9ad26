//! The sources of the configuration's keys: file, environment and flags, the later winning; and what is wrong with them, in the words
//! of those who write one.

use super::keys::ConfigKeys;
use figment::error::{Actual, Kind, OneOf};
use figment::providers::{Format as _, Toml};
use figment::value::{Dict, Map, Value};
use figment::{Figment, Metadata, Profile, Provider};
use std::collections::BTreeMap;
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

/// Why a server does not run: its configuration cannot be used, or its services cannot be set up.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// The services could not be set up.
    #[error("the services cannot start: {0}")]
    Start(String),
    /// The file cannot be read.
    #[error("cannot read configuration file {path}: {problem}")]
    File {
        /// As given.
        path: String,
        /// What the operating system said.
        problem: String,
    },
    /// An environment variable is called as keys are, and there is no such key.
    #[error("environment variable {name} is not a key of the configuration; {hint}")]
    Variable {
        /// Its name.
        name: String,
        /// What may have been meant.
        hint: String,
    },
    /// A key has a value that is not allowed, or does not exist.
    #[error("{key}: {problem} ({place})")]
    Value {
        /// The key.
        key: String,
        /// Where the value came from.
        place: String,
        /// What was seen and what is allowed.
        problem: String,
    },
}

/// The default port of a server.
const PORT: u16 = 7411;

/// Why a value cannot be read.
pub(super) fn unreadable(key: &str, kind: &Kind) -> String {
    match kind {
        Kind::InvalidType(Actual::Unsigned(port), _) if key == "listen" => no_address(&port.to_string()),
        Kind::InvalidType(Actual::Signed(port), _) if key == "listen" => no_address(&port.to_string()),
        Kind::InvalidType(seen, wanted) | Kind::InvalidValue(seen, wanted) => {
            format!("is {}, {} is allowed", seen_value(seen), wanted_value(wanted))
        }
        Kind::UnknownVariant(seen, allowed) => format!("is \"{seen}\", {} is allowed", OneOf(allowed)),
        Kind::MissingField(name) => format!("{name} is missing"),
        Kind::Message(text) => toml_problem(text).unwrap_or_else(|| text.clone()),
        other => other.to_string(),
    }
}

/// Reports an invalid listen address, and which one it may have meant.
pub(super) fn no_address(text: &str) -> String {
    let meant = meant_address(text).unwrap_or_else(|| format!("127.0.0.1:{PORT} or [::]:{PORT}"));
    format!("{text} is not an address; write an IP address and a port: {meant}")
}

fn meant_address(text: &str) -> Option<String> {
    let text = text.trim();
    if let Ok(address) = text.parse::<std::net::IpAddr>() {
        return Some(std::net::SocketAddr::new(address, PORT).to_string());
    }
    let (host, port) = text.rsplit_once(':').unwrap_or(match text.parse::<u16>() {
        Ok(_) => ("", text),
        Err(_) => (text, ""),
    });
    let port = if port.is_empty() { PORT } else { port.parse().ok()? };
    match host {
        "" | "localhost" => Some(format!("127.0.0.1:{port}")),
        "*" => Some(format!("0.0.0.0:{port}")),
        _ => None,
    }
}

fn seen_value(seen: &Actual) -> String {
    match seen {
        Actual::Bool(value) => value.to_string(),
        Actual::Unsigned(value) => value.to_string(),
        Actual::Signed(value) => value.to_string(),
        Actual::Float(value) => value.to_string(),
        Actual::Str(text) => format!("\"{text}\""),
        Actual::Seq => "a list".into(),
        Actual::Map => "a table".into(),
        other => other.to_string(),
    }
}

fn wanted_value(wanted: &str) -> String {
    match wanted {
        "u8" | "u16" | "u32" | "u64" | "usize" => "a whole number from 0".into(),
        "f32" | "f64" => "a number".into(),
        "a boolean" => "true or false".into(),
        "a string" => "a text in quotes".into(),
        "a sequence" => "a list".into(),
        "a map" => "a table".into(),
        wanted => wanted.strip_prefix("struct ").map_or(wanted, |_| "a table").to_owned(),
    }
}

/// What the reader of TOML says over several lines, with a picture of the place, in one.
fn toml_problem(text: &str) -> Option<String> {
    let mut lines = text.lines();
    let place = lines.next()?.strip_prefix("TOML parse error at ")?;
    let is_picture = |line: &&str| {
        line.trim_start_matches(|c: char| c.is_ascii_digit() || c == ' ')
            .starts_with('|')
    };
    let problem: Vec<&str> = lines.skip_while(is_picture).map(str::trim).collect();
    Some(format!("{place}: {}", problem.join(", ")))
}

/// The keys of a file with their values; those of `auth` are flattened, without the tokens.
pub(crate) type FileKeys = BTreeMap<String, serde_json::Value>;

/// Reads them; `None` where the file cannot be read, which `tokens_of_file` reports.
pub(crate) fn keys_of_file(file: &Path) -> Option<FileKeys> {
    let text = std::fs::read_to_string(file).ok()?;
    let mut keys: FileKeys = Figment::from(Toml::string(&text)).extract().ok()?;
    if let Some(serde_json::Value::Object(auth)) = keys.remove("auth") {
        let fixed = auth.into_iter().filter(|(name, _)| name != "tokens");
        keys.extend(fixed.map(|(name, value)| (format!("auth.{name}"), value)));
    }
    Some(keys)
}

/// The names of the keys that differ. Values may be secrets.
pub(crate) fn changed_keys(before: &FileKeys, now: &FileKeys) -> Vec<String> {
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

    #[test]
    fn what_may_have_been_meant_is_reported() {
        for (text, meant) in [
            ("7412", "port: 127.0.0.1:7412"),
            (":7412", "port: 127.0.0.1:7412"),
            ("localhost", "port: 127.0.0.1:7411"),
            ("localhost:80", "port: 127.0.0.1:80"),
            ("*:80", "port: 0.0.0.0:80"),
            ("10.0.0.7", "port: 10.0.0.7:7411"),
            ("::1", "port: [::1]:7411"),
            ("mesh.example.org:80", "127.0.0.1:7411 or [::]:7411"),
            ("99999", "127.0.0.1:7411 or [::]:7411"),
            ("", "127.0.0.1:7411"),
        ] {
            let problem = no_address(text);
            assert!(
                problem.starts_with(&format!("{text} is not an address")) && problem.contains(meant),
                "{problem}"
            );
        }
    }

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
