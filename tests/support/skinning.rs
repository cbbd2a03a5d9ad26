//! A plain player of glTF skins: where a file puts its vertices, in the rest pose or at a time of a clip. Written without the code
//! under test, from the format's specification.

use super::gltf_parsed::Parsed;
use glam::{DAffine3, DMat4, DQuat, DVec3};
use serde_json::Value;
use std::collections::BTreeMap;

/// A time of a clip.
#[derive(Clone, Copy)]
pub struct ClipTime {
    pub clip: usize,
    pub seconds: f64,
}

/// What is drawn of one primitive of the scene.
pub struct DrawnPrimitive {
    pub node: usize,
    pub primitive: usize,
    pub positions: Vec<DVec3>,
}

fn whole(value: &Value, missing: usize) -> usize {
    value.as_u64().map_or(missing, |v| v as usize)
}

/// The items of a list; none of what is not one.
pub fn list(value: &Value) -> &[Value] {
    value.as_array().map_or(&[], Vec::as_slice)
}

/// All numbers of an accessor; `None` when it is compressed.
pub fn numbers(file: &Parsed, accessor: &Value) -> Option<Vec<f64>> {
    let json = &file.json;
    let accessor = json["accessors"].get(accessor.as_u64()? as usize)?;
    let lanes = match accessor["type"].as_str()? {
        "SCALAR" => 1,
        "VEC2" => 2,
        "VEC3" => 3,
        "VEC4" => 4,
        "MAT4" => 16,
        _ => return None,
    };
    let component = whole(&accessor["componentType"], 0);
    let count = whole(&accessor["count"], 0);
    let mut values = vec![0.0; count * lanes];
    if !accessor["bufferView"].is_null() {
        let start = whole(&accessor["byteOffset"], 0);
        let elements: Vec<usize> = (0..count).collect();
        fill(
            file,
            &accessor["bufferView"],
            start,
            component,
            lanes,
            &elements,
            &mut values,
        )?;
    }
    let sparse = &accessor["sparse"];
    if !sparse.is_null() {
        let replaced = whole(&sparse["count"], 0);
        let all: Vec<usize> = (0..replaced).collect();
        let mut at = vec![0.0; replaced];
        let indices = &sparse["indices"];
        let kind = whole(&indices["componentType"], 0);
        fill(
            file,
            &indices["bufferView"],
            whole(&indices["byteOffset"], 0),
            kind,
            1,
            &all,
            &mut at,
        )?;
        let at: Vec<usize> = at.into_iter().map(|i| i as usize).collect();
        let from = &sparse["values"];
        fill(
            file,
            &from["bufferView"],
            whole(&from["byteOffset"], 0),
            component,
            lanes,
            &at,
            &mut values,
        )?;
    }
    if accessor["normalized"] == true {
        let largest = match component {
            5120 => 127.0,
            5121 => 255.0,
            5122 => 32767.0,
            _ => 65535.0,
        };
        values.iter_mut().for_each(|v| *v = (*v / largest).max(-1.0));
    }
    Some(values)
}

fn fill(
    file: &Parsed,
    view: &Value,
    offset: usize,
    component: usize,
    lanes: usize,
    elements: &[usize],
    values: &mut [f64],
) -> Option<()> {
    let view = &file.json["bufferViews"][view.as_u64()? as usize];
    if !view["extensions"].is_null() {
        return None;
    }
    let bytes = &file.buffers[whole(&view["buffer"], 0)];
    let size = match component {
        5120 | 5121 => 1,
        5122 | 5123 => 2,
        _ => 4,
    };
    let stride = whole(&view["byteStride"], size * lanes);
    for (i, &element) in elements.iter().enumerate() {
        for lane in 0..lanes {
            let at = whole(&view["byteOffset"], 0) + offset + i * stride + lane * size;
            let b = bytes.get(at..at + size)?;
            values[element * lanes + lane] = match component {
                5120 => f64::from(b[0] as i8),
                5121 => f64::from(b[0]),
                5122 => f64::from(i16::from_le_bytes([b[0], b[1]])),
                5123 => f64::from(u16::from_le_bytes([b[0], b[1]])),
                5125 => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
                _ => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            };
        }
    }
    Some(())
}

/// Translation, rotation and scale of a node, or its matrix.
#[derive(Clone, Copy)]
enum Local {
    Parts(DVec3, DQuat, DVec3),
    Matrix(DAffine3),
}

fn floats(value: &Value) -> Option<Vec<f64>> {
    value
        .as_array()
        .map(|l| l.iter().map(|v| v.as_f64().expect("a number")).collect())
}

fn local_of(node: &Value) -> Local {
    if let Some(m) = floats(&node["matrix"]) {
        return Local::Matrix(DAffine3::from_mat4(DMat4::from_cols_slice(&m)));
    }
    let three = |key: &str, missing: DVec3| floats(&node[key]).map_or(missing, |v| DVec3::from_slice(&v));
    let turn = floats(&node["rotation"]).map_or(DQuat::IDENTITY, |v| DQuat::from_slice(&v).normalize());
    Local::Parts(three("translation", DVec3::ZERO), turn, three("scale", DVec3::ONE))
}

/// World transforms of all nodes.
pub fn world_transforms(file: &Parsed, at: Option<ClipTime>) -> Option<Vec<DAffine3>> {
    let nodes = list(&file.json["nodes"]);
    let mut locals: Vec<Local> = nodes.iter().map(local_of).collect();
    if let Some(at) = at {
        play(file, at, &mut locals)?;
    }
    let mut parent = vec![None; nodes.len()];
    for (i, node) in nodes.iter().enumerate() {
        list(&node["children"])
            .iter()
            .for_each(|c| parent[whole(c, 0)] = Some(i));
    }
    let own = |i: usize| match locals[i] {
        Local::Parts(t, r, s) => DAffine3::from_scale_rotation_translation(s, r, t),
        Local::Matrix(m) => m,
    };
    let world = |mut i: usize| {
        let mut all = own(i);
        while let Some(p) = parent[i] {
            all = own(p) * all;
            i = p;
        }
        all
    };
    Some((0..nodes.len()).map(world).collect())
}

/// Puts the nodes where a clip has them.
fn play(file: &Parsed, at: ClipTime, locals: &mut [Local]) -> Option<()> {
    let clip = &file.json["animations"][at.clip];
    for channel in list(&clip["channels"]) {
        let (path, sampler) = (
            channel["target"]["path"].as_str()?,
            &clip["samplers"][whole(&channel["sampler"], 0)],
        );
        let lanes = match path {
            "rotation" => 4,
            "translation" | "scale" => 3,
            _ => continue,
        };
        let Some(node) = channel["target"]["node"].as_u64() else {
            continue;
        };
        let value = sample(file, sampler, (lanes, path == "rotation"), at.seconds)?;
        let Local::Parts(t, r, s) = &mut locals[node as usize] else {
            continue;
        };
        match path {
            "rotation" => *r = DQuat::from_slice(&value).normalize(),
            "translation" => *t = DVec3::from_slice(&value),
            _ => *s = DVec3::from_slice(&value),
        }
    }
    Some(())
}

/// The value of a sampler at a time: so many numbers, or a turn.
fn sample(file: &Parsed, sampler: &Value, (lanes, is_turn): (usize, bool), seconds: f64) -> Option<Vec<f64>> {
    let (times, values) = (numbers(file, &sampler["input"])?, numbers(file, &sampler["output"])?);
    let kind = sampler["interpolation"].as_str().unwrap_or("LINEAR");
    let cubic = kind == "CUBICSPLINE";
    let element = |key: usize, part: usize| {
        let at = if cubic { (3 * key + part) * lanes } else { key * lanes };
        values[at..at + lanes].to_vec()
    };
    let next = times.partition_point(|&t| t <= seconds);
    if next == 0 || next == times.len() {
        return Some(element(next.saturating_sub(1), 1));
    }
    let (from, span) = (next - 1, times[next] - times[next - 1]);
    let u = (seconds - times[from]) / span;
    let (a, b) = (element(from, 1), element(next, 1));
    Some(match kind {
        "STEP" => a,
        "CUBICSPLINE" => {
            let (out, into) = (element(from, 2), element(next, 0));
            let (u2, u3) = (u * u, u * u * u);
            let at = |i: usize| {
                (2.0 * u3 - 3.0 * u2 + 1.0) * a[i]
                    + span * (u3 - 2.0 * u2 + u) * out[i]
                    + (3.0 * u2 - 2.0 * u3) * b[i]
                    + span * (u3 - u2) * into[i]
            };
            (0..lanes).map(at).collect()
        }
        _ if is_turn => DQuat::from_slice(&a)
            .normalize()
            .slerp(DQuat::from_slice(&b).normalize(), u)
            .to_array()
            .to_vec(),
        _ => a.iter().zip(&b).map(|(a, b)| a + (b - a) * u).collect(),
    })
}

/// How long a clip is, in seconds.
pub fn clip_length(file: &Parsed, clip: usize) -> f64 {
    let samplers = list(&file.json["animations"][clip]["samplers"]);
    let last = samplers
        .iter()
        .filter_map(|s| numbers(file, &s["input"])?.last().copied());
    last.fold(0.0, f64::max)
}

/// The weights of the morph targets of a node at a time of a clip, where it has them.
fn clip_weights(file: &Parsed, at: ClipTime, node: usize) -> Option<Vec<f64>> {
    let clip = &file.json["animations"][at.clip];
    let mut channels = list(&clip["channels"])
        .iter()
        .map(|channel| (channel, &channel["target"]));
    let is_own = |target: &Value| target["path"] == "weights" && target["node"].as_u64() == Some(node as u64);
    let (channel, _) = channels.find(|(_, target)| is_own(target))?;
    let mesh = whole(&file.json["nodes"][node]["mesh"], 0);
    let targets = list(&file.json["meshes"][mesh]["primitives"][0]["targets"]).len();
    let sampler = &clip["samplers"][whole(&channel["sampler"], 0)];
    sample(file, sampler, (targets, false), at.seconds)
}

/// Everything that the nodes draw, with morph targets at these weights or those of the clip; `None` when some of it is
/// compressed.
pub fn draw(file: &Parsed, at: Option<ClipTime>, weights: &[f64]) -> Option<Vec<DrawnPrimitive>> {
    let json = &file.json;
    let world = world_transforms(file, at)?;
    let mut drawn = Vec::new();
    for (n, node) in list(&json["nodes"]).iter().enumerate() {
        let Some(mesh) = node["mesh"].as_u64() else { continue };
        let of_clip = at.and_then(|at| clip_weights(file, at, n));
        let weights = of_clip.as_deref().unwrap_or(weights);
        for (p, primitive) in list(&json["meshes"][mesh as usize]["primitives"]).iter().enumerate() {
            if whole(&primitive["mode"], 4) < 4 || !primitive["extensions"]["KHR_draco_mesh_compression"].is_null() {
                continue;
            }
            let attributes = &primitive["attributes"];
            let mut stored = numbers(file, &attributes["POSITION"])?;
            for (target, weight) in list(&primitive["targets"]).iter().zip(weights) {
                if !target["POSITION"].is_null() {
                    let moves = numbers(file, &target["POSITION"])?;
                    stored.iter_mut().zip(moves).for_each(|(p, d)| *p += weight * d);
                }
            }
            let stored: Vec<DVec3> = stored.chunks(3).map(DVec3::from_slice).collect();
            let skinned = !node["skin"].is_null() && !attributes["JOINTS_0"].is_null();
            let positions = if skinned {
                skin(
                    file,
                    &json["skins"][whole(&node["skin"], 0)],
                    attributes,
                    &stored,
                    &world,
                )?
            } else {
                stored.iter().map(|&p| world[n].transform_point3(p)).collect()
            };
            drawn.push(DrawnPrimitive {
                node: n,
                primitive: p,
                positions,
            });
        }
    }
    Some(drawn)
}

fn skin(file: &Parsed, skin: &Value, attributes: &Value, stored: &[DVec3], world: &[DAffine3]) -> Option<Vec<DVec3>> {
    let bind = match &skin["inverseBindMatrices"] {
        Value::Null => None,
        accessor => Some(numbers(file, accessor)?),
    };
    let place = |(i, joint): (usize, &Value)| {
        let bind = bind.as_ref().map_or(DAffine3::IDENTITY, |b| {
            DAffine3::from_mat4(DMat4::from_cols_slice(&b[16 * i..16 * i + 16]))
        });
        world[whole(joint, 0)] * bind
    };
    let joints: Vec<DAffine3> = list(&skin["joints"]).iter().enumerate().map(place).collect();
    let mut sums: Vec<BTreeMap<usize, f64>> = vec![BTreeMap::new(); stored.len()];
    for set in 0..8 {
        let joint = &attributes[format!("JOINTS_{set}")];
        if joint.is_null() {
            break;
        }
        let (joint, weight) = (
            numbers(file, joint)?,
            numbers(file, &attributes[format!("WEIGHTS_{set}")])?,
        );
        for (i, (joint, weight)) in joint.into_iter().zip(weight).enumerate() {
            *sums[i / 4].entry(joint as usize).or_insert(0.0) += weight;
        }
    }
    let one = |(p, sum): (&DVec3, &BTreeMap<usize, f64>)| {
        let total: f64 = sum.values().sum();
        let parts = sum.iter().filter(|(_, w)| **w > 0.0);
        parts.map(|(&j, w)| joints[j].transform_point3(*p) * (w / total)).sum()
    };
    Some(stored.iter().zip(&sums).map(one).collect())
}
