//! An avatar (VRM) that tests write.

use super::gltf_draft::Draft;
use serde_json::json;

/// A column with a head on a hip; its head's node is turned where the avatar is of VRM 1.0, which allows it.
pub fn avatar(is_first: bool) -> Vec<u8> {
    let mut draft = Draft::default();
    let (mut places, mut weights, mut smile, mut faces) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for ring in 0..=36_u16 {
        let y = f32::from(ring) * 0.05;
        for k in 0..8_u16 {
            let angle = f32::from(k) * std::f32::consts::FRAC_PI_4;
            places.push([0.15 * angle.cos(), y, 0.15 * angle.sin()]);
            let head = ((y - 1.4) / 0.1).clamp(0.0, 1.0);
            weights.push([1.0 - head, head, 0.0, 0.0]);
            smile.push([0.0, 0.0, if y > 1.6 { 0.02 } else { 0.0 }]);
            if ring < 36 {
                let (a, b) = (8 * ring + k, 8 * ring + (k + 1) % 8);
                faces.extend([a, a + 8, b, b, a + 8, b + 8]);
            }
        }
    }
    let count = places.len();
    let joints: Vec<u8> = [0, 1, 0, 0].repeat(count);
    let faces: Vec<u8> = faces.iter().flat_map(|v| v.to_le_bytes()).collect();
    // The inverse of a quarter turn about y, put at 1.5.
    let head = match is_first {
        true => [
            1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.5, 0.0, 1.0,
        ],
        false => [
            0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.0, -1.5, 0.0, 1.0,
        ],
    };
    let hips = [
        1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -0.9, 0.0, 1.0,
    ];
    let targets = json!([{"POSITION": draft.floats(&smile, "VEC3")}]);
    let primitive = json!({
        "attributes": {
            "POSITION": draft.floats(&places, "VEC3"), "WEIGHTS_0": draft.floats(&weights, "VEC4"),
            "JOINTS_0": draft.add(&joints, 5121, "VEC4", count, json!({})),
        },
        "indices": draft.add(&faces, 5123, "SCALAR", faces.len() / 2, json!({})),
        "targets": targets, "material": 0,
    });
    let half = std::f64::consts::FRAC_1_SQRT_2;
    let mut document = json!({
        "scene": 0, "scenes": [{"nodes": [0, 4]}], "materials": [{"name": "skin"}],
        "meshes": [{"primitives": [primitive], "extras": {"targetNames": ["smile"]}}],
        "skins": [{"joints": [1, 2], "inverseBindMatrices": draft.floats(&[hips, head], "MAT4")}],
        "nodes": [
            {"name": "Root", "children": [1]},
            {"name": "hips", "translation": [0, 0.9, 0], "children": [2, 5]},
            {"name": "head", "translation": [0, 0.6, 0], "children": [3, 6]},
            {"name": "hair", "translation": [0, 0.25, -0.1]},
            {"name": "body", "mesh": 0, "skin": 0},
            {"name": "twist", "translation": [0, 0.3, 0]},
            {"name": "jaw", "translation": [0, 0.1, 0.05]},
        ],
        "extensionsUsed": if is_first { json!(["VRM"]) } else { json!(["VRMC_vrm", "VRMC_springBone", "VRMC_node_constraint"]) },
    });
    if is_first {
        document["extensions"] = json!({"VRM": {
            "specVersion": "0.0",
            "humanoid": {"humanBones": [{"bone": "hips", "node": 1}, {"bone": "head", "node": 2}, {"bone": "jaw", "node": 6}]},
            "firstPerson": {"firstPersonBone": -1, "firstPersonBoneOffset": {"x": 0.0, "y": 0.1, "z": 0.12}, "meshAnnotations": []},
            "blendShapeMaster": {"blendShapeGroups": [{"presetName": "joy", "binds": [{"mesh": 0, "index": 0, "weight": 100}]}]},
            "secondaryAnimation": {
                "boneGroups": [{"stiffiness": 1, "gravityPower": 0.5, "gravityDir": {"x": 0, "y": -1, "z": 0}, "hitRadius": 0.02,
                    "bones": [2], "colliderGroups": [0, 1]}],
                "colliderGroups": [
                    {"node": 2, "colliders": [{"offset": {"x": 0.01, "y": 0.15, "z": -0.03}, "radius": 0.1}]},
                    {"node": 1, "colliders": [{"offset": {"x": 0, "y": 0.1, "z": 0.02}, "radius": 0.14}]},
                ],
            },
            "materialProperties": [{"name": "skin", "shader": "VRM_USE_GLTFSHADER"}],
        }});
    } else {
        document["nodes"][2]["rotation"] = json!([0, half, 0, half]);
        document["nodes"][5]["extensions"] = json!({"VRMC_node_constraint": {"specVersion": "1.0",
            "constraint": {"rotation": {"source": 2, "weight": 0.5}}}});
        document["extensions"] = json!({
            "VRMC_vrm": {
                "specVersion": "1.0", "meta": {"name": "column"},
                "humanoid": {"humanBones": {"hips": {"node": 1}, "head": {"node": 2}, "jaw": {"node": 6}}},
                "expressions": {"preset": {"happy": {"morphTargetBinds": [{"node": 4, "index": 0, "weight": 1}]}}},
                "lookAt": {"type": "bone", "offsetFromHeadBone": [0.12, 0.1, 0.0]},
            },
            "VRMC_springBone": {
                "specVersion": "1.0",
                "colliders": [
                    {"node": 2, "shape": {"sphere": {"offset": [0.01, 0.15, -0.03], "radius": 0.1}}},
                    {"node": 1, "shape": {"capsule": {"offset": [0, -0.3, 0.02], "tail": [0, 0.2, 0], "radius": 0.13}}},
                ],
                "springs": [{"joints": [{"node": 2, "hitRadius": 0.02, "stiffness": 1, "gravityPower": 0.5}, {"node": 3}]}],
            },
        });
    }
    draft.glb(document)
}
