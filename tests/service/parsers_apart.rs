//! Decoders in C and C++ in a process of their own: the same results, and a fault in them refuses one file.

use crate::support::commands::Workplace;
use crate::support::data::{data_root, report_skipped};
use crate::support::fbx_text::{bar, cube, shaped_cube};
use crate::support::packed_models::meshopt_of;
use crate::support::program::ServedProgram;
use crate::support::server::*;
use serde_json::{Value, json};
use std::collections::BTreeSet;
use std::fs;
use std::path::PathBuf;

/// Files whose decoders are C and C++: of each kind some that are made here, and those of the data folder that are there.
fn files() -> Vec<(String, Vec<u8>)> {
    let corners = |k: u32| [[0., 0., 0.], [1., 0., 0.], [0., 1., 0.], [0., 0., 1.]][k as usize];
    let tetrahedron = [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]];
    let mut files = vec![
        ("cube.fbx".to_owned(), cube().text().into_bytes()),
        ("bar.fbx".to_owned(), bar().text().into_bytes()),
        ("shaped.fbx".to_owned(), shaped_cube().text().into_bytes()),
        (
            "packed.glb".to_owned(),
            meshopt_of(&tetrahedron.map(|t| t.map(corners)).concat()),
        ),
    ];
    for name in [
        "field/half_weighted.fbx",
        "gltf/BoxMeshopt.glb",
        "gltf/derived/BrainStem_gltfpack_c.glb",
        "gltf/derived/three_Horse_morph_gltfpack.glb",
    ] {
        match fs::read(data_root().join(name)) {
            Ok(bytes) => files.push((name.to_owned(), bytes)),
            Err(_) => report_skipped(name, "it is not in the data folder"),
        }
    }
    files
}

/// What a server makes of a file: facts, a solved shape, the file of that shape, and the file of an edit.
async fn results(server: &ServedProgram, bytes: &[u8]) -> [Vec<u8>; 4] {
    let made = server.post("/v1/sessions").body(bytes.to_vec()).answer().await;
    let mut session: Value = made.json().await.expect("JSON");
    let id = text(&session["id"]);
    let last = session["model"]["vertices"].as_u64().expect("a session") - 1;
    let vertex =
        |id: &str, first: u64| json!({"id": id, "region": {"vertices": {"ranges": [{"first": first, "count": 1}]}}});
    let handles = json!({"handles": [vertex("first", 0), vertex("last", last)]});
    server
        .done("PUT", &format!("/v1/sessions/{id}/handles"), Some(&handles))
        .await;
    let pose = json!({"pose": {"handles": [{"id": "last", "pose": {"translation": [0.1, 0, 0]}}]}});
    let solve = server.post(&format!("/v1/sessions/{id}/solve")).json(&pose);
    let solved = solve
        .header("accept", "application/octet-stream")
        .answer()
        .await
        .bytes()
        .await;
    let written = async || {
        let answer = server.get(&format!("/v1/sessions/{id}/model")).answer().await;
        assert_eq!(answer.status().as_u16(), 200, "{}", server.log());
        answer.bytes().await.expect("a body").to_vec()
    };
    let posed = written().await;
    let edit = json!({"subdivide": {"scheme": "MIDPOINT"}});
    server
        .done("POST", &format!("/v1/sessions/{id}/edits"), Some(&edit))
        .await;
    let facts = session["model"].take().to_string().into_bytes();
    [facts, solved.expect("a body").to_vec(), posed, written().await]
}

#[tokio::test]
async fn files_that_are_decoded_apart_give_the_same_bytes() {
    let folder = Workplace::empty();
    let [apart, inside] = ["--parse-apart", "--parse-apart=false"]
        .map(|flag| ServedProgram::start_in_memory(folder.at(&flag[2..]), &[flag]));
    for (name, bytes) in files() {
        let [apart, inside] = [results(&apart, &bytes).await, results(&inside, &bytes).await];
        assert!(!inside[1].is_empty(), "{name}");
        for (of_apart, of_inside) in apart.iter().zip(&inside) {
            assert!(of_apart == of_inside, "{name}");
        }
    }
    // Refusals are the same too.
    let cut = cube().text().into_bytes();
    for bytes in [
        &cut[..cut.len() / 2],
        b"; FBX 7.4.0 project file\nObjects: {",
        b"Kaydara FBX Binary  \0\x1a\0",
    ] {
        let refused = async |server: &ServedProgram| {
            let answer = server.post("/v1/sessions").body(bytes.to_vec()).answer().await;
            (
                answer.status().as_u16(),
                answer.json::<Value>().await.expect("JSON")["detail"].clone(),
            )
        };
        let [apart, inside] = [refused(&apart).await, refused(&inside).await];
        assert!(inside.0 >= 400, "{inside:?}");
        assert_eq!(apart, inside);
    }
}

#[tokio::test]
async fn memory_that_is_not_there_refuses_a_file_in_either_process() {
    let folder = Workplace::empty();
    let file = crate::support::packed_models::fbx_of_zeros(10_000_000);
    for flag in ["--parse-apart", "--parse-apart=false"] {
        let server = ServedProgram::start_in_memory(folder.at("log"), &[flag, "--memory-bytes", "64MiB"]);
        let answer = server.post("/v1/sessions").body(file.clone()).answer().await;
        let status = answer.status().as_u16();
        let problem: Value = answer.json().await.expect("JSON");
        assert_eq!(
            (status, problem["code"].as_str()),
            (413, Some("RESOURCE_EXHAUSTED")),
            "{flag}: {problem}"
        );
    }
}

/// The processes that a process has started and that have not ended.
fn children(of: u32) -> Vec<u32> {
    let threads = fs::read_dir(format!("/proc/{of}/task")).into_iter().flatten().flatten();
    let lists = threads.filter_map(|thread| fs::read_to_string(thread.path().join("children")).ok());
    lists
        .flat_map(|list| {
            list.split_whitespace()
                .filter_map(|id| id.parse().ok())
                .collect::<Vec<u32>>()
        })
        .collect()
}

/// A server whose processes fail in some way instead of decoding.
fn failing(folder: &Workplace, fault: &str) -> ServedProgram {
    let variables = [("FAULT_OF_PARSER", fault)];
    ServedProgram::start_anywhere(folder.at("log"), &["--parse-apart"], &variables).expect("the server starts")
}

#[tokio::test]
async fn without_a_fence_the_server_says_so_or_does_not_start() {
    let folder = Workplace::empty();
    for (fault, why) in [
        ("unconfined", "no process can be confined: as a test demands"),
        ("early-crash", "the process for it was ended by signal 6: it failed"),
    ] {
        let variables = [("FAULT_OF_PARSER", fault)];
        let started = |flags: &[&str], log: &str| ServedProgram::start_anywhere(folder.at(log), flags, &variables);
        let server = started(&[], "default").expect("the server starts");
        let warned = format!("WARN pliant::cli::serve: FBX and meshopt compression are decoded in this process: {why}");
        assert!(server.log().contains(&warned), "{}", server.log());
        let session = server.open(cube().text(), "").await;
        assert!(!server.positions(&session).await.is_empty());
        assert_eq!(children(server.id()), [0; 0]);
        // It is as if it were asked for.
        let asked = started(&["--parse-apart=false"], "asked").expect("the server starts");
        assert!(!asked.log().contains("decoded in this process"), "{}", asked.log());
        let refused = started(&["--parse-apart"], "demanded")
            .err()
            .expect("the server does not start");
        for part in [why, "parse_apart: ", "--parse-apart=false"] {
            assert!(refused.contains(part), "{refused:?} lacks {part:?}");
        }
    }
}

#[tokio::test]
async fn a_process_that_fails_refuses_its_file_and_nothing_else() {
    let folder = Workplace::empty();
    for (fault, why) in [
        ("crash", "signal 6: it failed, or took more memory than is allowed"),
        ("memory", "signal 6: it failed, or took more memory than is allowed"),
        ("panic", "signal 6: it failed, or took more memory than is allowed"),
        ("open", "signal 31: it asked the system for what it may not do"),
        ("write", "signal 31: it asked the system for what it may not do"),
    ] {
        let server = failing(&folder, fault);
        let kept = server.open(bar_obj(4), "").await;
        let before = server.positions(&kept).await;
        for (name, place) in [
            ("cube.fbx", "fbx: file"),
            ("packed.glb", "glb: bufferViews/0/extensions/meshopt_compression"),
        ] {
            let (_, bytes) = files().into_iter().find(|(other, _)| other == name).expect("a file");
            let answer = server.post("/v1/sessions").body(bytes).answer().await;
            let status = answer.status().as_u16();
            let problem: Value = answer.json().await.expect("JSON");
            let detail = text(&problem["detail"]);
            assert_eq!(
                (status, problem["code"].as_str()),
                (422, Some("INVALID_ARGUMENT")),
                "{detail}"
            );
            for part in [place, why, "glb without compression"] {
                assert!(detail.contains(part), "{fault}: {detail:?} lacks {part:?}");
            }
        }
        assert_eq!(server.positions(&kept).await, before);
        server.open(bar_obj(4), "").await;
        assert_eq!(children(server.id()), [0; 0], "processes are left");
        assert_eq!(
            server
                .log()
                .matches(&format!("the process that decodes a file was ended by {why}"))
                .count(),
            2
        );
    }
}

#[tokio::test]
async fn a_process_holds_nothing_of_the_server_and_ends_with_its_request() {
    let folder = Workplace::empty();
    let server = failing(&folder, "hang");
    let call = server.post("/v1/sessions").body(cube().text());
    let waiting = tokio::spawn(call.send());
    let mut process = 0;
    eventually("the process starts and is confined", async || {
        process = children(server.id()).first().copied().unwrap_or_default();
        let status = fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
        status.contains("Seccomp:\t2") && status.contains("NoNewPrivs:\t1")
    })
    .await;
    let of = |what: &str| PathBuf::from(format!("/proc/{process}/{what}"));
    assert_eq!(
        fs::read(of("environ")).expect("its environment"),
        b"",
        "no variable is inherited"
    );
    let open = fs::read_dir(of("fd")).expect("its files").flatten();
    let open = open.map(|file| fs::read_link(file.path()).expect("a file").display().to_string());
    let sockets: BTreeSet<String> = open.filter(|name| name.starts_with("socket:")).collect();
    assert_eq!(
        sockets.len(),
        1,
        "the one to the server, and none of its callers: {sockets:?}"
    );
    let limits = fs::read_to_string(of("limits")).expect("its limits");
    let soft = |name: &str| {
        let row = limits.lines().find_map(|row| row.strip_prefix(name)).expect("a limit");
        row.split_whitespace().next().expect("a value").to_owned()
    };
    assert_eq!(
        ["Max file size", "Max core file size", "Max open files"].map(soft),
        ["0", "0", "4"]
    );
    assert!(
        soft("Max address space")
            .parse::<u64>()
            .is_ok_and(|bytes| bytes < 1 << 30),
        "{limits}"
    );
    // The others are served meanwhile.
    server.open(bar_obj(4), "").await;
    waiting.abort();
    eventually("the process ends", async || children(server.id()).is_empty()).await;
}
