use crate::{
    BaseModel, CapLooks, EditedModel, FileSet, Format, Limits, Model, PrimitiveRun, VertexBlends, write_edited_model,
};
use glam::DVec3;

#[test]
fn lines_run_on_past_a_vertex_that_is_gone_and_end_at_a_cut() {
    // A strip of two squares; the line runs along its lower edge, in two-point statements.
    let text =
        "v 0 0 0\nv 1 0 0\nv 2 0 0\nv 0 1 0\nv 1 1 0\nv 2 1 0\nf 1 2 5\nf 1 5 4\nf 2 3 6\nf 2 6 5\nl 1 2\nl 2 3\n";
    let read = Model::read(FileSet::single("test.obj", text), None, &Limits::default()).expect("readable");
    let drawn = |blends: &[&[(u32, f64)]], triangles: &[[u32; 3]]| {
        let mut made = VertexBlends::default();
        blends
            .iter()
            .for_each(|parts| made.push_composed(&VertexBlends::identity(6), parts));
        let positions: Vec<DVec3> = (blends.iter())
            .map(|parts| parts.iter().map(|(v, w)| read.positions[*v as usize] * *w).sum())
            .collect();
        let edited = EditedModel {
            bases: &[BaseModel {
                model: &read,
                world_from_model: glam::DAffine3::IDENTITY,
            }],
            runs: &[PrimitiveRun {
                base: 0,
                primitive: 0,
                first_vertex: 0,
                vertex_count: blends.len() as u32,
                first_triangle: 0,
                triangle_count: triangles.len() as u32,
            }],
            blends: &made,
            triangles,
            origins: &[],
            bare: &[],
            caps: CapLooks::default(),
        };
        let written = write_edited_model(&edited, &positions, Format::OBJ).expect("writable");
        let text = String::from_utf8(written.main).expect("text");
        let lines = text.lines().filter(|l| l.starts_with("l ")).map(str::to_owned);
        (lines.collect::<Vec<_>>(), written.warnings.len())
    };
    let whole = |v: u32| [(v, 1.0)];
    // The middle one is gone: the two that are left are joined, and there is a warning.
    let [a, c, d, f] = [0, 2, 3, 5].map(whole);
    assert_eq!(
        drawn(&[&a, &c, &d, &f], &[[0, 1, 3], [0, 3, 2]]),
        (vec!["l 1 2".to_owned()], 1)
    );
    // Cut at a half of the second square: the line ends there.
    let (b, e) = (whole(1), whole(4));
    let (low, high) = ([(1, 0.5), (2, 0.5)], [(4, 0.5), (5, 0.5)]);
    let (lines, _) = drawn(
        &[&a, &b, &d, &e, &low, &high],
        &[[0, 1, 3], [0, 3, 2], [1, 4, 5], [1, 5, 3]],
    );
    assert_eq!(lines, ["l 1 2", "l 2 5"]);
}

#[test]
fn a_merged_model_brings_its_materials_as_a_library_of_its_own() {
    let with_library = |colour: &str, picture: &[u8]| {
        let text = "mtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 0 1\nusemtl skin\nf 1/1 2/2 3/3\n";
        let mut files = FileSet::single("test.obj", text);
        let library = format!("newmtl skin\nKd {colour}\nmap_Kd a.png\n");
        files.companions.insert("a.mtl".into(), library.into());
        files.companions.insert("a.png".into(), picture.to_vec().into());
        Model::read(files, None, &Limits::default()).expect("readable")
    };
    let head = with_library("1 0 0", b"\x89PNG\r\n\x1a\n first");
    let hat = with_library("0 1 0", b"\x89PNG\r\n\x1a\n second");
    let hat = hat.write(&hat.positions.clone(), Format::GLB).expect("a GLB").main;
    let hat = Model::read(FileSet::single("hat.glb", hat), None, &Limits::default()).expect("readable");
    let run = |base: u32| PrimitiveRun {
        base,
        primitive: 0,
        first_vertex: 3 * base,
        vertex_count: 3,
        first_triangle: base,
        triangle_count: 1,
    };
    let base = |model| BaseModel {
        model,
        world_from_model: glam::DAffine3::IDENTITY,
    };
    let mut blends = VertexBlends::identity(3);
    (0..3).for_each(|v| blends.push_vertex(v));
    let edited = EditedModel {
        bases: &[base(&head), base(&hat)],
        runs: &[run(0), run(1)],
        blends: &blends,
        triangles: &[[0, 1, 2], [3, 4, 5]],
        origins: &[],
        bare: &[],
        caps: CapLooks::default(),
    };
    let positions = [head.positions.as_slice(), &hat.positions].concat();
    let written = write_edited_model(&edited, &positions, Format::OBJ).expect("written");
    let text = String::from_utf8(written.main.clone()).expect("text");
    assert!(
        text.contains("mtllib a.mtl\n") && text.contains("mtllib merged.mtl\n"),
        "{text}"
    );
    let files = written.into_files("both.obj");
    let look = Model::read(files, None, &Limits::default()).expect("readable");
    let glb = look.write(&look.positions.clone(), Format::GLB).expect("a GLB").main;
    let json = String::from_utf8_lossy(&glb).into_owned();
    for wanted in [
        "first",
        "second",
        r#""baseColorFactor":[1,0,0,1]"#,
        r#""baseColorFactor":[0,1,0,1]"#,
    ] {
        assert!(json.replace(".0", "").contains(wanted), "{wanted}: {json}");
    }
}
