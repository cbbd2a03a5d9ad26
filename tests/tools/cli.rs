//! The command line as a script sees it: exit codes, the last line of stderr, one document on stdout, no output on refusal.

use crate::inspections::SQUARE;
use crate::support::commands::{Ran, Workplace, on_a_terminal, pliant_in};
use pliant::asset::{FileSet, Format, Limits, Model, sample};
use serde_json::Value;
use std::fs;
use std::path::Path;

#[test]
fn a_sample_is_written_where_it_may_be() {
    let folder = Workplace::new();
    folder.done("sample figure -o figure.glb");
    assert_eq!(folder.bytes("figure.glb"), sample::figure_glb());
    let written = || {
        fs::metadata(folder.at("figure.glb"))
            .and_then(|facts| facts.modified())
            .expect("a file")
    };
    let before = written();
    let again = folder.done("sample figure -o figure.glb");
    assert_eq!(again.last(), "", "the same bytes are there");
    assert_eq!(written(), before, "and are left alone");
    for (arguments, reply) in [
        ("sample dragon -o dragon.glb", "expected one of: creature, figure, body"),
        ("sample body -o figure.glb", "--force"),
        ("sample figure -o figure.obj", "written as glb"),
        ("sample boxing -o boxing.glb", "written as bvh"),
        ("sample dragon -o dragon.bvh", "body, boxing, ballet, twist"),
    ] {
        folder.refused(arguments, &[reply]);
    }
}

const JOB: &str = r#"{
  "handles": [
    {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
    {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}}}],
  "steps": [{"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, 0.8, 0]}}]}}]}"#;

#[test]
fn a_refusal_is_exit_2_with_its_reason_last_and_no_output() {
    let folder = Workplace::new();
    folder.put("job.json", JOB);
    folder.put("unknown.json", r#"{"handles": [{"id": "a", "regoin": {}}]}"#);
    folder.put("edit.json", r#"{"steps": [{"edit": {"weld": {}}}]}"#);
    folder.put("refine.json", r#"{"options": {"refine": 1001}}"#);
    folder.put(
        "empty.json",
        r#"{"handles": [{"id": "a", "region": {"sphere": {"center": [99, 0, 0], "radius": 1}}}]}"#,
    );
    folder.put("nobody.json", r#"{"handles": [], "steps": [{"pose": {}}]}"#);
    folder.put("broken.obj", "v 0 0 nan\nf 1 1 1\n");
    let cases: [(&str, &str); 11] = [
        ("frobnicate", "frobnicate"),
        ("deform creature.glb", "--job"),
        ("deform none.glb --job job.json -o out.glb", "none.glb"),
        ("deform creature.glb --job none.json -o out.glb", "none.json"),
        (
            "deform creature.glb --job job.json -o out.xyz",
            "glb, gltf, obj, ply, off, stl, 3mf, splat and spz",
        ),
        ("deform creature.glb --job unknown.json -o out.glb", "handles[0].regoin"),
        (
            "deform creature.glb --job edit.json -o out.glb",
            "steps[0].weld.tolerance",
        ),
        ("deform creature.glb --job refine.json -o out.glb", "options.refine"),
        ("deform creature.glb --job empty.json -o out.glb", "handles[0].region"),
        ("deform creature.glb --job nobody.json -o out.glb", "no handles"),
        ("inspect broken.obj", "line 1"),
    ];
    for (arguments, reason) in cases {
        let ran = folder.refused(arguments, &[]);
        let (stdout, last) = (&ran.out, ran.last());
        assert!(
            last.starts_with("pliant: ") && last.contains(reason),
            "{arguments:?}: {last}"
        );
        assert!(stdout.is_empty(), "{arguments:?} printed {stdout}");
        let left = fs::read_dir(folder.path()).expect("a folder").flatten();
        assert!(
            !left
                .into_iter()
                .any(|f| f.file_name().to_string_lossy().starts_with("out")),
            "{arguments:?}"
        );
    }
}

#[test]
fn a_report_is_one_document_and_its_digest_is_the_same_for_any_thread_count() {
    let folder = Workplace::new();
    folder.put("job.json", JOB);
    let digest = |threads: &str| {
        let line = format!("deform creature.glb --job job.json -o out.glb --force --json --threads {threads}");
        let report = folder.done(&line).json();
        assert_eq!(report["steps"][0]["kind"], "pose");
        assert!(
            report["steps"][0]["residual"].as_f64().is_some_and(|r| r <= 1e-4),
            "{report}"
        );
        assert_eq!(report["quality"]["flippedTriangles"], 0);
        (report["digest"].clone(), folder.bytes("out.glb"))
    };
    let one = digest("1");
    assert!(one.0.as_str().is_some_and(|d| d.starts_with("xxh3:") && d.len() == 21));
    assert!(
        one == digest("2") && one == digest("3"),
        "bytes and digest are the same"
    );
}

#[test]
fn a_job_can_ask_for_the_papers_operators() {
    let folder = Workplace::new();
    let paper = JOB.replacen('{', r#"{"create": {"operators": "PAPER"},"#, 1);
    let report = |name: &str, text: &str| {
        folder.put(name, text);
        folder
            .done(&format!("deform creature.glb --job {name} -o out.glb --json --force"))
            .json()
    };
    let (ours, theirs) = (report("job.json", JOB), report("paper.json", &paper));
    assert_eq!(ours["steps"][0]["solver"], "multigrid");
    let method = theirs["steps"][0]["solver"].as_str();
    assert!(
        matches!(method, Some("paper-cycles" | "conjugate-gradients")),
        "{theirs}"
    );
    assert!(theirs["steps"][0]["residual"].as_f64().is_some_and(|r| r <= 1e-4));
    assert_eq!(theirs["quality"]["flippedTriangles"], 0);
}

#[test]
fn a_job_without_steps_says_so() {
    let folder = Workplace::new();
    folder.put("job.json", "{}");
    let ran = folder.run("deform creature.glb --job job.json -o out.glb");
    assert_eq!(ran.code, Some(0), "{}", ran.err);
    assert!(ran.err.contains("the job has no steps"), "{}", ran.err);
    folder.put("job.json", JOB);
    let ran = folder.run("deform creature.glb --job job.json -o bent.glb");
    assert!(ran.code == Some(0) && !ran.err.contains("no steps"), "{}", ran.err);
}

#[test]
fn every_step_of_a_job_is_written_where_it_is_asked_for() {
    let folder = Workplace::new();
    let job = r#"{
      "handles": [
        {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
        {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}}}],
      "steps": [
        {"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, 0.4, 0]}}]}},
        {"edit": {"subdivide": {"region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.2}}}}},
        {"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, 0.8, 0]}}]}}]}"#;
    folder.put("job.json", job);
    let line = |more: &str| format!("deform creature.glb --job job.json --json -o turned.obj --steps steps {more}");
    folder.refused(&line(""), &["--parents makes it"]);
    let report = folder.done(&line("--parents")).json();
    let read = |name: &str| folder.bytes(name);
    let steps = [0, 1, 2].map(|k| read(&format!("steps/step_{k:05}.obj")));
    assert_eq!(steps[2], read("turned.obj"), "the last step is the result");
    let vertices = |obj: &[u8]| {
        String::from_utf8_lossy(obj)
            .lines()
            .filter(|l| l.starts_with("v "))
            .count()
    };
    assert!(vertices(&steps[0]) < vertices(&steps[1]) && steps[1] != steps[2]);
    assert_eq!(
        report["output"].as_array().map(Vec::len),
        Some(4),
        "{}",
        report["output"]
    );
    folder.done(&line("--force"));
    let twice = "deform creature.glb --job job.json -o step_00000.obj --steps .";
    folder.refused(twice, &["where the result is written"]);
}

#[test]
fn an_expectation_that_does_not_hold_is_exit_1() {
    let folder = Workplace::new();
    let strict = JOB.replacen('{', r#"{"expect": {"digest": "xxh3:0000000000000000"},"#, 1);
    folder.put("job.json", strict);
    let ran = folder.run("deform creature.glb --job job.json -o out.glb").exits(1);
    ran.gives(&["digest is xxh3:"]);
}

#[test]
fn a_job_that_expects_no_new_crossings_has_them_counted() {
    let folder = Workplace::empty();
    // A sheet, and a blade beside it.
    let mut model = String::new();
    for v in 0..25 {
        model += &format!("v {} {} 0\n", v / 5 - 2, v % 5 - 2);
    }
    for v in (1..20).filter(|v| v % 5 != 0) {
        model += &format!("f {v} {} {} {}\n", v + 5, v + 6, v + 1);
    }
    model += "v 3 -1.1 -0.5\nv 3 0.7 -0.5\nv 3 0.7 0.5\nf 26 27 28\n";
    folder.put("model.obj", model);
    let job = |x: f64, most: u32| {
        format!(
            r#"{{"handles": [{{"id": "sheet", "region": {{"component": {{"index": 0}}}}}},
                 {{"id": "blade", "region": {{"component": {{"index": 1}}}}, "pose": {{"translation": [{x}, 0, 0]}}}}],
                "expect": {{"newSelfIntersections": {most}}}}}"#
        )
    };
    let run = |job: String, code: i32| {
        folder.put("job.json", job);
        folder
            .run("deform model.obj --job job.json -o out.obj --force --json")
            .exits(code)
    };
    let ran = run(job(-2.7, 0), 1);
    ran.gives(&["newSelfIntersections is ", ", at most 0 expected"]);
    let crossing = ran.json()["quality"]["newSelfIntersections"].as_u64().expect("a count");
    assert!((1..20).contains(&crossing), "{crossing}");
    run(job(-2.7, crossing as u32), 0);
    let apart = run(job(-0.5, 0), 0).json();
    assert_eq!(apart["quality"]["newSelfIntersections"], 0);
}

#[test]
fn what_rides_along_is_reported_and_written_beside_the_result() {
    let folder = Workplace::new();
    // A plate over the head, and one under the feet.
    folder.put("hat.obj", "v 0.7 1.6 0\nv 0.8 1.6 0\nv 0.75 1.6 0.1\nf 1 2 3\n");
    folder.put("floor.obj", "v -0.1 -0.1 0\nv 0.1 -0.1 0\nv 0 -0.1 0.1\nf 1 2 3\n");
    let passengers = |extra: &str| {
        let create = format!(
            r#"{{"create": {{"passengers": [
                {{"name": "crown", "points": {{"positions": [0.76, 1.6, 0, 0, -0.1, 0], "rotations": [0, 0, 0, 1, 0, 0, 0, 1]}}}},
                {{"name": "hat", "file": {{"file": "hat.obj", "output": "beside/hat.ply"}}}},
                {{"file": {{"file": "floor.obj", "output": "floor.obj"}}}}{extra}]}},"#
        );
        JOB.replacen('{', &create, 1)
    };
    folder.put("job.json", passengers(""));
    let job = "deform creature.glb --job job.json -o results/out.glb --json --parents";
    let report = folder.done(job).json();
    let crown = &report["passengers"][0];
    let numbers = |name: &str| -> Vec<f64> {
        let list = crown[name].as_array().expect("a list");
        list.iter().filter_map(Value::as_f64).collect()
    };
    assert_eq!(crown["name"], "crown");
    let (positions, rotations) = (numbers("positions"), numbers("rotations"));
    assert!(
        (positions[1] - 1.6).abs() < 0.02 && positions[0] != 0.76,
        "{positions:?}"
    );
    // The head turns by 0.8 about the vertical axis, the feet stay.
    let angle = 2.0 * (rotations[1] / rotations[3]).atan();
    assert!((angle - 0.8).abs() < 0.1, "{rotations:?}");
    assert!(
        (positions[4] + 0.1).abs() < 0.05 && rotations[7].abs() > 0.99,
        "{positions:?} {rotations:?}"
    );
    assert_eq!(report["passengers"][1]["output"], "beside/hat.ply");
    assert!(folder.bytes("results/beside/hat.ply").starts_with(b"ply"));
    assert_ne!(folder.bytes("results/floor.obj"), b"", "{report}");
    assert_eq!(report["output"].as_array().map(Vec::len), Some(3));

    let output = "passengers[3].file.output";
    for (extra, reason) in [
        (r#"{"file": {"file": "hat.obj", "output": "floor.obj"}}"#, output),
        (r#"{"file": {"file": "hat.obj", "output": "../hat.obj"}}"#, output),
        (r#"{"file": {"file": "hat.obj", "output": "out.glb"}}"#, output),
        (r#"{"file": {"file": "none.obj", "output": "none.obj"}}"#, "none.obj"),
        (
            r#"{"file": {"file": "job.json", "output": "job.obj"}}"#,
            "passengers[3].file",
        ),
        (r#"{"primitive": 7}"#, "passengers[3]"),
        (r#"{"primitivesNamed": "nobody"}"#, "passengers[3]"),
        (r#"{}"#, "passengers[3]"),
    ] {
        folder.put("wrong.json", passengers(&format!(", {extra}")));
        folder.refused(
            "deform creature.glb --job wrong.json -o none/out.glb --parents",
            &[reason],
        );
        assert!(!folder.path().join("none").exists(), "{extra} left something behind");
    }
}

#[test]
fn every_region_of_the_page_is_taken() {
    let folder = Workplace::new();
    folder.put("square.obj", SQUARE.replace("mtllib square.mtl\n", ""));
    let page = Path::new(env!("CARGO_MANIFEST_DIR")).join("deploy/docs/concepts.md");
    let page = fs::read_to_string(page).expect("the page");
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `{\""));
    let mut kinds = Vec::new();
    for row in rows {
        let (region, _) = row.split_once("` |").expect("a cell");
        let region = format!("{{\"{region}");
        let value: Value = serde_json::from_str(&region).unwrap_or_else(|e| panic!("{region}: {e}"));
        kinds.extend(value.as_object().into_iter().flatten().map(|(kind, _)| kind.clone()));
        let job =
            format!(r#"{{"handles": [{{"id": "a", "region": {region}, "pose": {{"translation": [1, 0, 0]}}}}]}}"#);
        folder.put("job.json", job);
        let arguments = "deform square.obj --job job.json -o out.obj --force";
        let said = folder.done(arguments).err;
        assert!(!said.contains("idle-handle"), "{region}: {said}");
    }
    let all = "vertices halfSpace sphere box capsule tube component primitive weights";
    assert_eq!(kinds.join(" "), all);
}

#[test]
fn a_handle_that_holds_nothing_and_is_moved_is_warned_of() {
    let folder = Workplace::new();
    let job = |order: [&str; 2]| {
        let handle = |id: &str| {
            let radius = if id == "all" { 9.0 } else { 0.36 };
            format!(r#"{{"id": "{id}", "region": {{"sphere": {{"center": [0.76, 1.22, 0], "radius": {radius}}}}}}}"#)
        };
        let handles = order.map(handle).join(", ");
        format!(
            r#"{{"handles": [{handles}],
              "steps": [{{"pose": {{"handles": [{{"id": "head", "pose": {{"translation": [0, 0.5, 0]}}}}]}}}}]}}"#
        )
    };
    for (order, is_idle) in [(["head", "all"], true), (["all", "head"], false)] {
        folder.put("job.json", job(order));
        let arguments = "deform creature.glb --job job.json -o out.glb --force";
        let said = folder.done(arguments).err;
        assert_eq!(said.contains("warning idle-handle: "), is_idle, "{said}");
        assert!(
            !is_idle || said.contains("a step moves handle \"head\", which holds nothing"),
            "{said}"
        );
    }
}

#[test]
fn help_and_version_are_answers() {
    let folder = Workplace::new();
    for arguments in ["--help", "--version", "deform --help", "render --help"] {
        let stdout = folder.done(arguments).out;
        assert!(stdout.contains("pliant"), "{stdout}");
    }
    let found = folder.done("inspect creature.glb --json").json();
    assert_eq!((&found["closed"], &found["components"]), (&true.into(), &1.into()));
}

#[test]
fn wrong_usage_has_one_reason_in_one_line() {
    for (arguments, reason, listed_by) in [
        (
            "deform creature.glb --jobb job.json",
            "'--jobb'",
            "pliant deform --help",
        ),
        ("render creature.glb", "required arguments", "pliant render --help"),
        ("bend", "'bend'", "pliant --help"),
        ("", "no command is named", "Usage: pliant"),
        ("store", "no command is named", "Usage: pliant store"),
    ] {
        let ran = Workplace::empty().refused(arguments, &[reason]);
        assert_eq!(ran.out, "", "{arguments:?}");
        let err = ran.err;
        assert_eq!(err.matches(reason).count(), 1, "{err}");
        assert!(err.contains(listed_by), "{err}");
        assert!(listed_by.starts_with("Usage") || err.lines().count() == 1, "{err}");
    }
}

#[test]
fn arguments_of_other_programs_are_answered_with_those_of_this_one() {
    let folder = Workplace::new();
    for (arguments, hint) in [
        ("defrom creature.glb", "'defrom'; a similar subcommand exists: 'deform'"),
        ("deform creature.glb job.json -o x.glb", "a job is named by --job FILE"),
        ("serve --port 80", "--listen ADDRESS:PORT"),
        ("animate creature.glb clip.bvh", "a clip is named by --bvh FILE"),
        (
            "render creature.glb -o x.png --view frnt",
            "30,20, and front, back, side",
        ),
    ] {
        folder.refused(arguments, &[hint]);
    }
    let picture = |view: &str, name: &str| {
        let arguments = ["render", "creature.glb", "-o", name, "--size", "64x64", "--view", view];
        folder.done(&arguments);
        folder.bytes(name)
    };
    assert_eq!(picture("top", "top.png"), picture("0,90", "same.png"));
    folder.put("clip.bvh", "HIERARCHY\nROOT hips\n");
    folder.refused(
        "render clip.bvh -o clip.png",
        &["it is a BVH clip, not a model; `pliant animate MODEL --bvh clip.bvh`"],
    );
}

#[test]
fn a_variable_that_is_called_as_a_key_and_is_none_stops_the_server() {
    let serve = |name: &str, value: &str| {
        Ran::of(pliant_in(Path::new("."), "serve --listen nowhere").env(name, value)).exits(2)
    };
    serve("PLIANT_MEMRY_BYTES", "1GiB").gives(&[
        "environment variable PLIANT_MEMRY_BYTES is not a key of the configuration; did you mean PLIANT_MEMORY_BYTES?",
    ]);
    serve("PLIANT_ZEBRA", "1").gives(&["PLIANT_ZEBRA", "pliant serve --help"]);
    // What the clients, the tests and Kubernetes set is left alone: the address is what is refused.
    for (name, value) in [
        ("PLIANT_DATA", "/data"),
        ("PLIANT_SERVER", "http://h"),
        ("PLIANT_PORT", "tcp://10.0.0.1:7411"),
    ] {
        serve(name, value).gives(&["nowhere"]);
    }
}

#[test]
fn a_terminal_sees_which_stage_is_under_way_and_how_far() {
    let folder = Workplace::new();
    let script = "import pty, sys; sys.exit(pty.spawn(sys.argv[1:]) >> 8)";
    let Some((code, drawn)) = on_a_terminal(&folder, script, &["inspect", "creature.glb"]) else {
        return;
    };
    assert_eq!(code, Some(0), "{drawn}");
    assert!(drawn.contains("graph") && drawn.contains(" %"), "{drawn}");
    let piped = folder.done("inspect creature.glb");
    assert!(
        !piped.out.contains(" %") && piped.last().is_empty(),
        "only people are shown stages: {}",
        piped.err
    );
    // A log has them as lines, where that is asked for, beside the one document of stdout.
    let logged = folder.done("inspect creature.glb --progress plain --json");
    let lines: Vec<&str> = logged.err.lines().collect();
    assert!(
        lines.iter().any(|line| line.starts_with("pliant: graph")) && lines.iter().all(|line| line.ends_with(" s)")),
        "{}",
        logged.err
    );
    assert!(logged.json().is_object());
    let script = "import pty, sys; sys.exit(pty.spawn(sys.argv[1:]) >> 8)";
    if let Some((_, drawn)) = on_a_terminal(&folder, script, &["inspect", "creature.glb", "--progress", "none"]) {
        assert!(!drawn.contains(" %"), "{drawn}");
    }
}

#[test]
fn work_goes_on_where_nothing_reads_what_is_reported() {
    let folder = Workplace::new();
    folder.put("job.json", JOB);
    let (unread, stderr) = std::io::pipe().expect("a pipe");
    drop(unread);
    let arguments = "deform creature.glb --job job.json -o out.glb --progress plain";
    let ended = pliant_in(folder.path(), arguments).stderr(stderr).status();
    assert_eq!(ended.expect("it runs").code(), Some(0), "as `2>&1 | head` does");
    assert!(folder.at("out.glb").exists());

    // Nor is a document that nothing reads a failure; one that cannot be written is.
    let arguments = "deform creature.glb --job job.json -o read.glb --json";
    let (unread, stdout) = std::io::pipe().expect("a pipe");
    drop(unread);
    let ended = pliant_in(folder.path(), arguments)
        .stdout(stdout)
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(0), "as `--json | head` does: {said}");
    assert!(folder.at("read.glb").exists() && !said.contains("pliant: "), "{said}");
    let Ok(full) = std::fs::File::options().write(true).open("/dev/full") else {
        return;
    };
    let ended = pliant_in(folder.path(), "inspect creature.glb --json")
        .stdout(full)
        .output()
        .expect("it runs");
    let said = String::from_utf8_lossy(&ended.stderr).into_owned();
    assert_eq!(ended.status.code(), Some(3), "{said}");
    assert!(said.contains("cannot write to stdout"), "{said}");
}

#[test]
fn a_command_that_fails_says_why_in_the_document_that_was_asked_for() {
    let folder = Workplace::new();
    folder.put("job.json", r#"{"handels": []}"#);
    let cases: [(&str, &str); 6] = [
        ("deform creature.glb --job job.json -o out.glb", "handels"),
        ("deform creature.glb --job none.json -o out.glb", "none.json"),
        ("deform creature.glb", "--job"),
        ("inspect none.glb", "none.glb"),
        ("rig creature.glb --preset cmu -o rig.txt", "rig.txt"),
        ("store list --data-dir none", "no store of sessions"),
    ];
    for (arguments, word) in cases {
        let plain = folder.refused(arguments, &[word]);
        assert_eq!(plain.out, "", "{arguments:?}");
        let ran = folder.run(&format!("{arguments} --json"));
        assert_eq!((ran.code, ran.last()), (Some(2), plain.last()), "{arguments:?}");
        let (document, out, last) = (ran.json(), &ran.out, ran.last());
        let error = &document["error"];
        assert_eq!(
            (&error["kind"], &error["exitCode"]),
            (&"input".into(), &2.into()),
            "{out}"
        );
        let message = error["message"].as_str().expect("a text");
        assert!(message.contains(word) && last == format!("pliant: {message}"), "{out}");
    }
}

#[test]
fn a_check_that_does_not_hold_prints_its_report_and_nothing_more() {
    let folder = Workplace::new();
    let job = r#"{"expect": {"digest": "xxh3:0000000000000000"}}"#;
    folder.put("job.json", job);
    let arguments = "deform creature.glb --job job.json -o out.glb --json";
    let report = folder.run(arguments).exits(1).json();
    assert!(
        report["digest"].is_string() && report.get("error").is_none(),
        "{report}"
    );
}

#[test]
fn a_figure_gets_its_rig_along_any_axis_and_what_is_none_a_picture() {
    let folder = Workplace::empty();
    folder.done("sample body -o body.glb");
    let bytes = folder.bytes("body.glb");
    let model = Model::read(FileSet::single("body.glb", bytes), None, &Limits::default()).expect("readable");
    let rig = |name: &str, options: &str, turned: fn([f64; 3]) -> [f64; 3]| {
        let places: Vec<_> = model.positions.iter().map(|p| turned(p.to_array()).into()).collect();
        let written = model.write(&places, Format::STL).expect("writable");
        folder.put(name, written.main);
        folder.run(&format!("rig {name} -o rig.json --force --json {options}"))
    };
    let upright = rig("upright.stl", "", |p| p).exits(0).json();
    assert_eq!((&upright["up"], &upright["front"]), (&"y".into(), &"z".into()));
    assert!(upright["score"].as_f64().expect("a score") > 0.9, "{upright}");
    let lying: fn([f64; 3]) -> [f64; 3] = |[x, y, z]| [x, -z, y];
    for options in ["", "--up z", "--up z --front -y", "--front=-y"] {
        let found = rig("lying.stl", options, lying).exits(0).json();
        assert_eq!(
            (&found["up"], &found["front"]),
            (&"z".into(), &"-y".into()),
            "{options}"
        );
        let written: serde_json::Value = serde_json::from_slice(&folder.bytes("rig.json")).expect("JSON");
        assert_eq!(written["up"], "z", "{options}");
        let joints = |report: &serde_json::Value| report["joints"].as_array().expect("joints").clone();
        for (own, other) in joints(&upright).iter().zip(joints(&found)) {
            let place = |joint: &serde_json::Value| [0, 1, 2].map(|k| joint["at"][k].as_f64().expect("a number"));
            let (wanted, at) = (lying(place(own)), place(&other));
            let off = (0..3).map(|k| (wanted[k] - at[k]).abs()).fold(0.0, f64::max);
            assert!(own["name"] == other["name"] && off < 0.02, "{options}: {own} {other}");
        }
    }
    rig("lying.stl", "--up z --front z", lying)
        .exits(2)
        .gives(&["--front: is z"]);
    // Standing on its side it is not a figure, and the picture shows why.
    rig("lying.stl", "--up x --picture why.png", lying).exits(2).gives(&[
        "with x up",
        "--at NAME=x,y,z",
        "why.png shows them in red",
    ]);
    assert!(folder.bytes("why.png").starts_with(b"\x89PNG"));
    rig("ball.stl", "", |[x, y, z]| {
        let length = (x * x + y * y + z * z).sqrt().max(1e-6);
        [x / length, y / length, z / length]
    })
    .exits(2)
    .gives(&["joints are not sure"]);
}
