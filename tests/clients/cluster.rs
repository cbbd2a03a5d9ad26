//! The manifests of `deploy/kubernetes`: they fit the schemas of Kubernetes, put together they do as well, and what they say of the
//! server (paths, ports, keys, times, sizes, metrics) is true of it. What cannot be fetched or is not installed here is said and skipped.

use crate::support::data::copied;
use crate::support::process::needed;
use crate::support::process::{said, show};
use crate::support::program::ServedProgram;
use crate::support::server::http;
use crate::workflows::program_of_package;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Holds manifests against the schemas of Kubernetes that it brings along (PyPI).
const SCHEMAS: &str = "kubernetes-validate==1.37.0";
/// The oldest version that has all that the manifests use, and a new one.
const VERSIONS: [&str; 2] = ["1.30", "1.37"];

const NODES: [&str; 5] = [
    "nodes/nodes.yaml",
    "nodes/services.yaml",
    "nodes/disruption.yaml",
    "nodes/autoscaling.yaml",
    "nodes/network.yaml",
];
const PROXY: &str = "proxy/proxy.yaml";
const CHECK: [&str; 2] = ["check/shards.yaml", "check/merge.yaml"];

fn at(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy").join(name)
}

fn read(name: &str) -> String {
    fs::read_to_string(at(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

fn manifest(name: &str) -> String {
    read(&format!("kubernetes/{name}"))
}

/// What stands behind a key, wherever it is, without quotes and comments.
fn values(text: &str, key: &str) -> Vec<String> {
    let key = format!("{key}: ");
    let lines = text.lines().map(|line| line.trim_start().trim_start_matches("- "));
    lines
        .filter_map(|line| line.strip_prefix(&key))
        .map(|value| value.trim().trim_matches('"').to_owned())
        .collect()
}

fn number(text: &str, key: &str) -> u64 {
    let found = values(text, key);
    found[0].parse().unwrap_or_else(|e| panic!("{key}: {found:?}: {e}"))
}

/// The value of a key in a file of the server's configuration, set or a default.
fn setting(text: &str, key: &str) -> Option<String> {
    let lines = text.lines().map(|line| line.trim_start_matches("#= "));
    lines
        .filter_map(|line| line.split_once(" = "))
        .find(|(name, _)| *name == key)
        .map(|(_, value)| value.trim_matches('"').to_owned())
}

fn schema_checker() -> Option<PathBuf> {
    program_of_package("kubernetes-schemas", &[SCHEMAS], "kubernetes-validate")
}

fn fits_schema(checker: &Path, version: &str, file: &Path) -> Result<(), String> {
    let mut command = Command::new(checker);
    let done = command.args(["--quiet", "--strict", "-k", version]).arg(file).output();
    let done = done.expect("it runs");
    match done.status.success() {
        true => Ok(()),
        false => Err(said(&done)),
    }
}

/// Whether manifests fit the schemas of all versions; `None` where these cannot be had.
pub(super) fn fits_kubernetes(file: &Path) -> Option<Result<(), String>> {
    let checker = schema_checker()?;
    Some(
        VERSIONS
            .iter()
            .try_for_each(|version| fits_schema(&checker, version, file)),
    )
}

#[test]
fn manifests_fit_the_schemas_of_kubernetes() {
    let checker = needed!(schema_checker());
    for name in NODES.into_iter().chain([PROXY]).chain(CHECK) {
        for version in VERSIONS {
            let fit = fits_schema(&checker, version, &at("kubernetes").join(name));
            fit.unwrap_or_else(|problem| panic!("{name}, {version}: {problem}"));
        }
    }
    let folder = tempfile::tempdir().expect("a folder");
    let broken = folder.path().join("broken.yaml");
    for (right, wrong) in [
        ("readinessProbe:", "readynessProbe:"),
        ("periodSeconds: 2", "periodSeconds: 2s"),
    ] {
        fs::write(&broken, manifest(NODES[0]).replace(right, wrong)).expect("written");
        assert!(fits_schema(&checker, "1.30", &broken).is_err(), "{wrong} is found");
    }
    for (right, wrong) in [("completions: 8", "completion: 8"), ("values: [2]", "values: [two]")] {
        fs::write(&broken, manifest(CHECK[0]).replace(right, wrong)).expect("written");
        assert!(fits_schema(&checker, "1.30", &broken).is_err(), "{wrong} is found");
    }
}

/// What kubectl makes of a folder; `None` where there is no kubectl.
fn built(folder: &Path) -> Option<Result<String, String>> {
    let Ok(done) = Command::new("kubectl").arg("kustomize").arg(folder).output() else {
        show("SKIPPED: kubectl is not installed");
        return None;
    };
    Some(match done.status.success() {
        true => Ok(String::from_utf8(done.stdout).expect("UTF-8")),
        false => Err(said(&done)),
    })
}

#[test]
fn kubectl_puts_the_manifests_together() {
    let nodes = needed!(built(&at("kubernetes/nodes")));
    let nodes = nodes.expect("the nodes are put together");
    let own = "value: http://$(POD_NAME).pliant-nodes.$(POD_NAMESPACE).svc:7411";
    assert!(
        nodes.contains(own) && nodes.contains("listen = \"0.0.0.0:7411\""),
        "{nodes}"
    );
    let behind = built(&at("kubernetes/proxy")).expect("kubectl").expect("and the proxy");
    assert!(
        behind.contains("value: http://pliant.example:7411") && !behind.contains(own),
        "{behind}"
    );
    let folder = tempfile::tempdir().expect("a folder");
    if let Some(checker) = schema_checker() {
        for (name, text) in [("nodes.yaml", &nodes), ("proxy.yaml", &behind)] {
            let file = folder.path().join(name);
            fs::write(&file, text).expect("written");
            fits_schema(&checker, VERSIONS[0], &file).unwrap_or_else(|problem| panic!("{name}: {problem}"));
        }
    }
    // Where the variable that the proxy's patch replaces has moved, nothing is put together, rather than another variable replaced.
    copied(&at("kubernetes"), folder.path());
    let moved = manifest(NODES[0]).replace(
        "            - name: PLIANT_NODE\n              value: $(POD_NAME)\n",
        "",
    );
    fs::write(folder.path().join(NODES[0]), moved).expect("written");
    assert!(built(&folder.path().join("proxy")).expect("kubectl").is_err());
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn probes_and_variables_name_what_the_server_has() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &[]);
    let nodes = manifest(NODES[0]);
    let scraped = values(&nodes, "prometheus.io/path");
    let asked = [
        values(&nodes, "path"),
        scraped,
        values(&read("prometheus/prometheus.yml"), "metrics_path"),
    ]
    .concat();
    assert_eq!(asked.len(), 5, "{asked:?}");
    for path in asked {
        let answer = http()
            .get(format!("{}{path}", server.url))
            .send()
            .await
            .expect("an answer");
        assert_eq!(answer.status().as_u16(), 200, "{path}");
    }
    let reference = read("config.toml");
    let listens = setting(&reference, "listen").expect("a default");
    let (_, port) = listens.rsplit_once(':').expect("a port");
    let elsewhere = ["53", "5432", "443"];
    for name in NODES.into_iter().chain([PROXY]).chain(CHECK) {
        let text = manifest(name);
        let named = [
            values(&text, "port"),
            values(&text, "containerPort"),
            values(&text, "prometheus.io/port"),
        ]
        .concat();
        for named in named.iter().filter(|named| named.parse::<u16>().is_ok()) {
            let is_known = named == port || elsewhere.contains(&named.as_str()) && name == "nodes/network.yaml";
            assert!(is_known, "{name}: {named}");
        }
        let ports: Vec<&str> = text
            .match_indices(".svc:")
            .map(|(k, dots)| text[k + dots.len()..].lines().next())
            .map(Option::unwrap)
            .collect();
        assert!(ports.iter().all(|named| *named == port), "{name}: {ports:?}");
    }
    let variables: Vec<&str> = nodes
        .split(|c: char| !c.is_ascii_uppercase() && c != '_')
        .filter_map(|word| word.strip_prefix("PLIANT_"))
        .filter(|word| *word != "PORT")
        .collect();
    assert!(
        variables.contains(&"ADVERTISE") && variables.contains(&"DATABASE"),
        "{variables:?}"
    );
    for variable in variables {
        assert!(
            setting(&reference, &variable.to_lowercase()).is_some(),
            "{variable} is not a key"
        );
    }
    assert!(setting(&reference, "advertised").is_none(), "the check can fail");
    assert!(
        nodes.contains("enableServiceLinks: false"),
        "no variable of the cluster's looks like a key"
    );
}

/// Bytes of a size, as the configuration, Kubernetes and compose write them.
pub(super) fn bytes(size: &str) -> u64 {
    let gib = ["GiB", "Gi", "g"].iter().find_map(|unit| size.strip_suffix(unit));
    gib.and_then(|n| n.parse::<u64>().ok())
        .unwrap_or_else(|| panic!("{size}"))
        << 30
}

#[test]
fn times_and_sizes_of_the_manifests_fit_the_configuration() {
    let (nodes, config) = (manifest(NODES[0]), manifest("nodes/config.toml"));
    let drain = setting(&config, "drain_deadline")
        .expect("set")
        .trim_end_matches('s')
        .parse::<u64>();
    let stops = number(&nodes, "seconds") + drain.expect("seconds");
    assert!(
        number(&nodes, "terminationGracePeriodSeconds") >= stops + 5,
        "a node is not killed before it is done"
    );
    let held = bytes(&setting(&config, "memory_bytes").expect("set"));
    let limits: Vec<u64> = values(&nodes, "memory").iter().map(|size| bytes(size)).collect();
    assert!(
        limits.len() == 2 && limits.iter().all(|limit| *limit > held),
        "{limits:?}"
    );
    let scaling = manifest("nodes/autoscaling.yaml");
    let targets = values(&scaling, "averageValue");
    let sessions: u64 = setting(&config, "sessions").expect("set").parse().expect("a number");
    assert!(
        targets[1].parse::<u64>().expect("a number") < sessions,
        "nodes are added before they are full"
    );
    assert!(
        targets[0].trim_end_matches('m').parse::<u64>().expect("a number") < 900,
        "and before they take nothing"
    );
    let servers = manifest("proxy/haproxy.cfg").matches("    server pliant-").count() as u64;
    assert_eq!(
        servers,
        2 * number(&scaling, "maxReplicas"),
        "the proxy knows every node, twice"
    );
    let wanted: Vec<String> = values(&scaling, "name")
        .into_iter()
        .filter(|name| name.starts_with("pliant_"))
        .collect();
    assert_eq!(
        wanted,
        values(&manifest("adapter.yaml"), "as"),
        "the adapter gives what is asked for"
    );
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn the_configuration_of_the_cluster_starts_with_a_token_and_not_without() {
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("config.toml");
    let start = |config: &str| {
        fs::write(&file, config).expect("written");
        let reply = ["--config", file.to_str().expect("UTF-8"), "--listen", "0.0.0.0:0"];
        ServedProgram::start_anywhere(folder.path().join("log"), &reply, &[])
    };
    let config = manifest("nodes/config.toml");
    let refused = start(&config).err().expect("nobody was told who may call");
    assert!(refused.contains("pliant token"), "{refused}");
    let made = Command::new(env!("CARGO_BIN_EXE_pliant"))
        .args(["token", "studio", "--metrics"])
        .output();
    let made = String::from_utf8(made.expect("a token").stdout).expect("UTF-8");
    let (token, lines) = made.split_once('\n').expect("a token and its lines");
    let server = start(&format!("{config}{lines}")).expect("it starts");
    let url = server.url.replace("0.0.0.0", "127.0.0.1");
    let status = async |path: &str, token: &str| {
        let sent = http().get(format!("{url}{path}")).bearer_auth(token).send().await;
        sent.expect("an answer").status().as_u16()
    };
    let probes = [status("/healthz", "").await, status("/readyz", "").await];
    assert_eq!(probes, [200; 2], "probes carry no token");
    let reply = [
        status("/metrics", token).await,
        status("/v1/sessions", token).await,
        status("/v1/sessions", "x").await,
    ];
    assert_eq!(reply, [200, 200, 401]);
}

/// A proxy's configuration without comments, its nodes, and how they are found.
fn without_nodes(text: &str) -> Vec<String> {
    let mut is_resolver = false;
    let mut kept = Vec::new();
    for line in text
        .lines()
        .filter(|line| !line.trim_start().starts_with('#') && !line.trim().is_empty())
    {
        is_resolver = line.starts_with("resolvers ") || is_resolver && line.starts_with(' ');
        if !is_resolver && !line.trim_start().starts_with("server ") {
            kept.push(line.replace("resolvers cluster resolve-prefer ipv4 init-addr none ", ""));
        }
    }
    kept
}

#[test]
fn the_proxy_of_the_cluster_does_what_the_tested_one_does() {
    let own = manifest("proxy/haproxy.cfg");
    assert_eq!(without_nodes(&own), without_nodes(&read("haproxy.cfg")));
    let checked = |namespace: Option<&str>| {
        let mut proxy = Command::new("haproxy");
        proxy
            .args(["-c", "-q", "-f"])
            .arg(at("kubernetes/proxy/haproxy.cfg"))
            .env_remove("POD_NAMESPACE");
        proxy.envs(namespace.map(|name| ("POD_NAMESPACE", name))).output()
    };
    let Ok(done) = checked(Some("studio")) else {
        return show("SKIPPED: HAProxy is not installed");
    };
    assert!(done.status.success(), "{}", said(&done));
    assert!(
        !checked(None).expect("haproxy runs").status.success(),
        "names are not names without it"
    );
    assert!(manifest(PROXY).contains("- name: POD_NAMESPACE"), "the pod has it");
}
