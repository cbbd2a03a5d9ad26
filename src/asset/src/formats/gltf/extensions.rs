//! What becomes of each glTF extension: in one list, from which the table in `deploy/docs/formats.md` is made.

use super::document::GltfDocument;
use super::rig::avatar::MEASURED;
use super::schema::DRACO;
use super::text::{list_of, value_of};
use crate::files::counted;
use crate::{RigRule, WrittenWarning};
use std::fmt::Write as _;

/// What becomes of an extension when the shape of a model changes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum ExtensionFate {
    /// It stays as it is stored, and what it names changes with the shape; or its lengths do.
    Follows,
    /// pliant writes it again, or what it said in another way.
    Rewritten,
    /// It is left out where it would be wrong, with a warning.
    Dropped,
    /// It stays as it is stored, and speaks of nothing that changes.
    Safe,
    /// It stays as it is stored, and may speak of what changes, with a warning.
    Doubtful,
}

impl ExtensionFate {
    fn in_words(self) -> &'static str {
        match self {
            Self::Follows => "follows",
            Self::Rewritten => "rewritten",
            Self::Dropped => "left out, with a warning",
            Self::Safe => "stays",
            Self::Doubtful => "stays, with a warning",
        }
    }
}

/// What becomes of the extensions of a name.
struct ExtensionRule {
    /// The name; one that ends in `*` stands for all that begin so.
    name: &'static str,
    /// When vertices move.
    posed: ExtensionFate,
    /// When an edit changes triangles.
    edited: ExtensionFate,
    note: &'static str,
}

/// The outline of a primitive: pairs of its vertices.
pub(super) const OUTLINE: &str = "CESIUM_primitive_outline";
/// A mesh's triangles once more, as a closed surface over the same vertices.
pub(super) const MANIFOLD: &str = "EXT_mesh_manifold";
/// Which triangles make a polygon, by their order.
pub(super) const NGONS: &str = "FB_ngon_encoding";
/// Numbers of features, by vertex or by texture.
pub(super) const FEATURES: &str = "EXT_mesh_features";

use ExtensionFate::{Doubtful, Dropped, Follows, Rewritten, Safe};

/// All that are known; the last rule is that of every other. The first that fits holds.
const RULES: [ExtensionRule; 33] = [
    rule(DRACO, Rewritten, Rewritten, "changed primitives come back without it"),
    rule("EXT_meshopt_compression", Rewritten, Rewritten, "as plain floats"),
    rule("KHR_meshopt_compression", Rewritten, Rewritten, "as plain floats"),
    rule("KHR_mesh_quantization", Rewritten, Rewritten, "as plain floats"),
    rule(
        OUTLINE,
        Follows,
        Rewritten,
        "left out, with a warning, where edges of it are gone",
    ),
    rule(MANIFOLD, Follows, Dropped, ""),
    rule(NGONS, Follows, Dropped, ""),
    rule(FEATURES, Follows, Rewritten, "numbers by vertex become an attribute"),
    rule(
        "EXT_structural_metadata",
        Follows,
        Follows,
        "by numbers of features and names of attributes",
    ),
    rule(
        "KHR_animation_pointer",
        Rewritten,
        Rewritten,
        "of joints and passengers",
    ),
    rule("KHR_materials_*", Safe, Safe, ""),
    rule("EXT_materials_*", Safe, Safe, ""),
    rule("KHR_texture_*", Safe, Safe, ""),
    rule("EXT_texture_*", Safe, Safe, ""),
    rule("MSFT_texture_dds", Safe, Safe, ""),
    rule("MSFT_packing_*", Safe, Safe, ""),
    rule("KHR_lights_*", Safe, Safe, ""),
    rule("EXT_lights_*", Safe, Safe, ""),
    rule("EXT_mesh_gpu_instancing", Safe, Safe, "instances show the changed mesh"),
    rule("KHR_node_*", Safe, Safe, ""),
    rule("KHR_xmp*", Safe, Safe, ""),
    rule(
        "MSFT_lod",
        Doubtful,
        Doubtful,
        "the other levels change only if the scene draws them",
    ),
    rule("CESIUM_RTC", Safe, Safe, ""),
    rule("VRMC_materials_*", Safe, Safe, ""),
    rule(
        "VRM",
        Follows,
        Follows,
        "colliders, radii and offsets follow; joints move and do not turn",
    ),
    rule("VRMC_vrm", Follows, Follows, "the place of the eyes follows"),
    rule("VRMC_springBone*", Follows, Follows, "colliders and radii follow"),
    rule("VRMC_node_constraint*", Safe, Safe, "of nodes, whose numbers stay"),
    rule("VRM*", Doubtful, Doubtful, ""),
    rule(
        "KHR_gaussian_splatting",
        Follows,
        Doubtful,
        "centres, rotations, scales and harmonics of degree 1 to 3; in edits of the topology centres alone",
    ),
    rule("KHR_gaussian_splatting_*", Doubtful, Doubtful, "compressed splats stay"),
    rule("KHR_physics_*", Doubtful, Doubtful, "bodies and colliders stay"),
    rule("*", Doubtful, Doubtful, "every other extension"),
];

const fn rule(name: &'static str, posed: ExtensionFate, edited: ExtensionFate, note: &'static str) -> ExtensionRule {
    ExtensionRule {
        name,
        posed,
        edited,
        note,
    }
}

fn rule_of(extension: &str) -> &'static ExtensionRule {
    let fits = |rule: &&ExtensionRule| match rule.name.strip_suffix('*') {
        Some(beginning) => extension.starts_with(beginning),
        None => extension == rule.name,
    };
    RULES.iter().find(fits).unwrap_or(&RULES[RULES.len() - 1])
}

/// The list as a table of Markdown.
pub(crate) fn extension_table() -> String {
    let mut table = "| extension | poses | edits of the topology | |\n|---|---|---|---|\n".to_owned();
    for rule in &RULES {
        let (posed, edited) = (rule.posed.in_words(), rule.edited.in_words());
        let written = writeln!(table, "| `{}` | {posed} | {edited} | {} |", rule.name, rule.note);
        debug_assert!(written.is_ok(), "writing to memory does not fail");
    }
    table
}

/// What is said of extensions that stay in a file whose shape has changed, and may be wrong in it.
pub(super) fn doubtful_extensions(doc: &GltfDocument<'_>, is_edited: bool, rig: RigRule) -> Option<WrittenWarning> {
    let is_doubtful = |name: &&String| {
        let rule = rule_of(name);
        let stays_behind = rig == RigRule::Keep && MEASURED.contains(&name.as_str());
        stays_behind || (if is_edited { rule.edited } else { rule.posed }) == ExtensionFate::Doubtful
    };
    let names: Vec<&str> = doc
        .extensions_used
        .iter()
        .filter(is_doubtful)
        .map(String::as_str)
        .collect();
    let stays = if names.len() == 1 { "stays" } else { "stay" };
    let follows = match names.contains(&"KHR_gaussian_splatting") {
        true => "; of Gaussian splats the centres follow, not their rotations, scales and harmonics",
        false => "",
    };
    (!names.is_empty()).then(|| {
        WrittenWarning::new(
            "extension-kept",
            format!(
                "{} {stays} as stored; what an extension says of places, sizes or vertices may not fit the new shape{follows}",
                names.join(", ")
            ),
            "extensionsUsed",
        )
    })
}

/// What is said of extensions that an edit has left out. `names`: those of primitives and meshes that were.
pub(super) fn dropped_extensions(names: &[&str]) -> Option<WrittenWarning> {
    (!names.is_empty()).then(|| {
        WrittenWarning::new(
            "extension-dropped",
            format!(
                "{} named vertices or triangles that are gone, and was left out there",
                names.join(", ")
            ),
            "meshes",
        )
    })
}

/// What a document has that other formats do not take; or, of one that is merged into another glTF, what stays behind.
pub(super) fn beyond_conversion(doc: &GltfDocument<'_>, is_merged: bool) -> Vec<String> {
    let primitives = || doc.meshes.values.iter().flat_map(|mesh| &mesh.primitives);
    let listed = |key: &str| list_of(doc.text, key).len();
    let lights = value_of(doc.text, "extensions")
        .and_then(|own| value_of(own, "KHR_lights_punctual"))
        .map_or(0, |own| list_of(own, "lights").len());
    let targets = primitives().map(|p| p.targets.len()).sum::<usize>();
    let drawn = primitives().filter(|p| p.mode() < 4 && !is_merged).count();
    let mut found: Vec<String> = [
        counted(if is_merged { 0 } else { doc.skins.len() }, "skin", "skins"),
        counted(doc.animations.len(), "animation", "animations"),
        counted(if is_merged { 0 } else { targets }, "morph target", "morph targets"),
        counted(listed("cameras"), "camera", "cameras"),
        counted(lights, "light", "lights"),
        counted(drawn, "primitive of points or lines", "primitives of points or lines"),
    ]
    .into_iter()
    .flatten()
    .collect();
    // Of materials other formats take the base colour; of compression nothing is left.
    let stays = |name: &&String| !matches!(rule_of(name).posed, Rewritten);
    let of_materials = |name: &str| name.contains("_materials_") || name.contains("_texture_");
    // Pictures of other kinds and where they lie go along.
    const TAKEN: [&str; 5] = [
        "KHR_texture_transform",
        "KHR_texture_basisu",
        "EXT_texture_webp",
        "EXT_texture_avif",
        "MSFT_texture_dds",
    ];
    let names = doc
        .extensions_used
        .iter()
        .filter(stays)
        .filter(|name| !TAKEN.contains(&name.as_str()));
    found.extend(names.filter(|name| !(is_merged && of_materials(name))).cloned());
    found
}
