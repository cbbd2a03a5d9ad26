//! What a check is for: each kind of damage is caught by a case of its own, with a reason of its own, in every report.

use super::folder::Suite;
use crate::support::server::{Server, bar_obj, http};
use crate::support::shapes::obj_text;
use axum::Router;
use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::response::Response;
use glam::DVec3;
use pliant::asset::shapes::{Shape, box_with_cells};
use serde_json::Value;
use std::net::SocketAddr;
use std::sync::Arc;
use tokio::net::TcpListener;

/// The bar, each vertex and face changed.
fn bar(vertex: impl Fn(usize, DVec3) -> DVec3, face: impl Fn(usize, [u32; 3]) -> Option<[u32; 3]>) -> String {
    let (points, faces) = whole_bar();
    let points = points.into_iter().enumerate().map(|(k, p)| vertex(k, p));
    let faces = faces.into_iter().enumerate().filter_map(|(k, t)| face(k, t));
    obj_text(&(points.collect(), faces.collect()))
}

/// The shape of `bar_obj`.
fn whole_bar() -> Shape {
    box_with_cells(DVec3::new(0.5, 0.5, 4.0), [3, 3, 20])
}

fn place_of(found: impl Fn(DVec3) -> bool) -> usize {
    whole_bar().0.into_iter().position(found).expect("such a vertex")
}

fn keep(_: usize, t: [u32; 3]) -> Option<[u32; 3]> {
    Some(t)
}

fn codes(case: &Value) -> Vec<&str> {
    let reasons = case["reasons"].as_array().expect("reasons");
    reasons.iter().map(|r| r["code"].as_str().expect("a code")).collect()
}

/// The test case of a name in a JUnit report.
fn junit<'a>(report: &'a str, name: &str) -> &'a str {
    let start = report
        .find(&format!("name=\"{name}\">"))
        .unwrap_or_else(|| panic!("{name} in {report}"));
    let rest = &report[start..];
    &rest[..rest.find("</testcase>").expect("an end")]
}

#[test]
fn each_kind_of_damage_is_caught_by_its_own_case() {
    let folder = Suite::new();
    // Their result is the model itself: it is off by what that is off, and nothing else.
    let inner = place_of(|p| p.z == 0.0 && p.x.abs() < 0.2 && p.y.abs() < 0.2);
    let moved = bar(|v, p| if v == inner { p + DVec3::X * 1e-3 } else { p }, keep);
    let flipped = bar(|v, p| if v == inner { p + DVec3::X * 0.5 } else { p }, keep);
    let opened = bar(|_, p| p, |f, t| (f != 100).then_some(t));
    let rewound = bar(
        |_, p| p,
        |f, [a, b, c]| Some(if f == 100 { [a, c, b] } else { [a, b, c] }),
    );
    let damaged = [
        ("moved", moved),
        ("flipped", flipped),
        ("opened", opened),
        ("rewound", rewound),
    ];
    for (name, model) in &damaged {
        let file = format!("{name}.obj");
        folder.still(name, &file);
        folder.write(&file, model);
    }
    for name in ["good", "missing", "stale-model", "stale-job", "broken", "refused"] {
        folder.case(name, &format!("{name}.obj"));
    }
    // Goldens of the damaged models; then the right models come back, and only the results are others.
    folder.passes("--bless");
    for (name, _) in &damaged {
        let file = format!("{name}.obj");
        folder.write(&file, &bar_obj(20));
        folder.pretend_model(name, &file);
    }
    folder.remove("missing.golden.json");
    folder.write("stale-model.obj", &(bar_obj(20) + "# one line more\n"));
    folder.job("stale-job", "stale-job.obj", 0.81);
    let golden = folder.read("broken.golden.json");
    folder.write("broken.golden.json", &golden[..golden.len() / 2]);
    folder.write("refused.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");

    let ran = folder.fails("--json --junit report.xml --html report.html");
    assert!(
        ran.last().starts_with("pliant: 9 of 10 cases failed: "),
        "{}",
        ran.last()
    );
    let (report, xml, page) = (ran.json(), folder.read("report.xml"), folder.read("report.html"));
    assert_eq!((&report["passed"], &report["failed"]), (&1.into(), &9.into()));
    let expected = [
        ("moved", "metric", "maxDisplacement"),
        ("flipped", "metric", "flippedTriangles"),
        ("opened", "topology", "triangles"),
        ("rewound", "winding", "wound differently"),
        ("missing", "missing-golden", "there is no golden"),
        ("stale-model", "stale-golden", "the case's model has changed"),
        ("stale-job", "stale-golden", "the case's job has changed"),
        ("broken", "broken-golden", "look at the result and bless it again"),
        ("refused", "not-run", "line 1"),
    ];
    for (name, code, words) in expected {
        let cases = report["cases"].as_array().expect("cases");
        let case = cases.iter().find(|c| c["name"] == name).expect(name);
        assert_eq!(case["status"], "failed", "{name}");
        assert!(codes(case).contains(&code), "{name}: {case}");
        let line = ran
            .err
            .lines()
            .find(|l| l.starts_with(&format!("FAILED   {name} ")))
            .expect(name);
        assert!(line.contains(words), "{name}: {line}");
        let reply = junit(&xml, name);
        assert!(
            reply.contains(code) && reply.contains(words.split('\'').next().expect("words")),
            "{name}: {reply}"
        );
        let element = if code == "not-run" { "<error " } else { "<failure " };
        assert!(reply.contains(element), "{name}: {reply}");
        assert!(
            page.contains(&format!("<section id=\"{name}\" class=\"failed\">")),
            "{name}"
        );
    }
    ran.says(&["passed   good"]);
    let flips = |name: &str| {
        let cases = report["cases"].as_array().expect("cases");
        let case = cases.iter().find(|c| c["name"] == name).expect(name);
        let metrics = case["metrics"].as_array().expect("metrics");
        metrics
            .iter()
            .find(|m| m["name"] == "flippedTriangles")
            .expect("a number")["difference"]
            .as_f64()
    };
    assert_eq!(flips("moved"), Some(0.0), "what moved a little did not turn over");
    assert!(flips("flipped") >= Some(1.0));
    assert_eq!(flips("opened"), None);
    // The distance is asked to the model's units: 1e-3 of a bar about 4 long.
    assert!(
        ran.err
            .lines()
            .any(|l| l.contains("moved") && l.contains(&format!("vertex {inner} "))),
        "{}",
        ran.err
    );

    for name in ["stale-model", "stale-job"] {
        assert_shown_beside(&report, &xml, &page, name);
    }

    // What blesses is looked at by people; it asserts nothing, and what no golden can be made of still fails.
    let blessed = folder.fails("--bless");
    blessed.gives(&["1 of 10 cases failed: refused"]);
    folder.write("refused.obj", &bar_obj(20));
    folder.passes("--bless");
    let ran = folder.passes("--no-skip");
    ran.says(&["10 passed"]);
}

/// A stale golden is shown beside the result, with all differences, so that no one has to bless blind.
fn assert_shown_beside(report: &Value, xml: &str, page: &str, name: &str) {
    let cases = report["cases"].as_array().expect("cases");
    let case = cases.iter().find(|c| c["name"] == name).expect(name);
    assert_eq!(codes(case)[0], "stale-golden", "{name}");
    let metrics = case["metrics"].as_array().expect("metrics");
    let apart = metrics
        .iter()
        .find(|m| m["name"] == "maxDisplacement")
        .expect("a number")["difference"]
        .as_f64();
    // A comment changes the model's bytes and nothing else.
    let moves = name == "stale-job";
    assert_eq!(apart.map(|by| by > 0.0), Some(moves), "{name}: {apart:?}");
    assert!(junit(xml, name).contains("name=\"maxDisplacement\""), "{name}");
    let section = page
        .split(&format!("<section id=\"{name}\""))
        .nth(1)
        .expect("a section");
    let section = section.split("</section>").next().expect("an end");
    for caption in ["expected", "difference"] {
        assert_eq!(
            section.contains(&format!("<b>{caption}</b>")),
            moves,
            "{name}: {caption}"
        );
    }
    assert!(section.contains("<b>after</b>") && section.contains("maxDisplacement"));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_server_that_answers_wrongly_is_caught_though_its_digest_is_right() {
    let server = Server::start().await;
    let proxies = [
        // The first coordinate is not a number.
        Proxy::start(server.address, |floats| floats[0] = f32::NAN).await,
        // One vertex is moved by a thousandth.
        Proxy::start(server.address, |floats| floats[3 * 30] += 1e-3).await,
        Proxy::start(server.address, |_| {}).await,
    ];
    let urls = proxies.each_ref().map(|p| format!("http://{}", p.address));
    let ran = tokio::task::spawn_blocking(move || {
        let folder = Suite::of_bar();
        folder.passes("--bless");
        urls.map(|url| {
            let ran = folder.check(&format!("--json --junit r.xml --html r.html --force --server {url}"));
            let xml = folder.read("r.xml");
            (ran, xml)
        })
    });
    let [(nan, nan_xml), (moved, moved_xml), (good, _)] = ran.await.expect("it ran");
    assert_eq!(nan.code, Some(1), "{}", nan.err);
    nan.says(&["FAILED   bar  not-finite: 1 of ", "vertex 0"]);
    assert_eq!(
        codes(&nan.json()["cases"][0]),
        ["not-finite"],
        "what is not finite fails first, and alone"
    );
    assert!(junit(&nan_xml, "bar").contains("type=\"not-finite\""));
    assert_eq!(moved.code, Some(1), "{}", moved.err);
    moved.says(&["maxDisplacement", "vertex 30 "]);
    assert_eq!(codes(&moved.json()["cases"][0])[0], "digest");
    assert!(junit(&moved_xml, "bar").contains("the positions that came with it are not"));
    assert_eq!(good.code, Some(0), "{}", good.err);
}

/// What is done to the coordinates of a vertex buffer.
type Damage = Arc<dyn Fn(&mut [f32]) + Send + Sync>;

/// Runs until it is dropped.
pub struct Proxy {
    pub address: SocketAddr,
    task: tokio::task::JoinHandle<()>,
}

impl Proxy {
    /// Stands before the server at `behind`; `damage` changes the coordinates of every vertex buffer.
    pub async fn start(behind: SocketAddr, damage: impl Fn(&mut [f32]) + Send + Sync + 'static) -> Self {
        let damage: Damage = Arc::new(damage);
        let pass = move |request: Request| pass(behind, Arc::clone(&damage), request);
        let listener = TcpListener::bind("127.0.0.1:0").await.expect("a free port");
        let address = listener.local_addr().expect("an address");
        let router = Router::new().fallback(pass);
        let task = tokio::spawn(async move {
            axum::serve(listener, router).await.expect("it serves");
        });
        Self { address, task }
    }
}

impl Drop for Proxy {
    fn drop(&mut self) {
        self.task.abort();
    }
}

async fn pass(behind: SocketAddr, damage: Damage, request: Request) -> Response {
    let (parts, body) = request.into_parts();
    let body = axum::body::to_bytes(body, 1 << 26).await.expect("a body");
    let path = parts.uri.path_and_query().map_or("/", |p| p.as_str());
    let mut call = http()
        .request(parts.method.clone(), format!("http://{behind}{path}"))
        .body(body);
    for name in ["content-type", "accept"] {
        if let Some(value) = parts.headers.get(name) {
            call = call.header(name, value);
        }
    }
    let answer = call.send().await.expect("an answer");
    let status = answer.status();
    let headers = answer.headers().clone();
    let mut bytes = answer.bytes().await.expect("a body").to_vec();
    if parts.uri.path().ends_with("/positions") {
        let mut floats = crate::support::server::floats(&bytes);
        damage(&mut floats);
        bytes = floats.iter().flat_map(|f| f.to_le_bytes()).collect();
    }
    let mut response = Response::new(Body::from(Bytes::from(bytes)));
    *response.status_mut() = status;
    for (name, value) in &headers {
        if name != "content-length" && name != "transfer-encoding" && name != "content-encoding" {
            response.headers_mut().append(name.clone(), value.clone());
        }
    }
    response
}
