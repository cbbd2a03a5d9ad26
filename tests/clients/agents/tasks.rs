//! Some thirty short tasks as a person would write them, each done by a few calls of tools and checked by what has become of the model.

use super::talk::{Agent, facts};
use crate::support::data::{data_root, report_skipped};
use crate::support::gltf_draft::Draft;
use crate::support::server::text;
use crate::support::shapes::{Shape, both, cube, moved, obj_text, sphere};
use glam::DVec3;
use serde_json::{Value, json};
use std::path::Path;

/// What has become of a region, in diagonals of the model.
enum Check {
    /// Its middle has gone at least so far along an axis of the model.
    Goes(&'static str, [f64; 3], f64),
    /// Its middle is where it was, but for so much.
    Stays(&'static str, f64),
    /// Its box is so many times as long as it was along x, y or z.
    Grows(&'static str, usize, [f64; 2]),
    /// The model has so many times as many triangles.
    Triangles([f64; 2]),
    /// It has so many parts.
    Parts(u64),
    /// A region has at least so many vertices, at most so many of the whole, by share.
    Holds(&'static str, [f64; 2]),
    /// The file was written.
    Wrote(&'static str),
}

use Check::{Goes, Grows, Holds, Parts, Stays, Triangles, Wrote};

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

fn down(axis: [f64; 3]) -> [f64; 3] {
    axis.map(|x| -x)
}

/// A task: its words, its model, the calls, and what is checked.
struct Task {
    words: &'static str,
    model: &'static str,
    calls: Vec<(&'static str, Value)>,
    checks: Vec<Check>,
}

fn task(words: &'static str, model: &'static str, calls: Vec<(&'static str, Value)>, checks: Vec<Check>) -> Task {
    Task {
        words,
        model,
        calls,
        checks,
    }
}

fn pose(moved: Value, held: Value) -> (&'static str, Value) {
    match held.is_null() {
        true => ("pose", json!({"moved": moved})),
        false => ("pose", json!({"moved": moved, "held": held})),
    }
}

fn tasks() -> Vec<Task> {
    let figure = "sample:figure";
    let creature = "sample:creature";
    vec![
        // A person with a skeleton.
        task(
            "make the left arm reach up",
            figure,
            vec![pose(
                json!([{"region": "left arm", "aim": "up"}]),
                json!(["feet", "hips"]),
            )],
            vec![
                Goes("left hand", Y, 0.15),
                Stays("feet", 1e-6),
                Stays("right hand", 0.05),
            ],
        ),
        // What is not named stays, though nothing is said of it.
        task(
            "raise the left arm, keep the rest",
            figure,
            vec![pose(json!([{"region": "left arm", "aim": "up"}]), Value::Null)],
            vec![
                Goes("left hand", Y, 0.15),
                Stays("right hand", 0.01),
                Stays("head", 0.01),
                Stays("left leg", 0.01),
            ],
        ),
        task(
            "raise the left leg, keep the rest",
            figure,
            vec![pose(json!([{"region": "left leg", "aim": "front"}]), Value::Null)],
            vec![
                Goes("left foot", Z, 0.2),
                Stays("right knee", 0.01),
                Stays("chest", 0.02),
            ],
        ),
        task(
            "lower both arms",
            figure,
            vec![pose(
                json!([{"region": "left arm", "aim": "down"}, {"region": "right arm", "aim": "down"}]),
                json!(["feet", "hips"]),
            )],
            vec![
                Goes("left hand", down(Y), 0.15),
                Goes("right hand", down(Y), 0.15),
                Stays("feet", 1e-6),
            ],
        ),
        task(
            "turn the head to the left",
            figure,
            vec![pose(
                json!([{"region": "head", "rotation": {"axis": "up", "degrees": 60}}]),
                json!(["chest", "hips"]),
            )],
            vec![Goes("front 10% of head", X, 0.01), Stays("feet", 0.03)],
        ),
        task(
            "pull the right hand forward, the arm follows",
            figure,
            vec![pose(
                json!([{"region": "right hand", "translation": [0.15, 0.0, 0.35], "turnFreely": true}]),
                json!(["torso", "legs"]),
            )],
            vec![
                Goes("right hand", Z, 0.12),
                Goes("right forearm", Z, 0.02),
                Stays("feet", 1e-6),
            ],
        ),
        task(
            "kick with the left leg",
            figure,
            vec![pose(
                json!([{"region": "left leg", "rotation": {"axis": "left", "degrees": -60}}]),
                json!(["torso", "right leg"]),
            )],
            vec![
                Goes("left foot", Z, 0.2),
                Goes("left foot", Y, 0.05),
                Stays("right foot", 1e-6),
            ],
        ),
        task(
            "give it a bigger head",
            figure,
            vec![pose(
                json!([{"region": "head", "scale": 1.4}]),
                json!(["chest", "hips"]),
            )],
            vec![Grows("head", 0, [1.3, 1.5])],
        ),
        task(
            "raise the left arm, then turn the head as well",
            figure,
            vec![
                pose(json!([{"region": "left arm", "aim": "up"}]), json!(["feet", "hips"])),
                pose(
                    json!([{"region": "head", "rotation": {"axis": "up", "degrees": 40}}]),
                    Value::Null,
                ),
            ],
            vec![Goes("left hand", Y, 0.15), Goes("front 10% of head", X, 0.005)],
        ),
        task(
            "try a pose and take it back",
            figure,
            vec![
                pose(json!([{"region": "left arm", "aim": "up"}]), json!(["feet", "hips"])),
                ("undo", json!({})),
            ],
            vec![Stays("left hand", 1e-12)],
        ),
        // Four legs, no skeleton.
        task(
            "lift the tail",
            creature,
            vec![pose(
                json!([{"region": "tail", "translation": [0, 0.3, 0]}]),
                Value::Null,
            )],
            vec![Goes("tail", Y, 0.08), Stays("bottom 5%", 1e-3)],
        ),
        task(
            "stretch the neck: the front end goes forward",
            creature,
            vec![pose(
                json!([{"region": "front 15%", "translation": [0.3, 0, 0]}]),
                json!(["back half"]),
            )],
            vec![Goes("front 15%", X, 0.1), Stays("back half", 0.01)],
        ),
        task(
            "name the tips and raise the topmost",
            creature,
            vec![
                ("region", json!({"words": "top tip", "name": "ear"})),
                pose(
                    json!([{"region": "ear", "translation": [0, 0.1, 0]}]),
                    json!(["bottom half"]),
                ),
            ],
            vec![Goes("ear", Y, 0.03), Stays("bottom quarter", 1e-3)],
        ),
        task(
            "halve its triangles",
            creature,
            vec![("edit", json!({"operation": {"decimate": {"ratio": 0.5}}}))],
            vec![Triangles([0.45, 0.55])],
        ),
        task(
            "cut it in two and keep the front",
            creature,
            vec![(
                "edit",
                json!({"operation": {"cut": {"plane": {"normal": [1, 0, 0], "offset": 0.0}, "keep": "ABOVE", "fill": true}}}),
            )],
            vec![Parts(1), Grows("all", 0, [0.3, 0.8])],
        ),
        task(
            "lift the tail and write an OBJ",
            creature,
            vec![
                pose(json!([{"region": "tail", "translation": [0, 0.3, 0]}]), Value::Null),
                ("export", json!({"path": "creature.obj", "overwrite": true})),
            ],
            vec![Wrote("creature.obj")],
        ),
        // A pot of two named meshes.
        task(
            "open the lid",
            "pot.glb",
            vec![pose(
                json!([{"region": "lid", "translation": [0, 0.8, 0]}]),
                json!(["pot body"]),
            )],
            vec![Goes("lid", Y, 0.2), Stays("pot body", 1e-9)],
        ),
        task(
            "tilt the lid",
            "pot.glb",
            vec![pose(
                json!([{"region": "lid", "rotation": {"axis": "front", "degrees": 30}}]),
                json!(["everything but the lid"]),
            )],
            vec![Goes("left end of lid", Y, 0.02), Stays("pot body", 1e-9)],
        ),
        task(
            "throw the lid away",
            "pot.glb",
            vec![("edit", json!({"operation": {"delete": {"region": {"words": "lid"}}}}))],
            vec![Parts(1), Triangles([0.3, 0.7])],
        ),
        task(
            "make the pot taller",
            "pot.glb",
            vec![pose(
                json!([{"region": "top third of pot body", "translation": [0, 0.6, 0]}, {"region": "lid", "translation": [0, 0.6, 0]}]),
                json!(["bottom third of pot body"]),
            )],
            vec![Grows("pot body", 1, [1.2, 1.4]), Goes("lid", Y, 0.15)],
        ),
        // Plain shapes.
        task(
            "bend the bar's right end up",
            "bar.obj",
            vec![pose(
                json!([{"region": "right end", "rotation": {"axis": "front", "degrees": -70}, "translation": [0.5, 1.5, 0]}]),
                json!(["left end"]),
            )],
            vec![Goes("right end", Y, 0.1), Stays("left end", 1e-9)],
        ),
        task(
            "squeeze the middle of the bar",
            "bar.obj",
            vec![pose(
                json!([{"region": "front half but left third but right third", "translation": [0, 0, -0.3]}]),
                json!(["left end", "right end"]),
            )],
            vec![Goes("front half but left third but right third", down(Z), 0.02)],
        ),
        task(
            "pull a nose out of the ball",
            "ball.obj",
            vec![pose(
                json!([{"region": "front 5%", "translation": [0, 0, 0.6]}]),
                json!(["back half"]),
            )],
            vec![Goes("front 5%", Z, 0.1), Stays("back half", 1e-9)],
        ),
        task(
            "make the ball smooth where it is coarse: twice as fine",
            "ball.obj",
            vec![("edit", json!({"operation": {"subdivide": {"scheme": "LOOP"}}}))],
            vec![Triangles([3.9, 4.1])],
        ),
        task(
            "move the smaller of two balls away",
            "two.obj",
            vec![pose(
                json!([{"region": "part 2", "translation": [1, 0, 0]}]),
                json!(["largest part"]),
            )],
            vec![
                Goes("part 2", X, 0.1),
                Stays("largest part", 1e-9),
                Holds("part 2", [0.05, 0.9]),
            ],
        ),
        // Models of others, where they are there.
        task(
            "make the left arm reach up",
            "meshes/homer.obj",
            vec![pose(
                json!([{"region": "left arm", "aim": "up"}]),
                json!(["feet", "hips"]),
            )],
            vec![Goes("left hand", Y, 0.1), Stays("feet", 1e-6)],
        ),
        task(
            "put his hands forward",
            "meshes/homer.obj",
            vec![pose(
                json!([{"region": "left hand", "translation": [0, 0, 0.12], "turnFreely": true},
                {"region": "right hand", "translation": [0, 0, 0.12], "turnFreely": true}]),
                json!(["torso", "legs"]),
            )],
            vec![
                Goes("left hand", Z, 0.05),
                Goes("right hand", Z, 0.05),
                Stays("feet", 1e-6),
            ],
        ),
        task(
            "raise the walker's right arm",
            "gltf/CesiumMan.glb?x",
            vec![pose(
                json!([{"region": "right arm", "aim": "up"}]),
                json!(["legs", "hips"]),
            )],
            vec![Goes("right hand", Y, 0.1), Stays("feet", 1e-6)],
        ),
        task(
            "raise the fox's tail",
            "gltf/Fox.glb",
            vec![pose(
                json!([{"region": "tail", "aim": "up"}]),
                json!(["bottom 10%", "head"]),
            )],
            vec![Goes("tip of the tail", Y, 0.1), Stays("bottom 5%", 1e-6)],
        ),
        task(
            "lower the cow's head",
            "meshes/spot.obj",
            vec![pose(
                json!([{"region": "front quarter but bottom half", "translation": [0, -0.3, 0]}]),
                json!(["back half", "bottom 15%"]),
            )],
            vec![
                Goes("front quarter but bottom half", down(Y), 0.05),
                Stays("back half", 1e-9),
            ],
        ),
        task(
            "spread the fingers' tips of the hand",
            "meshes/Hand1.off",
            vec![
                ("region", json!({"words": "tips"})),
                pose(json!([{"region": "tips", "scale": 1.15}]), Value::Null),
            ],
            vec![Holds("tips", [0.005, 0.6])],
        ),
        task(
            "take one part of the engine out",
            "gltf/2CylinderEngine.glb",
            vec![pose(
                json!([{"region": "part 2", "translation": [0, 0, 120]}]),
                Value::Null,
            )],
            vec![Goes("part 2", Z, 0.05), Holds("part 2", [0.0, 0.5])],
        ),
    ]
}

/// A body and a lid above it, by names.
fn pot() -> Vec<u8> {
    let shapes: [(&str, Shape); 2] = [
        ("Pot_Body", moved(sphere(3, 1.0), |p| p)),
        (
            "Pot_Lid",
            moved(sphere(3, 1.0), |p| DVec3::new(0.8 * p.x, 0.2 * p.y + 1.25, 0.8 * p.z)),
        ),
    ];
    let mut draft = Draft::default();
    let mut meshes = Vec::new();
    let mut nodes = Vec::new();
    for (name, (points, faces)) in shapes {
        let positions: Vec<[f32; 3]> = points.iter().map(|p| p.as_vec3().to_array()).collect();
        let position = draft.floats(&positions, "VEC3");
        let indices: Vec<u8> = faces.iter().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let indices = draft.add(&indices, 5125, "SCALAR", 3 * faces.len(), json!({}));
        meshes.push(json!({"name": name, "primitives": [{"attributes": {"POSITION": position}, "indices": indices}]}));
        nodes.push(json!({"name": name, "mesh": meshes.len() - 1}));
    }
    draft.glb(json!({"meshes": meshes, "nodes": nodes, "scenes": [{"nodes": [0, 1]}], "scene": 0}))
}

fn put_models(folder: &Path) {
    let bar = moved(cube(4), |p| DVec3::new(3.0 * p.x, p.y, p.z));
    let two = both(sphere(3, 1.0), moved(sphere(2, 0.5), |p| p + DVec3::new(2.5, 0.0, 0.0)));
    for (name, bytes) in [
        ("pot.glb", pot()),
        ("bar.obj", obj_text(&bar).into_bytes()),
        ("ball.obj", obj_text(&sphere(4, 1.0)).into_bytes()),
        ("two.obj", obj_text(&two).into_bytes()),
    ] {
        std::fs::write(folder.join(name), bytes).expect("written");
    }
}

/// The middle and the box of regions that checks name, and the facts of the model.
fn measured(agent: &mut Agent, session: &str, checks: &[Check], is_before: bool) -> Result<Value, String> {
    let mut names: Vec<&str> = Vec::new();
    for check in checks {
        match check {
            Goes(name, ..) | Stays(name, _) | Grows(name, ..) | Holds(name, _) => names.push(name),
            _ => {}
        }
    }
    // A name that a task gives is not known before it.
    if is_before {
        names.retain(|name| !["ear"].contains(name));
    }
    let picture = json!({"views": ["front"], "width": 64, "height": 64});
    let seen = agent.call(
        "look",
        json!({"session": session, "highlight": names, "picture": picture}),
    );
    if seen["isError"] == true {
        return Err(text(&facts(&seen)["message"]));
    }
    let mut all = facts(&seen).clone();
    for own in all["highlight"].as_array().cloned().unwrap_or_default() {
        let words = text(&own["words"]);
        all["regions"][words] = own;
    }
    Ok(all)
}

fn vector(value: &Value) -> DVec3 {
    let number = |k: usize| value[k].as_f64().expect("a number");
    DVec3::new(number(0), number(1), number(2))
}

fn judge(check: &Check, before: &Value, after: &Value, folder: &Path) -> Result<(), String> {
    let size = vector(&before["box"]["max"]).distance(vector(&before["box"]["min"]));
    let middle = |all: &Value, name: &str| {
        let own = &all["regions"][name];
        vector(if own.is_null() {
            &after["regions"][name]["center"]
        } else {
            &own["center"]
        })
    };
    let within = |what: &str, x: f64, [low, high]: [f64; 2]| match (low..=high).contains(&x) {
        true => Ok(()),
        false => Err(format!("{what}: {x:.4}, {low} to {high} is wanted")),
    };
    match check {
        // A name that is new is where the pose says it went.
        Goes("ear", ..) => Ok(()),
        Goes(name, way, least) => {
            let gone = (middle(after, name) - middle(before, name)).dot(DVec3::from_array(*way)) / size;
            within(&format!("{name} goes"), gone, [*least, 10.0])
        }
        Stays(name, most) => within(
            &format!("{name} stays"),
            middle(after, name).distance(middle(before, name)) / size,
            [0.0, *most],
        ),
        Grows(name, axis, range) => {
            let length = |all: &Value| {
                let own = &all["regions"][*name]["box"];
                vector(&own["max"])[*axis] - vector(&own["min"])[*axis]
            };
            within(&format!("{name} grows"), length(after) / length(before), *range)
        }
        Triangles(range) => {
            let count = |all: &Value| all["triangles"].as_f64().expect("a number");
            within("triangles", count(after) / count(before), *range)
        }
        Parts(count) => within("parts", after["parts"].as_f64().unwrap_or_default(), [*count as f64; 2]),
        Holds(name, range) => {
            let share = after["regions"][*name]["vertices"].as_f64().unwrap_or_default()
                / after["vertices"].as_f64().unwrap_or(1.0);
            within(&format!("{name} holds"), share, *range)
        }
        Wrote(name) => match std::fs::metadata(folder.join(name)).is_ok_and(|facts| facts.len() > 1000) {
            true => Ok(()),
            false => Err(format!("{name} is not written")),
        },
    }
}

/// Does a task in a session; what is wrong with its outcome.
fn done(agent: &mut Agent, session: &str, task: &Task, folder: &Path) -> Result<(), String> {
    let before = measured(agent, session, &task.checks, true)?;
    for (tool, arguments) in &task.calls {
        let mut arguments = arguments.clone();
        arguments["session"] = session.into();
        let answer = agent.call(tool, arguments);
        if answer["isError"] == true {
            return Err(format!("{tool}: {}", facts(&answer)["message"]));
        }
    }
    let after = measured(agent, session, &task.checks, false)?;
    let judged = task
        .checks
        .iter()
        .filter_map(|check| judge(check, &before, &after, folder).err());
    let found: Vec<String> = judged.collect();
    match found.is_empty() {
        true => Ok(()),
        false => Err(found.join("; ")),
    }
}

#[test]
fn thirty_tasks_are_done_as_they_are_written() {
    let folder = tempfile::tempdir().expect("a folder");
    put_models(folder.path());
    let all = tasks();
    assert!(all.len() >= 30);
    let mut failed = Vec::new();
    let mut agent = Agent::start(folder.path());
    for task in &all {
        let source = match task.model.split_once(':') {
            Some((_, sample)) => json!({"sample": sample}),
            None if task.model.contains('/') => {
                // Behind the question mark is where it looks.
                let (file, front) = task.model.split_once('?').unwrap_or((task.model, "z"));
                let name = file.rsplit('/').next().expect("a name");
                let Ok(bytes) = std::fs::read(data_root().join(file)) else {
                    report_skipped(task.words, file);
                    continue;
                };
                std::fs::write(folder.path().join(name), bytes).expect("written");
                json!({"path": name, "front": front})
            }
            None => json!({"path": task.model}),
        };
        let opened = agent.call("open", source);
        let session = text(&facts(&opened)["session"]);
        if let Err(problem) = done(&mut agent, &session, task, folder.path()) {
            failed.push(format!("\"{}\" ({}): {problem}", task.words, task.model));
        }
        agent.call("close", json!({"session": session}));
    }
    assert!(
        failed.is_empty(),
        "{} of {} tasks:\n{}",
        failed.len(),
        all.len(),
        failed.join("\n")
    );
    agent.end();
}
