//! What the program says on its last line of stderr.

use super::Said;
use crate::support::commands::{Ran, Workplace, pliant_in};
use crate::support::server::rows;
use pliant::asset::sample;
use std::fs;
use std::net::TcpListener;
use std::process::Command;

const SQUARE: &str = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";

/// A triangle under a frame, a socket, and a joint of its skin.
const SCENE: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0, 1, 2]}],
    "nodes": [{"name": "frame", "mesh": 0, "skin": 0}, {"name": "socket"}, {"name": "bone"}], "skins": [{"joints": [2]}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"byteLength": 36, "uri": "data:application/octet-stream;base64,AAAAAAAAAAAAAAAAAACAPwAAAAAAAAAAAAAAAAAAgD8AAAAA"}]}"#;

const HELD: &str = r#"{"handles": [{"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}}], "expect": {"digest": "xxh3:0000000000000000"}}"#;

/// Provocation | the arguments of the program; PORT is one that is taken.
const CASES: &str = "
a report in place of a case            | check suite --html suite/turn.case.json --force
a report in place of a model's library | check suite --html suite/bar.mtl --force
a case that is none                    | check suite --case twist
a shard that is missing                | check --merge 1.json
a report of no shard                   | check --merge all.json
a primitive that is none               | render figure.glb -o p.png --primitive hat
a token that is over                   | token studio --expires 2001-01-31
a configuration without a store        | audit --config plain.toml
objects without a database             | store prune --data-dir half
no folder of sessions                  | audit --data-dir nothing
a port that is taken                   | serve --listen 127.0.0.1:PORT
an unknown key                         | serve --config slip.toml
a time without a unit                  | serve --config time.toml
an address that others reach           | serve --listen 0.0.0.0:0
a database without a place of objects  | serve --database postgres://db.example/pliant
a database that is none                | serve --data-dir kept --database mysql://db.example/pliant
a store that is taken                  | store prune --data-dir taken
a store that is not named              | store list
a store that is not there              | store check --data-dir nowhere
an unknown flag                        | serve --port 80
no such file                           | inspect bunny.glb
no model                               | inspect notes.txt
points alone                           | inspect points.obj
an extension that is none              | deform square.obj --job held.json -o out.dae
a format that is read only             | deform square.obj --job held.json -o out.fbx
a result that is there                 | deform square.obj --job held.json -o square.obj
no such folder                         | deform square.obj --job held.json -o new/out.obj
a field that is none                   | deform creature.glb --job slip.json -o out.glb
a file that lies outside               | deform creature.glb --job outside.json -o out.glb
a device                               | inspect /dev/zero
a region beside the model              | deform creature.glb --job away.json -o out.glb
a chain that is none                   | deform figure.glb --job chain.json -o out.glb
a node that is not there               | deform scene.gltf --job hook.json -o out.glb
a node beyond the last                 | deform scene.gltf --job far.json -o out.glb
a joint that is to ride along          | deform scene.gltf --job bone.json -o out.glb
a node of a format without nodes       | deform square.obj --job far.json -o out.obj
another digest                         | deform creature.glb --job held.json -o out.glb
";

pub fn provoke() -> Vec<Said> {
    let folder = Workplace::new();
    let write = |name: &str, text: &str| folder.put(name, text);
    write("square.obj", SQUARE);
    write("points.obj", "v 0 0 0\nv 1 0 0\n");
    write("notes.txt", "no model");
    write("held.json", HELD);
    write("slip.json", r#"{"handles": [{"id": "head", "regoin": {}}]}"#);
    write(
        "outside.json",
        r#"{"steps": [{"edit": {"merge": {"file": "/etc/passwd"}}}]}"#,
    );
    write(
        "away.json",
        r#"{"handles": [{"id": "head", "region": {"sphere": {"center": [9, 9, 9], "radius": 1}}}]}"#,
    );
    folder.put("figure.glb", sample::figure_glb());
    write("chain.json", r#"{"create": {"rigidChains": ["tail"]}}"#);
    write("plain.toml", "sessions = 4\n");
    write("slip.toml", "sessons = 4\n");
    write("time.toml", "ttl = \"15\"\n");
    let taken = TcpListener::bind("127.0.0.1:0").expect("a port");
    let port = taken.local_addr().expect("an address").port().to_string();

    write("scene.gltf", SCENE);
    for (name, node) in [
        ("hook", r#""nodesNamed": "hook""#),
        ("far", r#""node": 7"#),
        ("bone", r#""node": 2"#),
    ] {
        let job = format!(r#"{{"create": {{"passengers": [{{{node}}}]}}}}"#);
        write(&format!("{name}.json"), &job);
    }

    let taken_store = folder.path().join("taken");
    fs::create_dir(&taken_store).expect("a folder");
    let lock = fs::File::create(taken_store.join("lock")).expect("a lock");
    rustix::fs::flock(&lock, rustix::fs::FlockOperation::LockExclusive).expect("locked");
    fs::write(taken_store.join("sessions.sqlite"), "").expect("written");
    fs::create_dir(folder.path().join("nothing")).expect("a folder");
    fs::create_dir_all(folder.path().join("half/objects/00")).expect("a folder");
    folder.put("half/objects/00/object", "");

    fs::create_dir(folder.path().join("suite")).expect("a folder");
    write("suite/bar.obj", &format!("mtllib bar.mtl\n{SQUARE}"));
    write("suite/bar.mtl", "newmtl a\n");
    write("suite/bend.case.json", r#"{"model": "bar.obj", "job": {}}"#);
    write("suite/turn.case.json", r#"{"model": "bar.obj", "job": {}}"#);
    for report in ["1.json --shard 1/2", "all.json"] {
        folder.done(&format!("check suite --exit-zero --report {report}"));
    }

    let last_line = |command: &mut Command| {
        let ran = Ran::of(command);
        assert_ne!(ran.code, Some(0), "{command:?} did not fail");
        ran.last().replace(&port, "7411")
    };
    let said = rows(CASES).map(|[by, arguments]| Said {
        by,
        text: last_line(&mut pliant_in(folder.path(), &arguments.replace("PORT", &port))),
    });
    let slip = Said {
        by: "a variable that is called as a key and is none",
        text: last_line(pliant_in(folder.path(), "serve").env("PLIANT_MEMRY_BYTES", "1GiB")),
    };
    said.chain([slip]).collect()
}
