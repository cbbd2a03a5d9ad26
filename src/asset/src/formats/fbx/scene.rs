//! Opening an FBX with `ufbx`: options, limits, what its errors and repairs are called here, and its materials.

use super::super::gltf::{self, GlbWriter};
use crate::files::ReadWatch;
use crate::format::{FormatDetails, Recognition};
use crate::look::{MaterialPicture, inside_folder};
use crate::{Error, FileSet, Format, Limits};
use bytes::Bytes;
use pliant_exec::progress::Silent;
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use ufbx::{ErrorType, Material, MaterialMap, Texture, TextureType};

/// How deep nodes may hang below each other: far more than any rig, and few enough for all that walks them.
const DEEPEST: u32 = 1000;

/// How many repairs a warning lists.
const MOST_LISTED: usize = 4;

/// Bytes of memory that the reader is given first for each byte of a file.
const BYTES_PER_BYTE: u64 = 2;

/// Bytes of memory that it is given first at least.
const LEAST_BYTES: u64 = 1 << 20;

/// Lets the reader work within as much memory as is reserved for it, and reserves twice as much for another try where that was too
/// little: what a file unpacks to is known only when it is unpacked. `work` is given what makes the options of its two
/// allocators. Returns what the reader said, and the bytes that are reserved: the caller releases them.
pub(super) fn within_reserve<T>(
    watch: &ReadWatch<'_>,
    file_bytes: usize,
    work: impl Fn(&dyn Fn() -> ufbx::AllocatorOpts) -> Result<T, Box<ufbx::Error>>,
) -> Result<(Result<T, Box<ufbx::Error>>, u64), Error> {
    let mut each = (file_bytes as u64).saturating_mul(BYTES_PER_BYTE).max(LEAST_BYTES);
    loop {
        watch.check()?;
        let reserved = each.saturating_mul(2);
        watch.reserve(reserved)?;
        match work(&|| allocator(each)) {
            Err(error) if error.type_ == ErrorType::MemoryLimit => {
                watch.release(reserved);
                each = reserved;
            }
            done => return Ok((done, reserved)),
        }
    }
}

/// An allocator that holds as many bytes at most, in so many pieces.
fn allocator(bytes: u64) -> ufbx::AllocatorOpts {
    ufbx::AllocatorOpts {
        memory_limit: usize::try_from(bytes).unwrap_or(usize::MAX),
        allocation_limit: 10_000_000,
        ..Default::default()
    }
}

/// Opens a file: in metres, Y up, right-handed, with what glTF cannot say of nodes (geometric transforms, ways to inherit
/// scale) worked into geometry and nodes. Nothing outside of `files` is opened.
pub(super) fn open(files: &FileSet, watch: &ReadWatch<'_>) -> Result<ufbx::SceneRoot, Error> {
    load(files, watch, false)
}

fn load(files: &FileSet, watch: &ReadWatch<'_>, names_only: bool) -> Result<ufbx::SceneRoot, Error> {
    let options = |allocator: &dyn Fn() -> ufbx::AllocatorOpts| ufbx::LoadOpts {
        temp_allocator: allocator(),
        result_allocator: allocator(),
        file_format: ufbx::FileFormat::Fbx,
        no_format_from_content: true,
        no_format_from_extension: true,
        ignore_geometry: names_only,
        ignore_animation: names_only,
        load_external_files: false,
        index_error_handling: ufbx::IndexErrorHandling::AbortLoading,
        clean_skin_weights: true,
        use_blender_pbr_material: true,
        normalize_normals: true,
        node_depth_limit: DEEPEST,
        target_axes: ufbx::CoordinateAxes::right_handed_y_up(),
        target_unit_meters: 1.0,
        space_conversion: ufbx::SpaceConversion::ModifyGeometry,
        geometry_transform_handling: ufbx::GeometryTransformHandling::ModifyGeometry,
        inherit_mode_handling: ufbx::InheritModeHandling::Compensate,
        handedness_conversion_axis: ufbx::MirrorAxis::X,
        ..Default::default()
    };
    let (scene, reserved) = within_reserve(watch, files.main.len(), |allocator| {
        ufbx::load_memory(&files.main, options(allocator)).map_err(Box::new)
    })?;
    let scene = scene.map_err(|error| fault_of(&error, files))?;
    // What was temporary is gone.
    let kept = scene.metadata.result_memory_used as u64;
    watch.release(reserved.saturating_sub(kept));
    Ok(scene)
}

/// What the reader says of a file, in the words of this house.
fn fault_of(error: &ufbx::Error, files: &FileSet) -> Error {
    let unsupported = |problem: &str, hint: &str| Error::unsupported(FORMAT, "file", problem, hint);
    match error.type_ {
        ErrorType::AllocationLimit | ErrorType::OutOfMemory => unsupported(
            "decoding takes more pieces of memory than are allowed",
            "divide the model",
        ),
        ErrorType::NodeDepthLimit => refuse("nodes", format!("are nested more than {DEEPEST} levels deep")),
        ErrorType::UnsupportedVersion => unsupported(
            "is of a version of FBX that is not read",
            "export it as FBX 2014 or newer, or as glb",
        ),
        ErrorType::EmptyFile => refuse("file", "is empty"),
        ErrorType::TruncatedFile => refuse(format!("byte {}", files.main.len()), "the file ends too early"),
        ErrorType::UnrecognizedFileFormat => refuse("file", "does not begin as an FBX does, binary or text"),
        ErrorType::BadIndex => refuse(
            "meshes",
            "an index of a polygon or attribute is out of range of what it counts",
        ),
        _ => {
            // The reader often says no more than that it failed.
            let cause = match (&*error.description, error.info()) {
                ("Failed to load", "") => "a list, number or index in it cannot be".to_owned(),
                (description, "") => description.to_lowercase(),
                (description, info) => format!("{} ({info})", description.to_lowercase()),
            };
            refuse("file", format!("is broken: {cause}"))
        }
    }
}

/// Reports all repairs by the reader in one warning.
pub(super) fn report_repairs(scene: &ufbx::Scene, notes: &mut TranslationNotes) {
    let list = &scene.metadata.warnings;
    let texts: Vec<String> = list
        .iter()
        .take(MOST_LISTED)
        .map(|warning| match warning.count {
            0 | 1 => warning.description.to_lowercase(),
            count => format!("{} ({count} times)", warning.description.to_lowercase()),
        })
        .collect();
    if !texts.is_empty() {
        let more = list.len().saturating_sub(MOST_LISTED);
        let rest = if more > 0 {
            format!(" and {more} more")
        } else {
            String::new()
        };
        let message = format!("repaired while reading: {}{rest}", texts.join("; "));
        notes.warn("fbx-mended", message, "file");
    }
}

/// The file of a texture, relative to the model's folder and inside of it: the relative name, else the last part of any.
/// Exporters write paths of their own machine, and the picture lies beside the model where it came along at all.
pub(super) fn texture_file(texture: &ufbx::Texture) -> Option<String> {
    let names = [
        &texture.relative_filename,
        &texture.filename,
        &texture.absolute_filename,
    ];
    let inside = names.iter().find_map(|name| inside_folder(name));
    inside.or_else(|| {
        let last_part = |name: &str| inside_folder(name.rsplit(['/', '\\']).next().unwrap_or_default());
        names.iter().find_map(|name| last_part(name))
    })
}

/// The bytes of a texture that the file holds itself.
pub(super) fn embedded_bytes(texture: &ufbx::Texture) -> Option<&[u8]> {
    let own: &[u8] = &texture.content;
    let of_video = || texture.video.as_ref().map_or(&[][..], |video| &*video.content);
    let bytes = if own.is_empty() { of_video() } else { own };
    (!bytes.is_empty()).then_some(bytes)
}

/// The names of the texture files beside the model, each once. None where the file cannot be read: its reader reports
/// why.
pub(super) fn texture_names(files: &FileSet) -> Vec<String> {
    let limits = Limits::default();
    let watch = ReadWatch::new(&limits, &Silent, files.total_bytes());
    let Ok(scene) = load(files, &watch, true) else {
        return Vec::new();
    };
    let mut seen = BTreeSet::new();
    let outside = (&scene.textures)
        .into_iter()
        .filter(|texture| embedded_bytes(texture).is_none());
    outside
        .filter_map(texture_file)
        .filter(|name| seen.insert(name.clone()))
        .collect()
}

/// FBX, by what it is known.
pub(in super::super) const FORMAT: Format = Format::new(&FormatDetails {
    name: "fbx",
    aliases: &[],
    media_types: &["application/vnd.autodesk.fbx", "model/fbx", "application/fbx"],
    recognise: |bytes| {
        let begins = |mark: &[u8]| bytes.starts_with(mark);
        Recognition::mark(begins(b"Kaydara FBX Binary") || begins(b"; FBX") || begins(b"FBXHeaderExtension"))
    },
});

/// The refusal of a file at a place.
pub(super) fn refuse(place: impl Into<String>, problem: impl Into<String>) -> Error {
    Error::malformed(FORMAT, place, problem)
}

/// An element as texts name it.
pub(super) fn place_of(kind: &str, element: &ufbx::Element) -> String {
    format!("{kind} {} \"{}\"", element.typed_id, &*element.name)
}

/// Warnings, gathered while a file is translated.
#[derive(Default)]
pub(super) struct TranslationNotes {
    /// (code, message, place).
    pub warnings: Vec<(String, String, String)>,
    /// What the file has and glTF cannot express, or is not used, each once.
    left_out: Vec<&'static str>,
}

impl TranslationNotes {
    pub(super) fn warn(&mut self, code: &str, message: impl Into<String>, place: impl Into<String>) {
        self.warnings.push((code.into(), message.into(), place.into()));
    }

    /// Notes a kind of thing that does not come along.
    pub(super) fn leave_out(&mut self, what: &'static str) {
        if !self.left_out.contains(&what) {
            self.left_out.push(what);
        }
    }

    /// All warnings, the last of which says what does not come along.
    pub(super) fn finish(mut self) -> Vec<(String, String, String)> {
        if !self.left_out.is_empty() {
            let message = format!("not carried over: {}", self.left_out.join(", "));
            self.warn("fbx-left-out", message, "file");
        }
        self.warnings
    }
}

/// The materials in use, by their numbers in the file, and the pictures that they show.
pub(super) struct MaterialTable<'a> {
    files: &'a FileSet,
    /// By the number in the file the number in the asset.
    known: BTreeMap<u32, usize>,
    materials: Vec<Value>,
    /// The pictures that materials show.
    pictures: Vec<MaterialPicture>,
}

/// Sections of the asset by their names.
pub(super) type AssetSections = [(&'static str, Vec<Value>); 3];

impl<'a> MaterialTable<'a> {
    /// A table without materials; pictures beside the model are found in `files`.
    pub(super) fn new(files: &'a FileSet) -> Self {
        Self {
            files,
            known: BTreeMap::new(),
            materials: Vec::new(),
            pictures: Vec::new(),
        }
    }

    /// The number of a material in the asset.
    pub(super) fn number_of(&mut self, material: &Material, notes: &mut TranslationNotes) -> usize {
        let id = material.element.typed_id;
        if let Some(known) = self.known.get(&id) {
            return *known;
        }
        let json = self.material_json(material, notes);
        self.materials.push(json);
        self.known.insert(id, self.materials.len() - 1);
        self.materials.len() - 1
    }

    fn material_json(&mut self, material: &Material, notes: &mut TranslationNotes) -> Value {
        let pbr = &material.pbr;
        let texture = pbr
            .base_color
            .texture
            .as_ref()
            .filter(|_| pbr.base_color.texture_enabled);
        let picture = texture.and_then(|texture| self.picture_of(texture, notes));
        let factor = first_value(&pbr.base_factor).unwrap_or(1.0);
        let colour = &pbr.base_color;
        // A picture stands in place of the colour.
        let rgb = match picture {
            None if colour.has_value => {
                let v = colour.value_vec4;
                [v.x, v.y, v.z].map(|x| unit(x * factor))
            }
            _ => [1.0; 3],
        };
        let opacity = opacity_of(material);
        let mut base = json!({
            "baseColorFactor": [rgb[0], rgb[1], rgb[2], opacity],
            "metallicFactor": first_value(&pbr.metalness).map_or(0.0, unit),
            "roughnessFactor": first_value(&pbr.roughness).map_or(1.0, unit),
        });
        if let Some(number) = picture {
            base["baseColorTexture"] = json!({"index": number});
        }
        let mut json = json!({"pbrMetallicRoughness": base});
        if !material.element.name.is_empty() {
            json["name"] = json!(&*material.element.name);
        }
        if opacity < 1.0 || pbr.opacity.texture.is_some() {
            json["alphaMode"] = json!("BLEND");
        }
        if material.features.double_sided.enabled {
            json["doubleSided"] = json!(true);
        }
        let maps = [&pbr.normal_map, &pbr.roughness, &pbr.metalness, &pbr.emission_color];
        if maps.iter().any(|map| map.texture.is_some()) {
            notes.leave_out("textures other than the base colour's");
        }
        json
    }

    /// The number of the picture that a texture shows; of several layers the lowest.
    fn picture_of(&mut self, texture: &Texture, notes: &mut TranslationNotes) -> Option<usize> {
        let texture = if texture.type_ == TextureType::File {
            texture
        } else {
            notes.leave_out("layers and procedures of textures");
            texture.file_textures.iter().next()?
        };
        if texture.has_uv_transform {
            notes.leave_out("shifts and turns of textures");
        }
        let name = texture_file(texture).unwrap_or_else(|| format!("texture{}", texture.element.typed_id));
        let embedded = embedded_bytes(texture);
        let same =
            |known: &MaterialPicture| known.name == name && (embedded.is_none() || known.bytes.as_deref() == embedded);
        let found = self.pictures.iter().position(same);
        Some(found.unwrap_or_else(|| {
            let beside = || self.files.companions.get(&name).cloned();
            let bytes = embedded.map(Bytes::copy_from_slice).or_else(beside);
            self.pictures.push(MaterialPicture { name, bytes });
            self.pictures.len() - 1
        }))
    }

    /// The sections, with pictures put into the buffer; those of kinds that it cannot hold are files beside the asset.
    pub(super) fn finish(self, buffer: &mut GlbWriter) -> Result<(AssetSections, BTreeMap<String, Bytes>), Error> {
        let (mut images, mut companions) = (Vec::new(), BTreeMap::new());
        for MaterialPicture { name, bytes } in self.pictures {
            let kind = bytes.as_deref().and_then(|bytes| gltf::media_type_of(&name, bytes));
            match (bytes, kind) {
                (Some(bytes), Some(kind)) => {
                    let view = buffer.add_view(&bytes)?;
                    images.push(json!({"bufferView": view, "mimeType": kind, "name": name}));
                }
                (bytes, _) => {
                    images.push(json!({"uri": gltf::uri_of_name(&name)}));
                    companions.extend(bytes.map(|bytes| (name, bytes)));
                }
            }
        }
        let textures = (0..images.len()).map(|i| json!({"source": i})).collect();
        let sections = [
            ("materials", self.materials),
            ("textures", textures),
            ("images", images),
        ];
        Ok((sections, companions))
    }
}

/// How opaque a material is: what it says, else what its transparency leaves. Exporters write a transparency of one for
/// opaque materials too, so nothing is taken to be invisible by that.
fn opacity_of(material: &Material) -> f32 {
    if let Some(opacity) = first_value(&material.pbr.opacity) {
        return unit(opacity);
    }
    let stated = ufbx::find_prop(&material.element.props, "Opacity").map(|prop| prop.value_vec4.x);
    if let Some(opacity) = stated.filter(|opacity| opacity.is_finite()) {
        return unit(opacity);
    }
    let fbx = &material.fbx;
    let colour = if fbx.transparency_color.has_value {
        let v = fbx.transparency_color.value_vec4;
        (v.x + v.y + v.z) / 3.0
    } else {
        1.0
    };
    let left = unit(1.0 - first_value(&fbx.transparency_factor).unwrap_or(0.0) * colour);
    if left > 0.0 { left } else { 1.0 }
}

/// The number that a map says, where it says one.
fn first_value(map: &MaterialMap) -> Option<f64> {
    (map.has_value && map.value_vec4.x.is_finite()).then_some(map.value_vec4.x)
}

fn unit(value: f64) -> f32 {
    if value.is_finite() {
        value.clamp(0.0, 1.0) as f32
    } else {
        1.0
    }
}
