//! Real glTF files, edited and merged: read back as described, and nothing new for the validator.

use super::*;

/// Every model of the data folder that is read, with its path.
pub fn models(what: &str) -> Vec<(PathBuf, Model)> {
    let Some(data) = data_folder(what) else {
        return Vec::new();
    };
    let read = |path: PathBuf| {
        let model = Model::read(file_set(&path), None, &Limits::default()).ok()?;
        (model.triangles.len() < 100_000).then_some((path, model))
    };
    gltf_files(&data.join("gltf")).into_iter().filter_map(read).collect()
}

/// A GLB that keeps an embedded image is valid, if unusual.
fn is_new(code: &&String) -> bool {
    *code != "DATA_URI_GLB"
}

#[test]
fn real_gltf_files_come_back_as_they_were_edited_and_valid() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (mut pairs, mut all) = (Vec::new(), Vec::new());
    for (i, (path, model)) in models("edited glTF files").iter().enumerate() {
        let name = path.display().to_string();
        for (subdivide, format) in [(true, Format::GLB), (false, Format::GLTF)] {
            let edited = Edited::of(model, subdivide);
            let written = match edited.write(model, format) {
                Ok(written) => written,
                Err(e) => {
                    assert!(e.to_string().contains("flattens"), "{name}: {e}");
                    continue;
                }
            };
            let again = read_back(&written, format);
            same_shape(&again, &edited, &name);
            let before: Vec<_> = model
                .primitives
                .iter()
                .map(|p| (p.has_normals, p.has_tangents, &p.name))
                .collect();
            let after: Vec<_> = again
                .primitives
                .iter()
                .map(|p| (p.has_normals, p.has_tangents, &p.name))
                .collect();
            assert_eq!(after, before, "{name}");
            let turned = if subdivide {
                0
            } else {
                model.normals.len().min(again.normals.len())
            };
            for v in 0..turned {
                let authored = model.normals[v];
                assert!(
                    authored == glam::Vec3::ZERO || authored.distance(again.normals[v]) < 1e-3,
                    "{name}: normal {v}"
                );
            }
            let at = folder
                .path()
                .join(format!("{i}-{}/model.{}", format.name(), format.name()));
            khronos::store(&written, &at);
            let was_draco = model.warnings.iter().any(|w| w.0 == "draco-decoded");
            pairs.push((path.clone(), at.clone(), was_draco));
            all.push(at);
        }
        all.push(path.clone());
    }
    let Some(findings) = (!all.is_empty()).then(|| khronos::validate(&all)).flatten() else {
        return;
    };
    for (before, after, was_draco) in pairs {
        // The validator does not look into Draco, which rounds weights so that they no longer add to 1.
        let rounded = |code: &&String| was_draco && *code == "ACCESSOR_WEIGHTS_NON_NORMALIZED";
        let found = findings[&after].difference(&findings[&before]).filter(is_new);
        let new: Vec<_> = found.filter(|code| !rounded(code)).collect();
        assert!(new.is_empty(), "{} as {}: {new:?}", before.display(), after.display());
    }
}

#[test]
fn merged_models_bring_their_materials_and_stand_where_they_were_put() {
    let models = models("merged glTF files");
    let folder = tempfile::tempdir().expect("a temporary folder");
    let (mut pairs, mut all) = (Vec::new(), Vec::new());
    let first = open(figure(), Format::GLB);
    let start = folder.path().join("first.glb");
    std::fs::write(&start, figure()).expect("a writable folder");
    all.push(start.clone());
    let put = DAffine3::from_scale_rotation_translation(
        DVec3::splat(0.5),
        glam::DQuat::from_rotation_y(0.7),
        DVec3::new(3.0, -1.0, 2.0),
    );
    for (i, (path, model)) in models.iter().enumerate() {
        let name = path.display().to_string();
        let mut edited = Edited::of(&first, true);
        let mut other = Edited::of(model, i % 2 == 0);
        other.positions.iter_mut().for_each(|p| *p = put.transform_point3(*p));
        edited.merge(&other);
        let bases = [
            at_rest(&first),
            BaseModel {
                model,
                world_from_model: put,
            },
        ];
        let written = match write_edited_model(&edited.remade(&bases), &edited.positions, Format::GLB) {
            Ok(written) => written,
            Err(e) => {
                assert!(e.to_string().contains("flattens"), "{name}: {e}");
                continue;
            }
        };
        let again = read_back(&written, Format::GLB);
        assert_eq!(again.triangles.len(), edited.triangles.len(), "{name}");
        let tolerance = 2e-6 * size(&edited.positions).max(size(&model.positions));
        let off = largest_distance(&again.positions, &edited.as_read().0);
        assert!(off <= tolerance, "{name}: {off} is more than {tolerance}");
        let at = folder.path().join(format!("{i}/model.glb"));
        khronos::store(&written, &at);
        pairs.push((path.clone(), at.clone()));
        all.extend([path.clone(), at]);
    }
    let Some(findings) = (!pairs.is_empty()).then(|| khronos::validate(&all)).flatten() else {
        return;
    };
    for (before, after) in pairs {
        let known: std::collections::BTreeSet<_> = findings[&before].union(&findings[&start]).collect();
        let new: Vec<_> = findings[&after]
            .iter()
            .filter(|code| !known.contains(code))
            .filter(is_new)
            .collect();
        assert!(new.is_empty(), "{} merged: {new:?}", before.display());
    }
}
