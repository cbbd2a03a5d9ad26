//! Gaussian splats as models of their own and in a glTF: stretched, cut as they are posed, and those that cannot be used.

use super::splats::{bar, gltf_of_bar, own_model, rows, splats_at};
use glam::{DQuat, DVec3};
use pliant_core::asset::{FileSet, Format};
use pliant_core::edit::KeptSide;
use pliant_core::engine::{
    CutLine, Deformer, DeformerLimits, Edit, EditCommand, EditedShape, Handle, HandlePose, HandleScale, OpenOptions,
    Plane, Region, SolveSettings,
};
use pliant_core::exec::Exec;
use pliant_core::mesh::rotation::exp_rotation;
use pliant_core::pool::Pool;
use pliant_core::progress::Silent;

#[test]
fn splats_of_a_stretched_and_unbent_model_are_not_divided() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let centers: Vec<DVec3> = bar().2;
    let long = FileSet::single("long.ply", splats_at(&centers, 0.2));
    let mut deformer = own_model(&long, &exec);
    let all = Handle::new("all", Region::half_space([0.0, 1.0, 0.0], -9.0));
    deformer.set_handles([all], &exec).expect("a handle");
    let pose = HandlePose {
        scale: Some(HandleScale::PerAxis(DVec3::new(2.0, 1.0, 0.5))),
        ..HandlePose::default()
    }
    .about([0.0; 3]);
    let solved = deformer
        .commit([("all", pose)], &SolveSettings::default(), &exec)
        .expect("solved");
    let written = deformer.write(&solved.positions, Format::PLY, &exec).expect("written");
    assert_eq!(rows(&written.main).len(), centers.len(), "{:?}", written.warnings);
}

#[test]
fn a_cap_over_a_cut_through_a_posed_shape_changes_no_splat() {
    let pool = Pool::new(2).expect("threads");
    let exec = Exec::new(&pool, &Silent);
    let mut deformer = own_model(&bar().1, &exec);
    let all = Handle::new("all", Region::half_space([0.0, 1.0, 0.0], -9.0));
    deformer.set_handles([all], &exec).expect("a handle");
    let turn = exp_rotation(DVec3::new(0.0, 0.0, 0.7));
    let pose = HandlePose::translation([1.0, 0.0, 0.0])
        .rotated([0.0, 0.0, 0.7])
        .about([0.0; 3]);
    let solved = deformer
        .commit([("all", pose)], &SolveSettings::default(), &exec)
        .expect("solved");
    let edit = Edit::Cut {
        along: CutLine::Plane(Plane {
            normal: DVec3::Z,
            offset: 0.05,
        }),
        keep: KeptSide::Below,
        fill: true,
        cap: None,
    };
    let command = EditCommand {
        edit: &edit,
        on: EditedShape::Current,
        shape: &solved,
        poses: &deformer.initial_poses(),
        settings: None,
    };
    deformer.edit(&command, &exec).expect("edited");
    let rest = deformer.rest().to_vec();
    let written = deformer.write(&rest, Format::PLY, &exec).expect("written");
    let kept = rows(&written.main);
    assert!(kept.len().abs_diff(80) <= 8, "{}", kept.len());
    for row in &kept {
        let own = DQuat::from_xyzw(row[11], row[12], row[13], row[10]);
        // Its other axes are of one length, and may turn about this one.
        assert!((own * DVec3::Y).dot(turn * DVec3::Y).abs() > 1.0 - 1e-6, "{own}");
        for (scale, wanted) in row[7..10].iter().zip([0.01f64, 0.03, 0.01]) {
            assert!((scale - wanted.ln()).abs() < 1e-3, "{scale} {}", wanted.ln());
        }
    }
}

#[test]
fn splats_of_a_gltf_without_a_shape_are_told_and_those_without_a_mesh_are_refused_by_name() {
    let pool = Pool::new(1).expect("a thread");
    let exec = Exec::new(&pool, &Silent);
    let limits = DeformerLimits::default();
    let changed = |from: &str, to: &str| {
        let (mut files, _) = gltf_of_bar("");
        let text = String::from_utf8_lossy(&files.main).into_owned();
        assert!(text.contains(from), "{from}");
        files.main = text.replace(from, to).into();
        files
    };
    let unsound = |files: FileSet| {
        let deformer = Deformer::open(files, &OpenOptions::default(), &limits, &exec).expect("a bar");
        let moved: Vec<DVec3> = deformer.rest().iter().map(|p| *p + DVec3::X).collect();
        let written = deformer.write(&moved, Format::GLTF, &exec).expect("written");
        let warning = written.warnings.into_iter().find(|w| w.code == "splats-unsound");
        warning.map(|w| w.message)
    };
    assert_eq!(unsound(gltf_of_bar("").0), None);
    // A rotation that is missing, and scales that are negative: those of the harmonics are.
    let without = unsound(changed("\"KHR_gaussian_splatting:ROTATION\":3,", ""));
    assert!(without.is_some_and(|message| message.starts_with("160 splats have no rotation")));
    let negative = changed(
        "\"KHR_gaussian_splatting:SCALE\":4",
        "\"KHR_gaussian_splatting:SCALE\":5",
    );
    assert!(unsound(negative).is_some());

    let alone = changed("{\"attributes\":{\"POSITION\":1},\"indices\":0},", "");
    let refused = Deformer::open(alone, &OpenOptions::default(), &limits, &exec)
        .err()
        .expect("no surface");
    assert!(
        refused.to_string().contains("Gaussian splats and no triangle"),
        "{refused}"
    );
}
