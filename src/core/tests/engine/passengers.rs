//! Primitives that ride along: no part of the solve, and where the body takes them in every shape.

use glam::{DMat4, DVec3};
use pliant_core::asset::{FileSet, Format, sample, shapes};
use pliant_core::edit::{KeptSide, SubdivisionScheme};
use pliant_core::engine::{
    CarriedModel, CutLine, Deformer, DeformerLimits, Edit, EditCommand, EditedShape, Error, Handle, HandlePose,
    MergeJoin, ModelMerge, OpenOptions, OtherModel, Passenger, PassengerKind, Plane, Region, SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::mesh::query::TriangleBvh;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

type Shape = (Vec<DVec3>, Vec<[u32; 3]>);

/// A glTF with one node for each shape, named.
fn model_of(parts: &[(&str, &Shape)]) -> FileSet {
    let mut buffer: Vec<u8> = Vec::new();
    let (mut views, mut accessors, mut meshes, mut nodes) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    let mut add = |bytes: Vec<u8>, kind: String| {
        let (first, size) = (buffer.len(), bytes.len());
        buffer.extend(bytes);
        accessors.push(format!(r#"{{"bufferView":{},{kind}}}"#, views.len()));
        views.push(format!(r#"{{"buffer":0,"byteOffset":{first},"byteLength":{size}}}"#));
        views.len() - 1
    };
    for (k, (name, (points, faces))) in parts.iter().enumerate() {
        let list = |p: DVec3| format!("[{},{},{}]", p.x as f32, p.y as f32, p.z as f32);
        let low = list(points.iter().fold(points[0], |a, p| a.min(*p)));
        let high = list(points.iter().fold(points[0], |a, p| a.max(*p)));
        let count = points.len();
        let numbers = points.iter().flat_map(|p| p.as_vec3().to_array());
        let positions = add(
            numbers.flat_map(f32::to_le_bytes).collect(),
            format!(r#""componentType":5126,"count":{count},"type":"VEC3","min":{low},"max":{high}"#),
        );
        let count = faces.len() * 3;
        let indices = add(
            faces.iter().flatten().flat_map(|v| v.to_le_bytes()).collect(),
            format!(r#""componentType":5125,"count":{count},"type":"SCALAR""#),
        );
        meshes.push(format!(
            r#"{{"primitives":[{{"attributes":{{"POSITION":{positions}}},"indices":{indices}}}]}}"#
        ));
        nodes.push(format!(r#"{{"name":"{name}","mesh":{k}}}"#));
    }
    let roots: Vec<String> = (0..parts.len()).map(|k| k.to_string()).collect();
    let json = format!(
        r#"{{"asset":{{"version":"2.0"}},"buffers":[{{"uri":"parts.bin","byteLength":{}}}],"bufferViews":[{}],"accessors":[{}],"meshes":[{}],"nodes":[{}],"scenes":[{{"nodes":[{}]}}],"scene":0}}"#,
        buffer.len(),
        views.join(","),
        accessors.join(","),
        meshes.join(","),
        nodes.join(","),
        roots.join(",")
    );
    let mut files = FileSet::single("model.gltf", json);
    files.companions.insert("parts.bin".into(), buffer.into());
    files
}

/// A bar along y from 0 to 3, and a coarse sleeve around its middle.
fn bar_and_sleeve() -> (Shape, Shape) {
    let stand =
        |(points, faces): Shape| -> Shape { (points.iter().map(|p| DVec3::new(p.y, p.z, p.x)).collect(), faces) };
    let bar = stand(shapes::cylinder(0.3, 3.0, 20, 40, true));
    let (points, faces) = stand(shapes::cylinder(0.4, 1.0, 12, 4, false));
    (bar, (points.iter().map(|p| *p + DVec3::Y).collect(), faces))
}

fn riding(kind: PassengerKind) -> OpenOptions {
    OpenOptions {
        passengers: vec![Passenger {
            name: String::new(),
            kind,
        }],
        ..OpenOptions::default()
    }
}

fn open(files: FileSet, options: &OpenOptions, exec: &Exec<'_>) -> Result<Deformer, Error> {
    Deformer::open(files, options, &DeformerLimits::default(), exec)
}

/// Handles below 0.2 and above a height.
fn ends(height: f64) -> [Handle; 2] {
    [
        Handle::new("low", Region::half_space([0.0, -1.0, 0.0], -0.2)),
        Handle::new("high", Region::half_space([0.0, 1.0, 0.0], height)),
    ]
}

fn hold_ends(deformer: &mut Deformer, exec: &Exec<'_>) {
    deformer.set_handles(ends(2.8), exec).expect("handles");
}

#[test]
fn a_passenger_changes_nothing_for_the_body_and_goes_where_it_goes() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (bar, sleeve) = bar_and_sleeve();
    let both = || model_of(&[("body", &bar), ("sleeve", &sleeve)]);
    let mut alone = open(model_of(&[("body", &bar)]), &OpenOptions::default(), &exec).expect("a bar");
    let by_name = riding(PassengerKind::PrimitivesNamed("sleeve".into()));
    let mut deformer = open(both(), &by_name, &exec).expect("a bar with its sleeve");
    let facts = deformer.facts();
    assert_eq!(
        facts.solver,
        alone.facts().solver.clone_with_bytes(facts.solver.byte_size)
    );
    assert!(facts.primitives[1].is_passenger && !facts.primitives[0].is_passenger);
    assert!(
        facts.warnings.iter().all(|w| w.code != "unreferenced-vertex"),
        "{:?}",
        facts.warnings
    );

    let pose = [("high", HandlePose::rotation([1.2, 0.0, 0.0]))];
    for d in [&mut alone, &mut deformer] {
        hold_ends(d, &exec);
    }
    let settings = SolveSettings::default();
    let expected = alone.commit(pose.clone(), &settings, &exec).expect("solved");
    let solved = deformer.commit(pose.clone(), &settings, &exec).expect("solved");
    let body = bar.0.len();
    assert_eq!(
        solved.positions[..body],
        expected.positions[..],
        "the body does not feel its passenger"
    );

    // The sleeve is where the points of it are carried to.
    let rest: Vec<DVec3> = deformer.rest()[body..].to_vec();
    let carried = deformer.carry_points(&solved.positions, &rest, &exec).expect("carried");
    for (now, frame) in solved.positions[body..].iter().zip(&carried) {
        assert_eq!(*now, frame.position);
    }
    let farthest = solved.positions[body..]
        .iter()
        .zip(&rest)
        .map(|(a, b)| a.distance(*b))
        .fold(0.0, f64::max);
    assert!(farthest > 0.2, "the sleeve moves by {farthest}");
    // It keeps its distance of 0.1 from the body.
    for p in &solved.positions[body..] {
        let gap = expected
            .positions
            .iter()
            .map(|q| q.distance(*p))
            .fold(f64::MAX, f64::min);
        assert!((0.05..0.2).contains(&gap), "a gap of {gap}");
    }
    // In the rest pose all is as it was, and written to the byte.
    let written = deformer.write(deformer.rest(), Format::GLTF, &exec).expect("written");
    assert_eq!(written.main, both().main.to_vec());
    // The same with other threads.
    let one = Pool::new(1).expect("a thread");
    let exec = Exec::new(&one, &Silent);
    let mut again = open(both(), &by_name, &exec).expect("opened");
    hold_ends(&mut again, &exec);
    assert_eq!(
        again.commit(pose.clone(), &settings, &exec).expect("solved").positions,
        solved.positions
    );
}

#[test]
fn wrong_passengers_are_refused_with_their_number() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let (bar, sleeve) = bar_and_sleeve();
    let files = || model_of(&[("body", &bar), ("sleeve", &sleeve)]);
    let reported = |kinds: Vec<PassengerKind>, wrong: usize| {
        let passengers = kinds.into_iter().map(|kind| Passenger {
            name: String::new(),
            kind,
        });
        let options = OpenOptions {
            passengers: passengers.collect(),
            ..OpenOptions::default()
        };
        match open(files(), &options, &exec).map(drop).expect_err("refused") {
            Error::Invalid { field, problem } => (field == format!("passengers[{wrong}]"), problem),
            other => panic!("{other}"),
        }
    };
    let (first, second) = (PassengerKind::Primitive(0), PassengerKind::Primitive(1));
    assert!(matches!(reported(vec![PassengerKind::Primitive(2)], 0), (true, p) if p.contains("has 2 primitives")));
    let named = PassengerKind::PrimitivesNamed("cape".into());
    assert!(
        matches!(reported(vec![second.clone(), named], 1), (true, p) if p.contains("\"cape\"") && p.contains("\"sleeve\""))
    );
    assert!(matches!(reported(vec![second.clone(), second.clone()], 1), (true, p) if p.contains("already")));
    assert!(matches!(reported(vec![second, first], 1), (true, p) if p.contains("nothing is left")));
}

#[test]
fn what_rides_along_is_not_held() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let (bar, sleeve) = bar_and_sleeve();
    let files = model_of(&[("body", &bar), ("sleeve", &sleeve)]);
    let mut deformer = open(files, &riding(PassengerKind::Primitive(1)), &exec).expect("opened");
    let refused = deformer.set_handles([Handle::new("sleeve", Region::Primitive(1))], &exec);
    assert!(
        matches!(refused, Err(Error::Invalid { field, problem }) if field == "handles[0].region" && problem.contains("rides along"))
    );
    // A region of both holds what is the body's alone: the sleeve follows and is not pulled.
    deformer.set_handles(ends(1.5), &exec).expect("held");
    let up = [("high", HandlePose::translation([0.0, 0.5, 0.0]))];
    let solved = deformer.commit(up, &SolveSettings::default(), &exec).expect("solved");
    assert!(solved.positions.iter().all(|p| p.is_finite()));
}

/// The triangles of a primitive of the model as it is now.
fn faces_of(deformer: &Deformer, primitive: usize) -> Vec<[u32; 3]> {
    let faces: Vec<Vec<[u32; 3]>> = (deformer.geometry().triangles_of_primitives())
        .map(|(p, faces)| faces.iter().map(|t| t.map(|v| v - p.first_vertex)).collect())
        .collect();
    faces[primitive].clone()
}

/// The vertices of a primitive in a shape.
fn vertices_of<'a>(deformer: &Deformer, primitive: usize, positions: &'a [DVec3]) -> &'a [DVec3] {
    &positions[deformer.geometry().primitives[primitive].vertices()]
}

#[test]
fn an_edit_changes_the_body_and_leaves_what_rides_along_in_its_place() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (bar, sleeve) = bar_and_sleeve();
    let settings = SolveSettings::default();
    let cut = Edit::Cut {
        along: CutLine::Plane(Plane::new([0.0, 1.0, 0.0], 2.5)),
        keep: KeptSide::Below,
        fill: true,
        cap: None,
    };
    let halves = Edit::Subdivide {
        region: Some(Region::half_space([0.0, 1.0, 0.0], 1.6)),
        scheme: SubdivisionScheme::Midpoint,
        creases: Default::default(),
    };
    let thin = Edit::Decimate {
        region: None,
        ratio: 0.6,
    };
    // Before, between and after what is solved.
    for (own, parts) in [
        (0, vec![("sleeve", &sleeve), ("body", &bar)]),
        (1, vec![("body", &bar), ("sleeve", &sleeve)]),
    ] {
        let other = 1 - own;
        let files = model_of(&parts);
        let options = riding(PassengerKind::PrimitivesNamed("sleeve".into()));
        let mut deformer = open(files, &options, &exec).expect("opened");
        deformer.set_handles(ends(2.2), &exec).expect("held");
        let faces = faces_of(&deformer, own);
        for edit in [&cut, &halves, &thin] {
            let turned = HandlePose::rotation([0.5, 0.0, 0.0]).about([0.0, 2.6, 0.0]);
            let bent = deformer.commit([("high", turned)], &settings, &exec).expect("solved");
            let place = vertices_of(&deformer, own, &bent.positions).to_vec();
            let (state, rest) = (deformer.topology_state(), deformer.rest().to_vec());
            let before = faces_of(&deformer, other).len();
            let command = EditCommand {
                edit,
                on: EditedShape::Current,
                shape: &bent,
                poses: &deformer.initial_poses(),
                settings: Some(&settings),
            };
            let outcome = deformer.edit(&command, &exec).expect("edited");
            assert_eq!(faces_of(&deformer, own), faces, "no edit touches what rides along");
            assert_ne!(faces_of(&deformer, other).len(), before);
            assert_eq!(outcome.report.after.faces as usize, deformer.geometry().triangles.len());
            assert_eq!(
                vertices_of(&deformer, own, deformer.rest()),
                place,
                "it stays where the bent body took it"
            );
            assert!(
                deformer
                    .facts()
                    .warnings
                    .iter()
                    .all(|w| w.code != "unreferenced-vertex")
            );

            // It goes on riding, and it is written.
            let on = deformer.commit([("high", HandlePose::translation([0.2, 0.3, 0.0]))], &settings, &exec);
            let on = on.expect("solved").positions;
            let moved = place
                .iter()
                .zip(vertices_of(&deformer, own, &on))
                .map(|(a, b)| a.distance(*b));
            assert!(moved.fold(0.0, f64::max) > 0.05, "it moves with the body");
            let written = deformer.write(&on, Format::GLB, &exec).expect("written");
            let again = FileSet::single("again.glb", written.main);
            let again = open(again, &OpenOptions::default(), &exec).expect("read back");
            assert_eq!(faces_of(&again, own).len(), faces.len());
            assert_eq!(faces_of(&again, other).len(), faces_of(&deformer, other).len());
            let seen = vertices_of(&again, own, again.rest());
            let wanted = vertices_of(&deformer, own, &on);
            assert!(seen.iter().zip(wanted).all(|(a, b)| a.distance(*b) < 1e-6));

            // Back and forth, bit for bit.
            let after = (
                deformer.topology_state(),
                deformer.rest().to_vec(),
                deformer.geometry().triangles.clone(),
            );
            deformer.restore_topology(&state, &exec).expect("undone");
            assert_eq!(deformer.rest()[..], rest[..]);
            assert_eq!(faces_of(&deformer, other).len(), before);
            deformer.restore_topology(&after.0, &exec).expect("redone");
            assert_eq!(
                (&deformer.rest()[..], &deformer.geometry().triangles),
                (&after.1[..], &after.2)
            );
            deformer.set_handles(ends(2.0), &exec).expect("held");
        }
    }
}

#[test]
fn edits_of_the_rest_shape_and_merged_models_leave_passengers_alone() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (bar, sleeve) = bar_and_sleeve();
    let files = model_of(&[("sleeve", &sleeve), ("body", &bar)]);
    let mut deformer = open(files, &riding(PassengerKind::Primitive(0)), &exec).expect("opened");
    let rest = vertices_of(&deformer, 0, deformer.rest()).to_vec();
    let beside: Shape = (bar.0.iter().map(|p| *p + DVec3::X * 3.0).collect(), bar.1.clone());
    let merge = Edit::Merge(Box::new(ModelMerge {
        other: OtherModel {
            files: model_of(&[("second", &beside)]),
            ..OtherModel::default()
        },
        own_from_other: DMat4::IDENTITY,
        join: MergeJoin::Loose,
        tolerance: None,
    }));
    let thin = Edit::Decimate {
        region: None,
        ratio: 0.5,
    };
    let weld = Edit::Weld { tolerance: 1e-4 };
    for edit in [merge, thin, weld] {
        deformer.edit_rest(&edit, &exec).expect("edited");
        assert_eq!(vertices_of(&deformer, 0, deformer.rest()), rest);
        assert_eq!(faces_of(&deformer, 0), sleeve.1);
        assert_eq!(deformer.geometry().primitives.len(), 3);
        let marked: Vec<bool> = deformer.geometry().primitives.iter().map(|p| p.is_passenger).collect();
        assert_eq!(marked, [true, false, false]);
    }
    for format in [Format::GLB, Format::OBJ] {
        let written = deformer.write(deformer.rest(), format, &exec).expect("written");
        let again = open(FileSet::single("again", written.main), &OpenOptions::default(), &exec).expect("read back");
        assert_eq!(
            again.geometry().triangles.len(),
            deformer.geometry().triangles.len(),
            "{format}"
        );
    }
}

/// A level of detail of a quarter of the triangles lies on the deformed original as it lay on the original, within half a
/// per cent of the diagonal: all its corners, and but for one in a hundred, where a flat triangle spans the bend, the middles
/// of its triangles.
#[test]
fn a_level_of_detail_stays_on_the_deformed_original() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut models = vec![("creature", FileSet::single("creature.glb", sample::creature_glb()), 0)];
    let beside = concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/data");
    let data = std::env::var("PLIANT_DATA").unwrap_or_else(|_| beside.into());
    for (name, along) in [("camelhead.off", 1)] {
        match std::fs::read(format!("{data}/meshes/{name}")) {
            Ok(bytes) => models.push((name, FileSet::single(name, bytes), along)),
            Err(e) => println!("SKIPPED: {name}: {e}"),
        }
    }
    for (name, files, along) in models {
        let mut whole = open(files.clone(), &OpenOptions::default(), &exec).expect("opened");
        let mut coarse = open(files, &OpenOptions::default(), &exec).expect("opened");
        let thin = Edit::Decimate {
            region: None,
            ratio: 0.25,
        };
        coarse.edit_rest(&thin, &exec).expect("thinned out");
        let rest = whole.rest().to_vec();
        let (low, high) = rest.iter().fold((rest[0], rest[0]), |b, p| (b.0.min(*p), b.1.max(*p)));
        let mut up = [0.0; 3];
        up[along] = 1.0;
        let at = |share: f64| low[along] + share * (high - low)[along];
        let handles = [
            Handle::new("low", Region::half_space(up.map(|x: f64| -x), -at(0.2))),
            Handle::new("high", Region::half_space(up, at(0.8))),
        ];
        whole.set_handles(handles, &exec).expect("held");
        let (lod, faces) = (coarse.rest().to_vec(), &coarse.geometry().triangles);
        let triangles = whole.geometry().triangles.clone();
        for turn in [0.8, 1.57] {
            let mut rotation = [0.0; 3];
            rotation[(along + 1) % 3] = turn;
            let pose = [("high", HandlePose::rotation(rotation))];
            let now = whole
                .commit(pose, &SolveSettings::default(), &exec)
                .expect("solved")
                .positions;
            let carried = whole.carry_points(&now, &lod, &exec).expect("carried");
            let carried: Vec<DVec3> = carried.iter().map(|f| f.position).collect();
            let off = |lod: &[DVec3], original: &[DVec3]| {
                let surface = TriangleBvh::build(original, &triangles, &pool);
                let away = |p: DVec3| surface.closest_point(p).map_or(f64::MAX, |at| at.distance) / low.distance(high);
                let middles = faces
                    .iter()
                    .map(|t| t.iter().map(|&v| lod[v as usize]).sum::<DVec3>() / 3.0);
                let mut middles: Vec<f64> = middles.map(away).collect();
                middles.sort_by(f64::total_cmp);
                let corners = lod.iter().map(|&p| away(p)).fold(0.0, f64::max);
                [corners, middles[middles.len() * 99 / 100], middles[middles.len() - 1]]
            };
            let (before, after) = (off(&lod, &rest), off(&carried, &now));
            println!(
                "{name} turned by {turn}: corners, middles, farthest middle {before:.5?} at rest, {after:.5?} deformed"
            );
            let [corners, middles, farthest] = after;
            let near = corners < 0.005 && middles < 0.005 && farthest < 0.02;
            assert!(near, "{name} turned by {turn}: {after:?}");
        }
    }
}

#[test]
fn another_model_rides_along_in_its_own_format() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (bar, sleeve) = bar_and_sleeve();
    let mut deformer = open(model_of(&[("body", &bar)]), &OpenOptions::default(), &exec).expect("opened");
    hold_ends(&mut deformer, &exec);
    let up = [("high", HandlePose::translation([0.0, 0.5, 0.0]))];
    let solved = deformer.commit(up, &SolveSettings::default(), &exec).expect("solved");
    let files = model_of(&[("sleeve", &sleeve)]);
    let hull = |output| CarriedModel {
        files: files.clone(),
        format: None,
        output,
        path: String::new(),
    };
    let written = deformer
        .carry_model(&solved.positions, hull(Some(Format::OBJ)), &exec)
        .expect("carried");
    let text = String::from_utf8(written.main).expect("a text");
    let highest = |text: &str| {
        let vertices = text.lines().filter_map(|l| l.strip_prefix("v "));
        let heights = vertices.filter_map(|l| l.split(' ').nth(1)?.parse::<f64>().ok());
        heights.fold(f64::MIN, f64::max)
    };
    assert!((2.05..2.45).contains(&highest(&text)), "{}", highest(&text));
    let own = deformer
        .carry_model(deformer.rest(), hull(None), &exec)
        .expect("carried");
    assert_eq!(own.main, files.main.to_vec(), "at rest every byte stays");
    let broken = CarriedModel {
        files: FileSet::single("", "nothing"),
        ..hull(None)
    };
    assert!(matches!(
        deformer.carry_model(&solved.positions, broken, &exec),
        Err(Error::Asset(_))
    ));
}

trait CloneWithBytes {
    fn clone_with_bytes(self, bytes: u64) -> Self;
}

impl CloneWithBytes for pliant_core::engine::SolverFacts {
    /// What is held may differ: passengers are held too.
    fn clone_with_bytes(self, bytes: u64) -> Self {
        Self {
            byte_size: bytes,
            ..self
        }
    }
}

/// The bar as a text, with more vertices that no face uses behind its own.
fn bar_with_loose(more: &[DVec3]) -> FileSet {
    let (points, faces) = bar_and_sleeve().0;
    let vertices = points.iter().chain(more);
    let vertices: String = vertices.map(|p| format!("v {} {} {}\n", p.x, p.y, p.z)).collect();
    let faces = faces.iter().map(|f| f.map(|v| v + 1));
    let faces: String = faces.map(|[a, b, c]| format!("f {a} {b} {c}\n")).collect();
    FileSet::single("bar.obj", vertices + &faces)
}

#[test]
fn vertices_in_no_face_go_with_the_surface_around_them() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let body = bar_and_sleeve().0.0;
    // A row beside the bar, through the free part and the held one; and copies of every vertex of it.
    let row = (0..31).map(|i| DVec3::new(0.31, 0.1 * f64::from(i), 0.0));
    let loose: Vec<DVec3> = row.chain(body.iter().copied()).collect();
    let pose = [("high", HandlePose::rotation([1.2, 0.0, 0.0]))];
    let settings = SolveSettings::default();

    let mut deformer = open(bar_with_loose(&loose), &OpenOptions::default(), &exec).expect("a bar");
    hold_ends(&mut deformer, &exec);
    let solved = deformer.commit(pose.clone(), &settings, &exec).expect("solved");
    let rest: Vec<DVec3> = deformer.rest()[body.len()..].to_vec();
    let carried = deformer.carry_points(&solved.positions, &rest, &exec).expect("carried");
    for i in 0..31 {
        assert_eq!(solved.positions[body.len() + i], carried[i].position, "point {i}");
    }
    assert_eq!(
        solved.positions[body.len() + 31..],
        solved.positions[..body.len()],
        "what lies on a vertex goes with it, bit for bit"
    );
    let steps = solved.positions[body.len()..][..31]
        .windows(2)
        .map(|p| p[0].distance(p[1]));
    assert!(steps.fold(0.0, f64::max) < 0.2, "the row is not torn");

    // Sessions of before: the held ones go with their handle, the others stay.
    let before = OpenOptions {
        loose_vertices_ride: false,
        ..OpenOptions::default()
    };
    let mut deformer = open(bar_with_loose(&loose), &before, &exec).expect("a bar");
    hold_ends(&mut deformer, &exec);
    let solved = deformer.commit(pose.clone(), &settings, &exec).expect("solved");
    let moved = |i: usize| solved.positions[body.len() + i] != loose[i];
    assert!((0..28).all(|i| !moved(i)) && (29..31).all(moved));
}

#[test]
fn points_and_lines_of_a_gltf_go_with_their_surface_and_stay_in_its_accessor() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (bar, sleeve) = bar_and_sleeve();
    let mut files = model_of(&[("body", &bar), ("sleeve", &sleeve)]);
    let json = String::from_utf8(files.main.to_vec()).expect("text");
    let surface = r#"{"attributes":{"POSITION":0},"indices":1}"#;
    assert!(json.contains(surface));
    let lines = r#"{"attributes":{"POSITION":0},"indices":1,"mode":1},{"attributes":{"POSITION":2},"mode":0}"#;
    let json = json.replace(surface, &format!("{surface},{lines}"));
    files.main = json.clone().into();
    let mut deformer = open(files, &OpenOptions::default(), &exec).expect("a bar with its edges");
    let primitives = deformer.facts().primitives;
    let riding: Vec<bool> = primitives.iter().map(|p| p.is_passenger).collect();
    assert_eq!(riding, [false, false, true, true]);
    assert!(
        deformer
            .facts()
            .warnings
            .iter()
            .all(|w| w.code != "unreferenced-vertex")
    );
    hold_ends(&mut deformer, &exec);
    let pose = [("high", HandlePose::rotation([1.2, 0.0, 0.0]))];
    let solved = deformer.commit(pose, &SolveSettings::default(), &exec).expect("solved");
    let solid = bar.0.len() + sleeve.0.len();
    assert_eq!(solved.positions[solid..], solved.positions[..solid]);
    assert_ne!(solved.positions[solid..], deformer.rest()[solid..]);
    let written = deformer.write(&solved.positions, Format::GLTF, &exec).expect("written");
    let text = String::from_utf8(written.main).expect("text");
    assert_eq!(
        text.matches("componentType").count(),
        json.matches("componentType").count()
    );
}

#[test]
fn a_passenger_may_be_of_points_alone() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = open(bar_with_loose(&[]), &OpenOptions::default(), &exec).expect("a bar");
    hold_ends(&mut deformer, &exec);
    let pose = [("high", HandlePose::rotation([1.2, 0.0, 0.0]))];
    let solved = deformer.commit(pose, &SolveSettings::default(), &exec).expect("solved");
    let cloud = |output| CarriedModel {
        files: FileSet::single("cloud.obj", "v 0.3 1.5 0\nv 0.3 2.9 0\np 1 2\n"),
        format: None,
        output,
        path: String::new(),
    };
    let carried = deformer
        .carry_model(&solved.positions, cloud(None), &exec)
        .expect("carried");
    let text = String::from_utf8(carried.main).expect("text");
    assert!(text.ends_with("p 1 2\n") && !text.contains("v 0.3 2.9 0"), "{text}");
    let refused = deformer.carry_model(&solved.positions, cloud(Some(Format::GLB)), &exec);
    assert!(refused.is_err_and(|e| e.to_string().contains("obj alone")));
}

#[test]
fn passengers_follow_a_given_shape_that_does_not_name_them() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let (bar, sleeve) = bar_and_sleeve();
    let files = model_of(&[("bar", &bar), ("sleeve", &sleeve)]);
    let options = riding(PassengerKind::Primitive(1));
    let mut deformer = Deformer::open(files, &options, &DeformerLimits::default(), &exec).expect("opens");
    let in_frame =
        |positions: &[DVec3]| -> Vec<[f32; 3]> { positions.iter().map(|p| p.as_vec3().to_array()).collect() };
    let (all, own) = (in_frame(deformer.rest()), bar.0.len());
    let mut adopt = |positions: Vec<[f32; 3]>| {
        let (shape, poses) = (deformer.rest_shape(), deformer.initial_poses());
        let command = EditCommand {
            edit: &Edit::Adopt { positions },
            on: EditedShape::Current,
            shape: &shape,
            poses: &poses,
            settings: None,
        };
        deformer.edit(&command, &exec).expect("adopted").shape.positions
    };
    // The bar a quarter further up, and the sleeve with it.
    let lift = |p: &[f32; 3]| [p[0], p[1] + 0.25, p[2]];
    let given: Vec<[f32; 3]> = all[..own].iter().map(lift).collect();
    let now = in_frame(&adopt(given.clone()));
    assert!(now[..own] == given);
    for (now, was) in now[own..].iter().zip(&all[own..]) {
        let off = (0..3).map(|c| (now[c] - lift(was)[c]).abs()).fold(0.0, f32::max);
        assert!(off < 1e-5, "{now:?} of {was:?}");
    }
    // Named, they are where they are put.
    assert!(in_frame(&adopt(all.clone())) == all);
}
