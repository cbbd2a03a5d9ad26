//! The compose files and the Helm chart of `deploy`: they fit the schemas of those who read them, Helm itself renders the chart, and what
//! they set starts the real server. What cannot be fetched or is not installed here is said and skipped.

use crate::cluster::{bytes, fits_kubernetes};
use crate::support::certificates::{Authority, Files};
use crate::support::postgres::PostgresServer;
use crate::support::process::needed;
use crate::support::process::{file_of_repository, root, said};
use crate::support::program::{ServedProgram, new_token};
use crate::workflows::{fits_schema, program_of_package, schema_checker};
use serde_json::{Value, json};
use std::fs;
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Helm's own engine, as a library for Python, and a reader of YAML (PyPI).
const PACKAGES: [&str; 2] = ["helm-python-sdk==0.2.2", "PyYAML==6.0.4"];

const COMPOSE: [&str; 3] = ["compose.yaml", "compose.tls.yaml", "compose.postgres.yaml"];

const CHART: &str = "deploy/helm/pliant";

/// The Python that has these packages.
fn reader() -> Option<PathBuf> {
    program_of_package("container-files", &PACKAGES, "python")
}

/// What `deployed.py` says of files.
fn asked(reader: &Path, words: &[&str]) -> Value {
    let mut command = Command::new(reader);
    command.arg(root().join("tests/clients/deployed.py")).args(words);
    let done = command.current_dir(root()).output().expect("python runs");
    assert!(done.status.success(), "{words:?}: {}", said(&done));
    serde_json::from_slice(&done.stdout).unwrap_or_else(|e| panic!("{words:?}: {e}"))
}

/// Puts a later compose file over an earlier one: tables are joined, lists go on, what else is there is replaced.
fn lay_over(lower: &mut Value, upper: &Value) {
    match (lower, upper) {
        (Value::Object(lower), Value::Object(upper)) => {
            for (key, value) in upper {
                lay_over(lower.entry(key).or_insert(Value::Null), value);
            }
        }
        (Value::Array(lower), Value::Array(upper)) => lower.extend(upper.iter().cloned()),
        (lower, upper) => *lower = upper.clone(),
    }
}

fn composed(reader: &Path, files: &[&str]) -> Value {
    let mut whole = Value::Null;
    for name in files {
        lay_over(&mut whole, &asked(reader, &["yaml", &format!("deploy/{name}")])[0]);
    }
    whole
}

#[test]
fn compose_files_fit_the_schema() {
    let checker = needed!(schema_checker());
    let schema = ["--builtin-schema", "vendor.compose-spec"];
    let fits = |file: &Path| fits_schema(&checker, &schema, file);
    for name in COMPOSE {
        fits(&root().join("deploy").join(name)).unwrap_or_else(|problem| panic!("{name}: {problem}"));
    }
    let folder = tempfile::tempdir().expect("a folder");
    let broken = folder.path().join("broken.yaml");
    for (right, wrong) in [("volumes:", "volume:"), ("read_only: true", "read_only: [1]")] {
        let text = file_of_repository("deploy/compose.yaml");
        assert!(text.contains(right), "{right}");
        fs::write(&broken, text.replace(right, wrong)).expect("written");
        assert!(fits(&broken).is_err(), "{wrong} is found");
    }
    let reader = needed!(reader());
    let whole = folder.path().join("whole.yaml");
    let all = composed(&reader, &COMPOSE);
    fs::write(&whole, all.to_string()).expect("written");
    fits(&whole).unwrap_or_else(|problem| panic!("all together: {problem}"));
}

/// The variables that a compose file gives the server, with places of this machine for those of the container.
fn variables(whole: &Value, places: &[(&str, &str)]) -> Vec<(String, String)> {
    let given = whole["services"]["pliant"]["environment"]
        .as_object()
        .expect("variables");
    let here = |value: &Value| {
        let value = value.as_str().expect("a text").to_owned();
        places
            .iter()
            .fold(value, |value, (there, here)| value.replace(there, here))
    };
    given.iter().map(|(name, value)| (name.clone(), here(value))).collect()
}

/// Opens a session, starts the server again, and finds it there.
async fn check_that_sessions_stay(start: impl Fn() -> Result<ServedProgram, String>, token: &str) {
    let mut server = start().expect("it starts");
    let opened = server.post("/v1/sessions?sample=creature").bearer_auth(token);
    assert_eq!(opened.send().await.expect("an answer").status().as_u16(), 201);
    server.stop().await;
    server = start().expect("it starts again");
    let listed = server.get("/v1/sessions").bearer_auth(token).send().await;
    let listed: Value = listed.expect("an answer").json().await.expect("JSON");
    assert_eq!(listed["sessions"].as_array().map(Vec::len), Some(1), "{listed}");
}

/// Starts the server as the container would; the log where it does not come up. The image's healthcheck is asked as well.
fn start(whole: &Value, config: &Path, places: &[(&str, &str)]) -> Result<ServedProgram, String> {
    let port = TcpListener::bind("127.0.0.1:0").and_then(|free| free.local_addr());
    let listen = format!("0.0.0.0:{}", port.expect("a free port").port());
    let places = [places, &[("0.0.0.0:7411", &listen)]].concat();
    let given = variables(whole, &places);
    let given: Vec<(&str, &str)> = given
        .iter()
        .map(|(name, value)| (name.as_str(), value.as_str()))
        .collect();
    let config = config.to_str().expect("UTF-8");
    let log = Path::new(config).with_extension("log");
    let server = ServedProgram::start_anywhere(log, &["--config", config, "--listen", &listen], &given)?;
    let mut health = Command::new(env!("CARGO_BIN_EXE_pliant"));
    health.args(["health", "--config", config]).envs(given);
    let healthy = health.output().expect("it runs");
    assert!(healthy.status.success(), "{}\n{}", said(&healthy), server.log());
    Ok(server)
}

fn seconds(time: &str) -> u64 {
    time.trim_end_matches('s')
        .parse()
        .unwrap_or_else(|e| panic!("{time}: {e}"))
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn what_compose_sets_starts_the_server_and_its_sessions_stay() {
    let reader = needed!(reader());
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("pliant.toml");
    let data = folder.path().join("data");
    let whole = composed(&reader, &COMPOSE[..1]);
    let service = &whole["services"]["pliant"];
    let places = [("/var/lib/pliant", data.to_str().expect("UTF-8"))];

    fs::write(&config, "").expect("written");
    let refused = start(&whole, &config, &places).err().expect("the file names no caller");
    assert!(refused.contains("pliant token"), "{refused}");

    let (token, lines) = new_token();
    fs::write(&config, lines).expect("written");
    check_that_sessions_stay(|| start(&whole, &config, &places), &token).await;

    let set = variables(&whole, &[]);
    let set = |key: &str| &set.iter().find(|(name, _)| name == key).expect(key).1;
    let text = |key: &str| service[key].as_str().unwrap_or_else(|| panic!("{key}"));
    assert!(bytes(set("PLIANT_MEMORY_BYTES")) < bytes(text("mem_limit")));
    assert!(seconds(set("PLIANT_DRAIN_DEADLINE")) + 5 <= seconds(text("stop_grace_period")));
    // The image has these places, and is for this user.
    let image = file_of_repository("deploy/Dockerfile.release");
    for (place, line) in [
        (&service["configs"][0]["target"], "\"serve\", \"--config\", "),
        (&json!(set("PLIANT_DATA_DIR")), "sessions "),
    ] {
        let named = format!("{line}{place}").replace("sessions \"", "sessions ");
        assert!(image.contains(named.trim_end_matches('"')), "{named}");
    }
    let volume = service["volumes"][0].as_str().expect("a volume");
    assert_eq!(volume.split_once(':').expect("a place").1, set("PLIANT_DATA_DIR"));
    assert!(text("image") == "pliant" && service["ports"][0].as_str().expect("a port").contains("127.0.0.1"));
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn compose_with_tls_answers_to_its_certificate() {
    let reader = needed!(reader());
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("pliant.toml");
    fs::write(&config, new_token().1).expect("written");
    let files = Files::new(&Authority::new("authority").server(1));
    for (from, to) in [("server.pem", "certificate.pem"), ("server.key", "key.pem")] {
        fs::copy(files.path(from), folder.path().join(to)).expect("copied");
    }
    let whole = composed(&reader, &COMPOSE[..2]);
    let mounted = whole["services"]["pliant"]["volumes"][1].as_str().expect("a folder");
    assert_eq!(mounted, "./tls:/run/tls:ro");
    let place = folder.path().to_str().expect("UTF-8");
    let server = start(&whole, &config, &[("/var/lib/pliant", place), ("/run/tls", place)]);
    let server = server.expect("it starts");
    assert!(server.url.starts_with("https://"), "{}", server.url);
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn compose_with_postgres_keeps_sessions_in_its_database() {
    let reader = needed!(reader());
    let Some(postgres) = PostgresServer::shared() else {
        return;
    };
    let database = postgres.database().await;
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("pliant.toml");
    let (token, lines) = new_token();
    fs::write(&config, lines).expect("written");
    let whole = composed(&reader, &[COMPOSE[0], COMPOSE[2]]);
    let other = &whole["services"]["database"]["environment"];
    let own = whole["services"]["pliant"]["environment"]["PLIANT_DATABASE"]
        .as_str()
        .expect("a URL");
    let (user, name) = (other["POSTGRES_USER"].as_str(), other["POSTGRES_DB"].as_str());
    let password = other["POSTGRES_PASSWORD"].as_str().expect("a password");
    let wanted = format!(
        "postgres://{}:{password}@database/{}",
        user.expect("a user"),
        name.expect("a name")
    );
    assert_eq!(own, wanted, "the server asks for what the database has");
    let data = folder.path().join("data");
    let places = [
        ("/var/lib/pliant", data.to_str().expect("UTF-8")),
        (own, database.url.as_str()),
    ];
    check_that_sessions_stay(|| start(&whole, &config, &places), &token).await;
    assert!(!data.join("sessions.sqlite").exists(), "the rows are in PostgreSQL");
}

fn rendered(reader: &Path, values: &Value) -> Value {
    asked(reader, &["chart", CHART, &values.to_string()])
}

/// The one object of a kind and name.
fn object<'a>(objects: &'a Value, kind: &str, name: &str) -> &'a Value {
    let mut found = objects.as_array().expect("objects").iter();
    let is_it = |object: &&Value| object["kind"] == kind && object["metadata"]["name"] == name;
    found.find(is_it).unwrap_or_else(|| panic!("there is no {kind} {name}"))
}

#[test]
fn helm_renders_a_chart_that_kubernetes_takes() {
    let reader = needed!(reader());
    let folder = tempfile::tempdir().expect("a folder");
    let version = env!("CARGO_PKG_VERSION");
    for values in [
        json!({}),
        json!({"tls": {"secret": "certificate"}, "persistence": {"storageClass": "fast", "size": "1Ti"}, "imagePullSecrets": [{"name": "x"}]}),
        json!({"nodes": {"enabled": true}}),
        json!({"nodes": {"enabled": true, "autoscaling": {"enabled": true}}, "tls": {"secret": "certificate"}, "networkPolicy": {"enabled": false}}),
    ] {
        let made = rendered(&reader, &values);
        assert_eq!(made["lint"], json!([]), "{values}");
        let file = folder.path().join("chart.yaml");
        fs::write(&file, made["text"].as_str().expect("manifests")).expect("written");
        needed!(fits_kubernetes(&file)).unwrap_or_else(|problem| panic!("{values}: {problem}"));
        let server = &object(&made["documents"], "StatefulSet", "pliant")["spec"]["template"]["spec"]["containers"][0];
        assert_eq!(
            server["image"],
            format!("pliant:{version}"),
            "the chart is of this version"
        );
        assert!(
            made["notes"].as_str().expect("notes").contains("does not start"),
            "nobody may call yet"
        );
        let is_encrypted = values["tls"].is_object();
        assert_eq!(
            server["readinessProbe"]["httpGet"]["scheme"] == "HTTPS",
            is_encrypted,
            "{values}"
        );
    }
    for (wrong, named) in [
        (json!({"nodes": {"enabeld": true}}), "enabeld"),
        (json!({"persistence": {"size": "20"}}), "size"),
        (json!({"config": "listen = \"0.0.0.0:80\""}), "config"),
    ] {
        let problem = rendered(&reader, &wrong)["problem"].to_string();
        assert!(problem.contains(named), "{wrong}: {problem}");
    }
}

/// Without what marks a release among others, and without names of images.
fn without_release(value: &Value) -> Value {
    const OWN: [&str; 3] = ["app.kubernetes.io/instance", "image", "imagePullPolicy"];
    match value {
        Value::Object(table) => {
            let kept = table.iter().filter(|(key, _)| !OWN.contains(&key.as_str()));
            kept.map(|(key, value)| (key.clone(), without_release(value))).collect()
        }
        Value::Array(list) => list.iter().map(without_release).collect(),
        other => other.clone(),
    }
}

#[test]
fn the_chart_with_nodes_is_what_the_manifests_are() {
    let reader = needed!(reader());
    let values = json!({"nodes": {"enabled": true, "autoscaling": {"enabled": true}}});
    let chart = rendered(&reader, &values)["documents"].clone();
    for (file, kind, name) in [
        ("nodes", "StatefulSet", "pliant"),
        ("services", "Service", "pliant"),
        ("services", "Service", "pliant-nodes"),
        ("disruption", "PodDisruptionBudget", "pliant"),
        ("autoscaling", "HorizontalPodAutoscaler", "pliant"),
        ("network", "NetworkPolicy", "pliant"),
    ] {
        let manifests = asked(&reader, &["yaml", &format!("deploy/kubernetes/nodes/{file}.yaml")]);
        let (own, other) = (object(&chart, kind, name), object(&manifests, kind, name));
        assert_eq!(
            without_release(&own["spec"]),
            without_release(&other["spec"]),
            "{kind} {name}"
        );
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_configuration_of_the_chart_starts_with_a_token() {
    let reader = needed!(reader());
    let folder = tempfile::tempdir().expect("a folder");
    let config = folder.path().join("config.toml");
    let made = rendered(&reader, &json!({}))["documents"].clone();
    let text = object(&made, "ConfigMap", "pliant")["data"]["config.toml"]
        .as_str()
        .expect("a file")
        .to_owned();
    let pod = &object(&made, "StatefulSet", "pliant")["spec"]["template"]["spec"];
    let data = folder.path().join("data");
    let variables: Vec<(&str, &str)> = pod["containers"][0]["env"]
        .as_array()
        .expect("variables")
        .iter()
        .map(|variable| {
            (
                variable["name"].as_str().expect("a name"),
                data.to_str().expect("UTF-8"),
            )
        })
        .collect();
    assert_eq!(variables.len(), 1, "the folder of its sessions: {variables:?}");
    let log = folder.path().join("log");
    let words = ["--config", config.to_str().expect("UTF-8"), "--listen", "0.0.0.0:0"];
    let start = |text: &str| {
        fs::write(&config, text).expect("written");
        ServedProgram::start_anywhere(log.clone(), &words, &variables)
    };
    assert!(start(&text).err().expect("nobody may call").contains("pliant token"));
    start(&format!("{text}\n{}", new_token().1))
        .expect("it starts")
        .ask_to_stop();
    let limit = pod["containers"][0]["resources"]["limits"]["memory"]
        .as_str()
        .expect("a limit");
    let memory = text
        .lines()
        .find_map(|line| line.strip_prefix("memory_bytes = "))
        .expect("set");
    assert!(bytes(memory.trim_matches('"')) < bytes(limit));
    let drain = text
        .lines()
        .find_map(|line| line.strip_prefix("drain_deadline = "))
        .expect("set");
    let stops = seconds(drain.trim_matches('"')) + 10;
    assert!(pod["terminationGracePeriodSeconds"].as_u64().expect("seconds") >= stops);
}
