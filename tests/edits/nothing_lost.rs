//! Nothing of a file vanishes without a word: what it has beside triangles is counted before and after, and a difference has a
//! warning that names it.

use crate::support::data::data_folder;
use crate::support::gltf_parsed::parse;
use crate::support::gltf_sets::{companions_of, file_set, models_below};
use glam::DVec3;
use pliant::asset::{Format, WrittenFiles};
use pliant::edit::{KeptSide, SubdivisionScheme};
use pliant::engine::{
    Creases, CutLine, Deformer, DeformerLimits, Edit, Handle, HandlePose, OpenOptions, Plane, Region, SolveSettings,
};
use pliant::exec::Exec;
use pliant::mesh::BoundingBox;
use pliant::pool::Pool;
use pliant::progress::Silent;
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Extensions of how numbers are packed, which pliant writes as plain floats; and what other formats take of materials.
const PACKINGS: [&str; 4] = [
    "KHR_draco_mesh_compression",
    "EXT_meshopt_compression",
    "KHR_meshopt_compression",
    "KHR_mesh_quantization",
];
const TAKEN: [&str; 5] = [
    "KHR_texture_transform",
    "KHR_texture_basisu",
    "EXT_texture_webp",
    "EXT_texture_avif",
    "MSFT_texture_dds",
];

type Counts = BTreeMap<String, usize>;

/// What a file has beside triangles, each by the word that a warning has for it.
fn contents(main: &[u8], companions: &BTreeMap<String, Vec<u8>>, format: Format) -> Counts {
    let mut found = if format == Format::OBJ {
        contents_of_obj(&String::from_utf8_lossy(main))
    } else if format == Format::PLY {
        contents_of_ply(&String::from_utf8_lossy(main))
    } else {
        contents_of_gltf(&parse(main, companions).json)
    };
    found.retain(|_, count| *count > 0);
    found
}

fn contents_of_gltf(json: &Value) -> Counts {
    let count = |list: &Value| list.as_array().map_or(0, Vec::len);
    let primitives: Vec<&Value> = (json["meshes"].as_array().into_iter().flatten())
        .flat_map(|mesh| mesh["primitives"].as_array().into_iter().flatten())
        .collect();
    let drawn = primitives
        .iter()
        .filter(|p| p["mode"].as_u64().is_some_and(|mode| mode < 4));
    let mut found = Counts::from([
        ("skin".into(), count(&json["skins"])),
        ("animation".into(), count(&json["animations"])),
        ("camera".into(), count(&json["cameras"])),
        (
            "light".into(),
            count(&json["extensions"]["KHR_lights_punctual"]["lights"]),
        ),
        (
            "morph target".into(),
            primitives.iter().map(|p| count(&p["targets"])).max().unwrap_or(0),
        ),
        ("of points or lines".into(), drawn.count()),
        (OWN.0.into(), count(&json["nodes"])),
        (OWN.1.into(), count(&json["materials"])),
        (OWN.2.into(), count(&json["images"])),
    ]);
    let used = json["extensionsUsed"].as_array().into_iter().flatten();
    let used = used.filter_map(Value::as_str).filter(|name| !PACKINGS.contains(name));
    found.extend(used.map(|name| (name.to_owned(), 1)));
    let named = primitives.iter().filter_map(|p| p["attributes"].as_object());
    for attribute in named.flat_map(|attributes| attributes.keys()) {
        let name = format!("attribute {attribute}");
        found.insert(name, 1);
    }
    found
}

/// What other formats than glTF are not expected to have, without a warning: the tree and the look, of which each takes what it
/// can. They have to stay in glTF.
const OWN: (&str, &str, &str) = ("node of the file", "material of the file", "image of the file");

fn contents_of_obj(text: &str) -> Counts {
    let statements = |keyword: &'static str| text.lines().filter(move |line| line.trim_start().starts_with(keyword));
    let names = |keyword: &'static str| statements(keyword).collect::<BTreeSet<&str>>().len();
    Counts::from([
        ("line".into(), statements("l ").count()),
        ("points".into(), statements("p ").count()),
        ("curve".into(), statements("curv").count() + statements("surf").count()),
        // One name for all divides nothing.
        ("group".into(), (names("g ") + names("o ")).saturating_sub(1)),
        ("smoothing".into(), names("s ").saturating_sub(1)),
        ("attribute material".into(), names("usemtl ")),
        ("attribute TEXCOORD_0".into(), statements("vt ").count().min(1)),
        ("attribute NORMAL".into(), statements("vn ").count().min(1)),
    ])
}

fn contents_of_ply(text: &str) -> Counts {
    let header = text.lines().take_while(|line| *line != "end_header");
    let mut element = "";
    let mut found = Counts::new();
    for line in header {
        let words: Vec<&str> = line.split_whitespace().collect();
        match words[..] {
            ["element", name, rows] => {
                element = name;
                if name != "vertex" && name != "face" {
                    found.insert(name.into(), rows.parse().expect("a number"));
                }
            }
            ["property", .., name] if element == "vertex" || element == "face" => {
                found.insert(format!("attribute {element} {name}"), 1);
            }
            _ => {}
        }
    }
    found
}

/// What is fewer in the written file and not named by a warning.
fn silently_lost(before: &Counts, done: &Done, file: &Written, of: Format, beside: Option<&Counts>) -> Vec<String> {
    let (after, written) = (&file.contents, &file.files);
    let is_converted = file.format != of;
    let of_file = |what: &str| written.warnings.iter().any(|w| w.message.contains(what));
    let named = |what: &str| of_file(what) || done.told.iter().any(|message| message.contains(what));
    let mut lost = Vec::new();
    for (what, count) in before {
        let on_other_side = match OF_FACES.contains(&what.as_str()) {
            true => beside.and_then(|other| other.get(what)).copied().unwrap_or(0),
            false => 0,
        };
        let is_kept = after.get(what).is_some_and(|left| left + on_other_side >= *count);
        let is_own = [OWN.0, OWN.1, OWN.2].contains(&what.as_str()) || what.starts_with("attribute ");
        let is_taken = is_converted && (is_own || TAKEN.contains(&what.as_str()));
        if !(is_kept || is_taken || named(what)) {
            lost.push(format!("{what}: {count} to {}", after.get(what).copied().unwrap_or(0)));
        }
    }
    lost
}

/// What divides faces. Where a cut takes one side away, those that have faces there alone go with it.
const OF_FACES: [&str; 3] = ["group", "smoothing", "attribute material"];

/// A file that was written.
struct Written {
    format: Format,
    files: WrittenFiles,
    contents: Counts,
}

/// A model as an operation left it, what was said, and what was done.
struct Done {
    what: &'static str,
    told: Vec<String>,
    written: Vec<Written>,
}

/// One file, opened once.
struct Sweep<'a> {
    path: &'a Path,
    format: Format,
    before: Counts,
    deformer: Deformer,
    exec: &'a Exec<'a>,
    seen: usize,
    silent: Vec<String>,
}

impl<'a> Sweep<'a> {
    /// `None` for files that cannot be read, which an error says.
    fn open(path: &'a Path, exec: &'a Exec<'a>) -> Option<Self> {
        let format = Format::from_file_name(&path.to_string_lossy())?;
        let files = file_set(path);
        let before = || contents(&files.main, &companions_of(&files), format);
        let opened = Deformer::open(files.clone(), &OpenOptions::default(), &DeformerLimits::default(), exec);
        Some(Self {
            path,
            format,
            deformer: opened.ok()?,
            before: before(),
            exec,
            seen: 0,
            silent: Vec::new(),
        })
    }

    /// A shape in the format of the file, and in another.
    fn write(&self, positions: &[DVec3]) -> Vec<Written> {
        let other = if self.format == Format::OBJ {
            Format::PLY
        } else {
            Format::OBJ
        };
        // What cannot be written says so by its error.
        let files = [self.format, other].map(|format| (format, self.deformer.write(positions, format, self.exec)));
        files
            .into_iter()
            .filter_map(|(format, files)| {
                let files = files.ok()?;
                Some(Written {
                    format,
                    contents: contents(&files.main, &files.companions, format),
                    files,
                })
            })
            .collect()
    }

    /// Compares what was written; where a cut took one side away, `beside` is that side.
    fn compare(&mut self, done: &Done, beside: Option<&Done>) {
        for file in &done.written {
            self.seen += 1;
            let other = beside.and_then(|other| other.written.iter().find(|other| other.format == file.format));
            let other = other.map(|other| &other.contents);
            for lost in silently_lost(&self.before, done, file, self.format, other) {
                let (path, to) = (self.path.display(), file.format);
                self.silent.push(format!("{path}: {} to {to}: {lost}", done.what));
            }
        }
    }

    /// Edits the model, and takes the edit back.
    fn edit(&mut self, what: &'static str, edit: &Edit) -> Option<Done> {
        let start = self.deformer.topology_state();
        // What cannot be edited says so by its error.
        let outcome = self.deformer.edit_rest(edit, self.exec).ok()?;
        let done = Done {
            what,
            told: outcome.report.warnings.iter().map(|w| w.message.clone()).collect(),
            written: self.write(&outcome.shape.positions),
        };
        self.deformer.restore_topology(&start, self.exec).expect("as it was");
        Some(done)
    }

    fn edit_and_compare(&mut self, what: &'static str, edit: &Edit) {
        if let Some(done) = self.edit(what, edit) {
            self.compare(&done, None);
        }
    }

    fn compare_shape(&mut self, what: &'static str, positions: &[DVec3]) {
        let (told, written) = (Vec::new(), self.write(positions));
        self.compare(&Done { what, told, written }, None);
    }

    /// Through the middle of the model, with one side left or both.
    fn cut(&mut self) {
        let bounds = BoundingBox::of(self.deformer.rest());
        let size = bounds.max - bounds.min;
        let axis = [DVec3::Y, DVec3::X, DVec3::Z]
            .into_iter()
            .find(|axis| axis.dot(size) > 0.0);
        let axis = axis.unwrap_or(DVec3::Y);
        // Beside what stands in the very middle.
        let middle = axis.dot(bounds.center()) + 1e-3 * axis.dot(size);
        let cut = |keep, fill| {
            let along = CutLine::Plane(Plane::new(axis.to_array(), middle));
            let cap = None;
            Edit::Cut { along, keep, fill, cap }
        };
        let one = self.edit("a cut that keeps one side", &cut(KeptSide::Below, true));
        let other = self.edit("a cut that keeps the other side", &cut(KeptSide::Above, false));
        for (side, beside) in [(&one, &other), (&other, &one)] {
            if let Some(side) = side {
                self.compare(side, beside.as_ref());
            }
        }
        self.edit_and_compare("a cut that keeps both sides", &cut(KeptSide::Both, true));
    }

    fn all(&mut self) {
        let positions = self.deformer.rest().to_vec();
        self.compare_shape("nothing", &positions);
        self.edit_and_compare(
            "a subdivision",
            &Edit::Subdivide {
                region: None,
                scheme: SubdivisionScheme::Midpoint,
                creases: Creases::default(),
            },
        );
        self.edit_and_compare(
            "a decimation",
            &Edit::Decimate {
                region: None,
                ratio: 0.5,
            },
        );
        self.cut();
        let everything = Region::HalfSpace(Plane::new([0.0, 1.0, 0.0], -1e30));
        if self
            .deformer
            .set_handles(vec![Handle::new("all", everything)], self.exec)
            .is_err()
        {
            return;
        }
        let up = HandlePose::translation([0.0, 0.5, 0.0]);
        let settings = SolveSettings::default();
        let solved = self.deformer.commit([("all", up)], &settings, self.exec);
        let positions = solved.expect("moved as a whole").positions.to_vec();
        self.compare_shape("a pose", &positions);
    }
}

/// Sweeps over all files with two threads; answers how many results were compared, and what was silent.
fn sweep(data: &Path) -> (usize, Vec<String>) {
    let is_swept = |path: &PathBuf| {
        let format = Format::from_file_name(&path.to_string_lossy());
        format.is_some_and(|f| [Format::GLB, Format::GLTF, Format::OBJ, Format::PLY].contains(&f))
    };
    let files: Vec<PathBuf> = models_below(data, &["gltf", "field", "meshes"])
        .into_iter()
        .filter(is_swept)
        .collect();
    let next = AtomicUsize::new(0);
    let some_files = || {
        let pool = Pool::new(1).expect("a thread");
        let exec = Exec::new(&pool, &Silent);
        let (mut seen, mut silent) = (0, Vec::new());
        while let Some(path) = files.get(next.fetch_add(1, Ordering::Relaxed)) {
            let Some(mut sweep) = Sweep::open(path, &exec) else {
                continue;
            };
            sweep.all();
            seen += sweep.seen;
            silent.extend(sweep.silent);
        }
        (seen, silent)
    };
    let done = std::thread::scope(|scope| {
        let workers = [(); 2].map(|()| scope.spawn(some_files));
        workers.map(|worker| worker.join().expect("no panic"))
    });
    let seen = done.iter().map(|(seen, _)| seen).sum();
    let mut silent: Vec<String> = done.into_iter().flat_map(|(_, silent)| silent).collect();
    silent.sort();
    (seen, silent)
}

#[test]
fn every_element_and_extension_is_there_or_named() {
    let Some(data) = data_folder("elements and extensions through poses, edits and conversions") else {
        return;
    };
    let (seen, silent) = sweep(&data);
    assert!(seen > 500, "{seen} results");
    let count = silent.len();
    assert!(
        silent.is_empty(),
        "{count} things of {seen} results are lost silently:\n{}",
        silent.join("\n")
    );
}
