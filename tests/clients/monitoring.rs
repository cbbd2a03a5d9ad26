//! The rules of `deploy/prometheus` and the dashboard of `deploy/grafana`: every metric and label that they name is one of a running
//! server's, Prometheus reads and plays the rules, and Grafana's own types hold the dashboard. What is not installed or cannot be fetched
//! here is said and skipped.

use crate::node::lacks_node;
use crate::support::process::needed;
use crate::support::process::{said, show};
use crate::support::program::ServedProgram;
use crate::workflows::fetched;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Grafana's types of dashboards, and what holds a dashboard against them (npm).
const TYPES: [&str; 2] = ["@grafana/schema@11.6.0", "typescript@5.9.3"];

/// A dashboard as JSON has it: names of choices are plain words there.
const TYPED: &str = r#"
import type { Dashboard } from "@grafana/schema/dist/esm/raw/dashboard/x/dashboard_types.gen";
type Plain<T> = T extends string ? `${T}`
  : T extends number | boolean | null | undefined ? T
  : T extends (infer U)[] ? Plain<U>[]
  : { [K in keyof T]: Plain<T[K]> };
export const dashboard: Plain<Dashboard> =
"#;

/// Labels that Prometheus gives.
const GIVEN: [&str; 5] = ["job", "instance", "namespace", "pod", "<<.GroupBy>>"];

fn at(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy").join(name)
}

fn read(name: &str) -> String {
    fs::read_to_string(at(name)).unwrap_or_else(|e| panic!("{name}: {e}"))
}

/// What stands behind some keys of a file of YAML.
fn behind<'a>(text: &'a str, keys: &[&str]) -> Vec<&'a str> {
    let lines = text.lines().map(|line| line.trim_start().trim_start_matches("- "));
    lines
        .filter_map(|line| keys.iter().find_map(|key| line.strip_prefix(key)))
        .map(str::trim)
        .collect()
}

/// The queries of all panels and variables of the dashboard.
fn queries_of_dashboard() -> Vec<String> {
    let dashboard: Value = serde_json::from_str(&read("grafana/pliant.json")).expect("JSON");
    let panels = dashboard["panels"].as_array().expect("panels");
    let targets = panels.iter().filter_map(|panel| panel["targets"].as_array()).flatten();
    let queries = targets.map(|target| target["expr"].as_str().expect("a query").to_owned());
    let queries: Vec<String> = queries.collect();
    assert!(queries.len() > 20, "{} queries", queries.len());
    queries
}

fn metrics_of(query: &str) -> impl Iterator<Item = &str> {
    let words = query.split(|c: char| !c.is_ascii_alphanumeric() && c != '_' && c != ':');
    words.filter(|word| word.starts_with("pliant_") || word.starts_with("pliant:"))
}

/// The labels that a query adds up by, leaves out or chooses by.
fn labels_of(query: &str) -> Vec<&str> {
    let mut found = Vec::new();
    for list in ["by (", "without ("] {
        for (k, _) in query.match_indices(list) {
            let (names, _) = query[k + list.len()..].split_once(')').expect("a closed list");
            found.extend(names.split(',').map(str::trim));
        }
    }
    for (k, _) in query.match_indices("=\"").chain(query.match_indices("~\"")) {
        let before = query[..k].trim_end_matches(['=', '!']);
        let from = before
            .rfind(|c: char| !c.is_ascii_alphanumeric() && c != '_')
            .map_or(0, |p| p + 1);
        found.push(&before[from..]);
    }
    found
}

/// Names of metrics and labels that a running server exports.
struct Exported {
    metrics: BTreeSet<String>,
    labels: BTreeSet<String>,
}

impl Exported {
    fn of(text: &str) -> Self {
        let mut exported = Self {
            metrics: BTreeSet::new(),
            labels: GIVEN.map(str::to_owned).into(),
        };
        for line in text.lines().filter(|line| !line.starts_with('#')) {
            let end = line.find(['{', ' ']).unwrap_or(line.len());
            exported.metrics.insert(line[..end].to_owned());
            exported.labels.extend(labels_of(line).into_iter().map(str::to_owned));
        }
        for record in behind(&read("prometheus/recording.yml"), &["record:"]) {
            exported.metrics.insert(record.to_owned());
        }
        exported
    }

    /// What a query names that is not exported.
    fn lacks<'a>(&self, query: &'a str) -> Vec<&'a str> {
        let metrics = metrics_of(query).filter(|name| !self.metrics.contains(*name));
        let labels = labels_of(query).into_iter().filter(|name| !self.labels.contains(*name));
        metrics.chain(labels).collect()
    }
}

#[tokio::test(flavor = "multi_thread", worker_threads = 2)]
async fn every_metric_and_label_that_is_asked_for_is_exported() {
    let folder = tempfile::tempdir().expect("a folder");
    let server = ServedProgram::start_in_memory(folder.path().join("log"), &[]);
    // Labels are there once something was counted under them.
    server.open(String::new(), "?sample=creature").await;
    let text = server.get("/metrics").send().await.expect("an answer");
    let text = text.text().await.expect("text");
    let mut described: Vec<&str> = text.lines().filter(|line| line.starts_with("# ")).collect();
    described.sort_unstable();
    let count = described.len();
    described.dedup();
    assert_eq!(described.len(), count, "each metric is described once: {described:?}");
    let exported = Exported::of(&text);
    let mut queries = queries_of_dashboard();
    let keys = ["expr:", "seriesQuery:", "metricsQuery:"];
    for name in [
        "prometheus/recording.yml",
        "prometheus/alerts.yml",
        "kubernetes/adapter.yaml",
    ] {
        let text = read(name);
        let reply = behind(&text, &keys);
        assert!(reply.len() > 4, "{name}: {reply:?}");
        queries.extend(reply.into_iter().map(str::to_owned));
    }
    for query in &queries {
        assert_eq!(exported.lacks(query), Vec::<&str>::new(), "{query}");
    }
    let wrong = "sum by (user) (pliant_session_total{status=\"500\"}) / pliant:memory:used";
    assert_eq!(
        exported.lacks(wrong),
        ["pliant_session_total", "pliant:memory:used", "user", "status"]
    );
    let dashboard = read("grafana/pliant.json");
    for variable in ["$job", "$node", "${datasource}"] {
        let name = variable.trim_matches(['$', '{', '}']);
        assert!(
            dashboard.contains(variable) && dashboard.contains(&format!("\"name\": \"{name}\"")),
            "{variable}"
        );
    }
}

/// Runs promtool in a folder; `None` where it is not installed.
fn promtool(folder: &Path, arguments: &[&str]) -> Option<Result<(), String>> {
    let Ok(done) = Command::new("promtool").args(arguments).current_dir(folder).output() else {
        show("SKIPPED: promtool is not installed (apt-get install prometheus)");
        return None;
    };
    Some(match done.status.success() {
        true => Ok(()),
        false => Err(said(&done)),
    })
}

#[test]
fn prometheus_reads_the_rules_and_plays_them() {
    let own = at("prometheus");
    let checked = needed!(promtool(&own, &["check", "rules", "recording.yml", "alerts.yml"]));
    checked.expect("the rules can be read");
    let run = |folder: &Path, arguments: &[&str]| promtool(folder, arguments).expect("promtool is installed");
    let play = ["test", "rules", "alerts_test.yml"];
    run(&own, &play).expect("the rules do what is written beside them");
    let played = read("prometheus/alerts_test.yml");
    let alerts = read("prometheus/alerts.yml");
    for alert in behind(&alerts, &["alert:"]) {
        assert!(played.contains(alert), "{alert} is not played");
    }
    let folder = tempfile::tempdir().expect("a folder");
    for name in ["recording.yml", "alerts.yml", "alerts_test.yml"] {
        fs::copy(own.join(name), folder.path().join(name)).expect("copied");
    }
    for (right, wrong) in [
        ("> 0.85", "> 0.95"),
        ("pliant:queue_seconds:p95_5m > 1", "pliant:queue_seconds:p95_5m > 3"),
    ] {
        assert!(alerts.contains(right));
        fs::write(folder.path().join("alerts.yml"), alerts.replace(right, wrong)).expect("written");
        assert!(run(folder.path(), &play).is_err(), "{wrong} is found");
    }
}

/// Programs of Debian find no pods: in their place the check has addresses.
#[test]
fn prometheus_reads_its_configuration() {
    let folder = tempfile::tempdir().expect("a folder");
    let finds = "kubernetes_sd_configs:\n      - role: pod";
    let text = read("prometheus/prometheus.yml");
    assert!(text.contains(finds));
    let text = text.replace(finds, "static_configs:\n      - targets: [\"10.0.0.5:7411\"]");
    let check = |text: &str| {
        fs::write(folder.path().join("prometheus.yml"), text).expect("written");
        promtool(folder.path(), &["check", "config", "--syntax-only", "prometheus.yml"])
    };
    let checked = needed!(check(&text));
    checked.expect("it can be read");
    assert!(
        check(&text.replace("action: keep", "action: stay"))
            .expect("promtool")
            .is_err()
    );
}

#[test]
fn prometheus_reads_every_query_of_the_dashboard() {
    let folder = tempfile::tempdir().expect("a folder");
    let check = |queries: &[String]| {
        let mut text = "groups:\n- name: dashboard\n  rules:\n".to_owned();
        for (k, query) in queries.iter().enumerate() {
            let query = query.replace("$__rate_interval", "1m").replace('\'', "''");
            text += &format!("  - record: query_{k}\n    expr: '{query}'\n");
        }
        fs::write(folder.path().join("queries.yml"), text).expect("written");
        promtool(folder.path(), &["check", "rules", "queries.yml"])
    };
    let mut queries = queries_of_dashboard();
    let checked = needed!(check(&queries));
    checked.expect("every query can be read");
    queries[0] = queries[0].replacen('(', "((", 1);
    assert!(check(&queries).expect("promtool").is_err(), "the check can fail");
}

#[test]
fn the_dashboard_has_the_types_of_grafana() {
    if let Some(lack) = lacks_node() {
        return show(&format!("SKIPPED: {lack}"));
    }
    let home = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/dashboard-types");
    fs::create_dir_all(&home).expect("a folder");
    fs::write(home.join("package.json"), r#"{"private": true}"#).expect("written");
    let mut npm = Command::new("npm");
    npm.args(["install", "--no-audit", "--no-fund", "--silent"])
        .args(TYPES)
        .current_dir(&home);
    if !home.join("node_modules/@grafana/schema").is_dir() && fetched(&mut npm).is_none() {
        return;
    }
    let check = |dashboard: &str| {
        fs::write(home.join("dashboard.ts"), format!("{TYPED}{dashboard};\n")).expect("written");
        let mut tsc = Command::new("node");
        tsc.args([
            "node_modules/typescript/bin/tsc",
            "--noEmit",
            "--strict",
            "--skipLibCheck",
            "--target",
            "es2022",
        ]);
        let reply = tsc
            .args(["--module", "esnext", "--moduleResolution", "node", "dashboard.ts"])
            .current_dir(&home)
            .output();
        let reply = reply.expect("node runs");
        (reply.status.success(), said(&reply))
    };
    let dashboard = read("grafana/pliant.json");
    let (fits, reply) = check(&dashboard);
    assert!(fits, "{reply}");
    for (right, wrong) in [
        ("\"gridPos\"", "\"gridPosition\""),
        ("\"editable\": true", "\"editable\": \"yes\""),
    ] {
        let (fits, reply) = check(&dashboard.replacen(right, wrong, 1));
        assert!(!fits && reply.contains("error TS2"), "{wrong}: {reply}");
    }
}
