//! `pliant rig` as a script sees it: what it finds drives a model at the first try.

use crate::support::commands::Workplace;
use crate::support::data::{data_folder, data_path, files_below};
use crate::support::skinning::list;
use pliant::asset::sample::BuiltInModel;
use serde_json::Value;
use std::fs;

/// A folder with the built-in figure.
fn figure_folder() -> Workplace {
    let folder = Workplace::empty();
    folder.put("figure.glb", BuiltInModel::Figure.glb());
    folder
}

/// The report of a run that ends well.
fn run_well(folder: &Workplace, arguments: &str) -> Value {
    folder.done(arguments).json()
}

/// A joint of a report.
fn joint<'a>(report: &'a Value, name: &str) -> &'a Value {
    list(&report["joints"]).iter().find(|j| j["name"] == name).expect(name)
}

/// A recording of a person in names of one's own, who bends an elbow and a knee.
fn make_clip(names: [&str; 6]) -> String {
    let [hips, chest, upper, fore, thigh, shin] = names;
    let three = "CHANNELS 3 Zrotation Xrotation Yrotation\n";
    let limb = |first: String, second: String, at: &str, along: &str, end: &str| {
        format!(
            "JOINT {first}\n{{\nOFFSET {at}\n{three}JOINT {second}\n{{\nOFFSET {along}\n{three}JOINT {first}End\n{{\nOFFSET {along}\n{three}\
             End Site\n{{\nOFFSET {end}\n}}\n}}\n}}\n}}\n"
        )
    };
    let side = |name: &str, side: &str| name.replace('*', side);
    let mut text = format!(
        "HIERARCHY\nROOT {hips}\n{{\nOFFSET 0 0 0\nCHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n\
         JOINT {chest}\n{{\nOFFSET 0 40 0\n{three}JOINT neck\n{{\nOFFSET 0 20 0\n{three}End Site\n{{\nOFFSET 0 25 0\n}}\n}}\n"
    );
    for (name, sign) in [("L", ""), ("R", "-")] {
        let (at, along, end) = (
            format!("{sign}18 12 0"),
            format!("{sign}27 0 0"),
            format!("{sign}15 0 0"),
        );
        text += &limb(side(upper, name), side(fore, name), &at, &along, &end);
    }
    text += "}\n";
    for (name, sign) in [("L", ""), ("R", "-")] {
        text += &limb(
            side(thigh, name),
            side(shin, name),
            &format!("{sign}10 -5 0"),
            "0 -42 0",
            "0 -5 15",
        );
    }
    text += "}\nMOTION\nFrames: 3\nFrame Time: 0.1\n";
    for k in 0..3 {
        let bend = 20 * k;
        // Hips, chest, neck, then four limbs of three joints.
        text += "0 90 0 0 0 0 0 0 0 0 0 0 ";
        for limb in 0..4 {
            text += &if limb < 2 {
                format!("0 0 0 0 {bend} 0 0 0 0 ")
            } else {
                format!("0 {bend} 0 0 {bend} 0 0 0 0 ")
            };
        }
        text += "\n";
    }
    text
}

#[test]
fn every_recording_drives_the_figure_at_the_first_try() {
    let folder = &figure_folder();
    let mut clips = Vec::new();
    for (k, names) in [
        ["Hips", "Chest", "*_UpperArm", "*_LowerArm", "*_Thigh", "*_Shin"],
        ["a", "b", "c*", "d*", "e*", "f*"],
    ]
    .into_iter()
    .enumerate()
    {
        let path = folder.join(format!("made_{k}.bvh"));
        fs::write(&path, make_clip(names)).expect("written");
        clips.push(path);
    }
    if let Some(data) = data_folder("recordings on the figure") {
        let recordings = files_below(&data.join("bvh"), |path| path.extension().is_some_and(|e| e == "bvh"));
        assert!(recordings.len() > 10);
        clips.extend(recordings);
    }
    for clip in &clips {
        let clip = clip.to_str().expect("a path");
        let rig = run_well(
            folder,
            &format!("rig figure.glb --bvh {clip} -o rig.json --no-picture --force --json"),
        );
        let bones = rig["bones"].as_array().expect("bones");
        assert!(bones.len() >= 9, "{clip}: {rig}");
        let reported = run_well(
            folder,
            &format!("animate figure.glb --bvh {clip} --rig rig.json --frames 0:2 --json"),
        );
        for frame in reported["frames"].as_array().expect("frames") {
            let volume = frame["volumeChange"].as_f64().unwrap_or(0.0);
            let edges = frame["edgeRms"].as_f64().unwrap_or(0.0);
            assert!(
                volume.abs() < 0.25 && edges < 0.35,
                "{clip}: volume {volume}, edges {edges}"
            );
        }
    }
}

#[test]
fn a_skin_has_its_rig_and_takes_it_back() {
    let folder = &figure_folder();
    let reported = run_well(folder, "rig figure.glb -o own.json --json");
    assert_eq!(reported["source"], "skin");
    let picture = folder.bytes("own.png");
    assert!(picture.starts_with(b"\x89PNG"));
    let rig: Value = serde_json::from_slice(&folder.bytes("own.json")).expect("json");
    let ids: Vec<&str> = list(&rig["bones"]).iter().filter_map(|b| b["id"].as_str()).collect();
    assert!(ids.contains(&"leftLowerArm") && ids[0] == "hips", "{ids:?}");
    let reported = run_well(
        folder,
        "animate figure.glb --clip walk --rig own.json --frames 3:1 --json",
    );
    let edges = reported["frames"][0]["edgeRms"].as_f64().expect("a number");
    assert!(edges < 0.1, "{reported}");
    let bound = run_well(folder, "skin figure.glb --rig own.json -o again.glb --json");
    assert_eq!((&bound["unweighted"], &bound["bones"]), (&0.into(), &ids.len().into()));
}

#[test]
fn joints_of_statues_are_found_where_limbs_are() {
    let what = "joints of figures without a skeleton";
    let Some(meshes) = data_path(what, "meshes") else {
        return;
    };
    let folder = Workplace::empty();
    // Joints that were put by hand, and how far off, over the height, one may be.
    for (name, height, wanted) in [
        (
            "armadillo.obj",
            1.0,
            [
                ("lKnee", [0.191, -0.287, -0.051]),
                ("rKnee", [-0.18, -0.292, -0.052]),
                ("lShoulder", [0.135, 0.163, -0.048]),
                ("rElbow", [-0.29, 0.147, 0.041]),
                ("lAnkle", [0.2, -0.495, -0.089]),
                ("hips", [-0.01, -0.12, -0.085]),
            ],
        ),
        (
            "doorman.obj",
            6.1,
            [
                ("lKnee", [0.29, 1.5, -0.13]),
                ("rKnee", [-0.29, 1.5, -0.13]),
                ("lShoulder", [0.534, 4.88, -0.22]),
                ("rElbow", [-1.094, 4.17, -0.18]),
                ("lAnkle", [0.267, 0.34, -0.22]),
                ("hips", [0.0, 3.04, -0.09]),
            ],
        ),
    ] {
        let path = meshes.join(name);
        let reported = run_well(
            &folder,
            &format!("rig {} -o r.json --no-picture --force --json", path.display()),
        );
        assert_eq!(reported["source"], "shape");
        for (name, at) in wanted {
            let found = joint(&reported, name);
            assert_eq!(found["inside"], true, "{name}: {found}");
            let off = (0..3)
                .map(|k| (found["at"][k].as_f64().expect("a number") - at[k]).powi(2))
                .sum::<f64>()
                .sqrt();
            assert!(off < 0.13 * height, "{name}: {found} is to be near {at:?}");
        }
    }
    for beast in ["horse.ply", "cow.off", "teapot.obj", "camelhead.off"] {
        let path = meshes.join(beast);
        let arguments = ["rig", path.to_str().expect("a path"), "-o", "beast.json", "--force"];
        folder.refused(&arguments, &["give joints with --at"]);
        assert!(!folder.join("beast.json").exists() && folder.join("beast.png").exists());
    }
}

#[test]
fn what_cannot_be_is_refused_with_what_can() {
    let folder = &figure_folder();
    let one = "HIERARCHY\nROOT pipe\n{\nOFFSET 0 0 0\nCHANNELS 0\nEnd Site\n{\nOFFSET 0 1 0\n}\n}\nMOTION\nFrames: 1\nFrame Time: 1\n\n";
    folder.put("pipe.bvh", one);
    folder.put("marks.json", r#"{"lElbow": [1, 2]}"#);
    for (arguments, reported) in [
        ("--preset alien", "preset: is \"alien\", allowed are cmu and mixamo"),
        ("--bvh pipe.bvh", "such as \"hips\""),
        ("--at tail=0,0,0", "\"tail\" is not a joint of a body; there are hips"),
        ("--at lElbow=0,0", "needs three finite numbers"),
        ("--landmarks marks.json", "needs three finite numbers"),
        ("--picture a.jpg", "use a .png file name"),
    ] {
        folder.refused(&format!("rig figure.glb -o rig.json {arguments}"), &[reported]);
        assert!(!folder.join("rig.json").exists());
    }
    let reported = run_well(
        folder,
        "rig figure.glb --preset mixamo --at lElbow=0.4,1.4,0.01 -o rig.json --json --no-picture",
    );
    let elbow = joint(&reported, "lElbow");
    assert_eq!(
        elbow["at"],
        serde_json::json!([0.4, 1.4, 0.01]),
        "a joint that is given stays"
    );
    assert!(!folder.join("rig.png").exists());
}
