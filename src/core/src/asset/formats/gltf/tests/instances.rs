//! What is shared stays shared as long as it can, and parts when it must.

use super::*;

fn square_under(nodes: &str, scene: &str) -> FileSet {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&CORNERS);
    draft.glb(&format!(
        r#""scene":0,"scenes":[{{"nodes":[{scene}]}}],"nodes":[{nodes}],"meshes":[{{"name":"m","primitives":[{{"attributes":{{"POSITION":0}},"indices":1}}]}}]"#
    ))
}

#[test]
fn instances_part_only_when_their_shapes_differ() {
    let files = square_under(
        r#"{"mesh":0},{"mesh":0,"translation":[5,0,0]},{"mesh":0,"rotation":[0,0,1,0]}"#,
        "0,1,2",
    );
    let alike = json(&moved(&files, |_, p| p + DVec3::Z));
    assert_eq!(
        alike["meshes"].as_array().map(Vec::len),
        Some(1),
        "all three moved alike"
    );
    assert_eq!(alike["accessors"].as_array().map(Vec::len), Some(2), "in place");

    let written = moved(&files, |i, p| if i < 4 { p } else { p + DVec3::Z * p.x.abs() });
    let parted = json(&written);
    let meshes: Vec<_> = parted["nodes"]
        .as_array()
        .expect("nodes")
        .iter()
        .map(|n| n["mesh"].clone())
        .collect();
    assert_eq!(meshes, [0, 1, 2], "the first keeps the mesh");
    assert_eq!(parted["meshes"][1]["name"], "m");
    let (rest, after) = (open(&files), open(&again(&written)));
    assert_eq!(after.positions[..4], rest.positions[..4]);
    for (i, (p, q)) in rest.positions.iter().zip(&after.positions).enumerate().skip(4) {
        assert!((*p + DVec3::Z * p.x.abs() - *q).length() < 1e-6, "vertex {i}");
    }
    assert_eq!(
        bin(&files.main)[..48],
        bin(&written.main)[..48],
        "the first still reads the old bytes"
    );
}

#[test]
fn two_of_three_instances_may_share_the_new_shape() {
    let files = square_under(
        r#"{"mesh":0},{"mesh":0,"translation":[5,0,0]},{"mesh":0,"translation":[9,0,0]}"#,
        "0,1,2",
    );
    let parted = json(&moved(&files, |i, p| if i < 4 { p } else { p + DVec3::Z }));
    assert_eq!(parted["meshes"].as_array().map(Vec::len), Some(2));
    assert_eq!(
        (&parted["nodes"][1]["mesh"], &parted["nodes"][2]["mesh"]),
        (&1.into(), &1.into())
    );
    assert_eq!(parted["accessors"].as_array().map(Vec::len), Some(3));
}

#[test]
fn nodes_outside_the_scene_keep_the_old_shape() {
    let files = square_under(r#"{"mesh":0},{"mesh":0}"#, "1");
    let written = moved(&files, |_, p| p + DVec3::Z);
    let parted = json(&written);
    assert_eq!(
        (&parted["nodes"][0]["mesh"], &parted["nodes"][1]["mesh"]),
        (&1.into(), &0.into())
    );
    let position = |mesh: usize| parted["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"].clone();
    assert_eq!((position(1), position(0)), (0.into(), 2.into()));
    assert_eq!(bin(&files.main)[..48], bin(&written.main)[..48]);
}

/// Two halves of one square that share its vertices, as levels of detail and material splits do.
fn halves() -> FileSet {
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&CORNERS[..3]);
    draft.indices(&CORNERS[3..]);
    draft.glb(&one(
        r#"{"attributes":{"POSITION":0},"indices":1},{"attributes":{"POSITION":0},"indices":2}"#,
    ))
}

#[test]
fn halves_that_agree_where_they_meet_share_on() {
    let files = halves();
    // Each half moves what it draws: vertex 1 is drawn by the first only, vertex 3 by the second only.
    let written = moved(&files, |i, p| if [1, 4 + 3].contains(&i) { p + DVec3::Z } else { p });
    assert_eq!(
        json(&written)["accessors"].as_array().map(Vec::len),
        Some(3),
        "in place"
    );
    let stored = open(&again(&written)).geometry.positions;
    assert_eq!(
        stored[..4],
        [0.0, 1.0, 0.0, 1.0]
            .map(|z| z)
            .iter()
            .zip(&SQUARE)
            .map(|(&z, p)| DVec3::new(p[0].into(), p[1].into(), z))
            .collect::<Vec<_>>()
    );
}

#[test]
fn halves_that_disagree_part() {
    let files = halves();
    // Vertex 2 is drawn by both; the second half leaves it where it was.
    let written = moved(&files, |i, p| if i == 2 { p + DVec3::Z } else { p });
    let after = json(&written);
    let attribute = |p: usize| after["meshes"][0]["primitives"][p]["attributes"]["POSITION"].clone();
    assert_eq!((attribute(0), attribute(1)), (3.into(), 0.into()));
    let stored = open(&again(&written)).geometry.positions;
    assert_eq!((stored[2].z, stored[4 + 2].z), (1.0, 0.0));
}

#[test]
fn bytes_that_others_use_are_not_overwritten() {
    let users = [
        // A morph target, an animation, another attribute, an image, a view of something unknown.
        (r#","targets":[{"POSITION":0}]"#, ""),
        (
            "",
            r#","animations":[{"samplers":[{"input":9,"output":0}],"channels":[]}]"#,
        ),
        ("", r#","images":[{"bufferView": 0 ,"mimeType":"image/png"}]"#),
        ("", r#","extensions":{"X_any":{"bufferView":0}}"#),
    ];
    for (primitive, root) in users {
        let mut draft = DocumentDraft::default();
        draft.points(&SQUARE);
        draft.indices(&CORNERS);
        let primitive = format!(r#"{{"attributes":{{"POSITION":0}},"indices":1{primitive}}}"#);
        let files = draft.glb(&format!("{}{root}", one(&primitive)));
        let written = moved(&files, |_, p| p + DVec3::Z);
        assert_eq!(
            bin(&files.main)[..],
            bin(&written.main)[..bin(&files.main).len()],
            "{primitive} {root}"
        );
        assert_eq!(
            json(&written)["meshes"][0]["primitives"][0]["attributes"]["POSITION"],
            2
        );
    }
    // A second view over the same bytes that nobody is known to read.
    let mut draft = DocumentDraft::default();
    draft.points(&SQUARE);
    draft.indices(&CORNERS);
    draft
        .views
        .push(r#"{"buffer":0,"byteOffset":44,"byteLength":8}"#.into());
    let files = draft.glb(&one(r#"{"attributes":{"POSITION":0},"indices":1}"#));
    assert_eq!(
        bin(&files.main)[..48],
        bin(&moved(&files, |_, p| p + DVec3::Z).main)[..48]
    );
}
