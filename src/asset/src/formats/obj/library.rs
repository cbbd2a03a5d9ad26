//! Libraries of materials (MTL) that an OBJ names: base colours, opacity and pictures of colours and normals, in and out.
//!
//! Colours go through as they are written, as other converters do it. Pictures are named from the OBJ's folder.

use super::super::text::{NumberPrecision, TextLexer, number, push_number};
use super::statements::{STYLE, name_in, printable};
use crate::look::{AlphaMode, BaseLook, MaterialPicture, NamedMaterial, PicturePlacing, inside_folder};
use crate::{FileSet, Geometry};
use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::Arc;

/// Names of missing files that a warning lists.
const MOST_LISTED: usize = 8;
/// Letters of such a name that are shown.
const LONGEST_NAME: usize = 80;

/// Materials by their names.
pub(super) type MaterialLibrary = BTreeMap<String, Arc<NamedMaterial>>;

/// The files that `mtllib` lines may mean: all words as one name, and each for itself.
fn library_names(line: &[u8]) -> Vec<String> {
    let rest = name_in(line);
    let words = rest.split_whitespace().filter(|word| *word != rest);
    std::iter::once(rest.as_str())
        .chain(words)
        .filter_map(inside_folder)
        .collect()
}

/// The names of the files that an OBJ and its libraries so far name.
pub(super) fn companion_names(files: &FileSet) -> Vec<String> {
    let mut names = Vec::new();
    let mut seen = BTreeSet::new();
    let mut add = |name: String| {
        if seen.insert(name.clone()) {
            names.push(name);
        }
    };
    let libraries: Vec<String> = library_lines(files).flat_map(library_names).collect();
    libraries.iter().cloned().for_each(&mut add);
    for text in libraries.iter().filter_map(|name| files.companions.get(name)) {
        picture_names(text, &mut add);
    }
    names
}

/// The `mtllib` lines of an OBJ.
fn library_lines(files: &FileSet) -> impl Iterator<Item = &[u8]> {
    let lines = files.main.split(|b| matches!(b, b'\n' | b'\r')).map(<[u8]>::trim_ascii);
    lines.filter(|line| line.starts_with(b"mtllib") && line.get(6).is_some_and(u8::is_ascii_whitespace))
}

/// Hands out the names of the pictures that a library names.
fn picture_names(text: &[u8], add: &mut impl FnMut(String)) {
    statements_of(text, |keyword, rest| {
        let lower = keyword.to_ascii_lowercase();
        let is_map = lower.starts_with("map_") || matches!(&lower[..], "bump" | "disp" | "decal" | "refl" | "norm");
        if let Some(name) = is_map.then(|| picture_name(rest)).flatten() {
            add(name);
        }
    });
}

/// Warns of libraries and pictures whose files are not among those given, and of height maps, which no other format
/// has.
pub(super) fn warn_of_missing(files: &FileSet, geometry: &mut Geometry) {
    let (mut libraries, mut pictures, mut heights) = (BTreeSet::new(), BTreeSet::new(), BTreeSet::new());
    let (mut elsewhere, mut wild) = (BTreeSet::new(), BTreeSet::new());
    for names in library_lines(files).map(library_names) {
        let mut there = names.iter().filter_map(|name| files.companions.get(name)).peekable();
        // A line is one name with blanks, or several names: where one of them is there, the others are no more than guesses.
        if there.peek().is_none() {
            libraries.extend(names.into_iter().next());
            continue;
        }
        for text in there {
            picture_names(text, &mut |name: String| {
                if !files.companions.contains_key(&name) {
                    pictures.insert(name);
                }
            });
            elsewhere.extend(normals_elsewhere(text));
            statements_of(text, |keyword, rest| {
                let is_height = matches!(&keyword.to_ascii_lowercase()[..], "map_bump" | "bump");
                heights.extend(picture_name(rest).filter(|name| is_height && files.companions.contains_key(name)));
                wild.extend(
                    picture_name(rest).filter(|_| matches!(keyword, "map_Kd" | "norm") && has_wild_placing(rest)),
                );
            });
        }
    }
    let mut warn = |code: &str, missing: &BTreeSet<String>, what: &str, place: &str| {
        if missing.is_empty() {
            return;
        }
        let shown = |name: &String| name.chars().take(LONGEST_NAME).collect::<String>();
        let names: Vec<String> = missing.iter().take(MOST_LISTED).map(shown).collect();
        let more = match missing.len().saturating_sub(MOST_LISTED) {
            0 => String::new(),
            more => format!(" and {more} more"),
        };
        geometry.warn(code, format!("{what}: {}{more}", names.join(", ")), place);
    };
    warn(
        "library-missing",
        &libraries,
        "libraries of materials that were not sent along with the model, whose colours and pictures are not known",
        "mtllib",
    );
    warn(
        "bump-map",
        &heights,
        "pictures of heights (bump, map_Bump), which stay with the OBJ and go into no other format; one that holds normals is included as norm",
        "mtllib",
    );
    warn(
        "normals-elsewhere",
        &elsewhere,
        "pictures of normals (norm) with -o or -s of their own, which stay with the OBJ and go into no other format",
        "mtllib",
    );
    warn(
        "placing-ignored",
        &wild,
        "pictures with numbers behind -o or -s that are no numbers or beyond a million; other formats get 0 and 1 for them",
        "mtllib",
    );
    warn(
        "image-missing",
        &pictures,
        "images that were not sent along with the model; it comes back without them",
        "mtllib",
    );
}

/// The pictures of normals that lie elsewhere than those of colours.
fn normals_elsewhere(text: &[u8]) -> Vec<String> {
    let mut found = Vec::new();
    let (mut colours, mut normals) = (None, None);
    let mut finish = |colours: &mut Option<PicturePlacing>, normals: &mut Option<(String, PicturePlacing)>| {
        if let (Some(colours), Some((name, placing))) = (colours.take(), normals.take())
            && colours != placing
        {
            found.push(name);
        }
    };
    statements_of(text, |keyword, rest| match keyword {
        "newmtl" => finish(&mut colours, &mut normals),
        "map_Kd" => colours = picture_name(rest).map(|_| placing_of(rest)),
        "norm" => normals = picture_name(rest).map(|name| (name, placing_of(rest))),
        _ => {}
    });
    finish(&mut colours, &mut normals);
    found
}

/// Hands out the statements of a library: keyword and the rest of the line.
fn statements_of(text: &[u8], mut statement: impl FnMut(&str, &str)) {
    let text = &*as_utf8(text);
    let mut lexer = TextLexer::new(text, STYLE);
    while let Some(token) = lexer.token() {
        let keyword = String::from_utf8_lossy(lexer.text(token)).into_owned();
        let rest = lexer.rest_of_line();
        statement(&keyword, String::from_utf8_lossy(&text[rest]).trim());
        lexer.end_line();
    }
}

/// A text of two or four bytes a letter, which some editors write, in UTF-8; others as they are.
fn as_utf8(text: &[u8]) -> Cow<'_, [u8]> {
    let of_letters = |letters: &mut dyn Iterator<Item = Option<char>>| -> Cow<'_, [u8]> {
        let letters = letters.map(|letter| letter.unwrap_or(char::REPLACEMENT_CHARACTER));
        Cow::Owned(
            letters
                .filter(|letter| *letter != '\u{feff}')
                .collect::<String>()
                .into_bytes(),
        )
    };
    let in_fours = |read: fn([u8; 4]) -> u32| {
        let units = text.as_chunks::<4>().0.iter();
        of_letters(&mut units.map(|unit| char::from_u32(read(*unit))))
    };
    let in_pairs = |read: fn([u8; 2]) -> u16| {
        let units = text.as_chunks::<2>().0.iter().map(|unit| read(*unit));
        of_letters(&mut char::decode_utf16(units).map(Result::ok))
    };
    match text {
        [0xff, 0xfe, 0, 0, ..] => in_fours(u32::from_le_bytes),
        [0, 0, 0xfe, 0xff, ..] | [0, 0, 0, 1..=255, ..] => in_fours(u32::from_be_bytes),
        // The mark is often left out; a library begins with a plain letter.
        [1..=255, 0, 0, 0, ..] => in_fours(u32::from_le_bytes),
        [0xff, 0xfe, ..] | [1..=255, 0, ..] => in_pairs(u16::from_le_bytes),
        [0xfe, 0xff, ..] | [0, 1..=255, ..] => in_pairs(u16::from_be_bytes),
        _ => Cow::Borrowed(text),
    }
}

/// The name of a picture behind the options of its statement, or before them, as some programs write it.
fn picture_name(rest: &str) -> Option<String> {
    let left = after_options(rest);
    let is_option = |at: &usize| left[..*at].ends_with(char::is_whitespace) && after_options(&left[*at..]).is_empty();
    let end = left.match_indices('-').map(|(at, _)| at).find(is_option);
    inside_folder(left[..end.unwrap_or(left.len())].trim_end())
}

/// What follows the options that a statement begins with.
fn after_options(rest: &str) -> &str {
    let mut words = rest.split_whitespace().peekable();
    let mut left = rest;
    while let Some(option) = words.next_if(|word| OPTIONS.contains(word)) {
        left = after_word(left, option);
        let most = match option {
            "-o" | "-s" | "-t" => 3,
            "-mm" => 2,
            _ => 1,
        };
        for k in 0..most {
            // Options of one to three numbers end where no number stands.
            let is_number = |word: &&str| number(word.as_bytes()).is_some();
            let Some(value) = words.next_if(|word| (k == 0 && most == 1) || is_number(word)) else {
                break;
            };
            left = after_word(left, value);
        }
    }
    left
}

/// The options of statements that name pictures.
const OPTIONS: [&str; 14] = [
    "-blendu",
    "-blendv",
    "-bm",
    "-boost",
    "-cc",
    "-clamp",
    "-colorspace",
    "-imfchan",
    "-mm",
    "-o",
    "-s",
    "-t",
    "-texres",
    "-type",
];

/// The picture that a statement names.
fn picture_of(rest: &str, files: &FileSet) -> Option<MaterialPicture> {
    let name = picture_name(rest)?;
    let bytes = files.companions.get(&name).cloned();
    Some(MaterialPicture { name, bytes })
}

/// Larger scales and offsets are taken as not given: nothing of a picture is left there.
const LARGEST_PLACING: f64 = 1e6;

/// The numbers behind an option of a statement, those that are too large among them.
fn numbers_behind<'a>(rest: &'a str, option: &'static str) -> impl Iterator<Item = f64> + 'a {
    let words = rest.split_whitespace().skip_while(move |word| *word != option).skip(1);
    words.map_while(|word| number(word.as_bytes()))
}

/// Whether a statement places its picture by numbers that are not taken.
fn has_wild_placing(rest: &str) -> bool {
    let is_wild = |x: f64| x.is_nan() || x.abs() > LARGEST_PLACING;
    ["-s", "-o"]
        .into_iter()
        .any(|option| numbers_behind(rest, option).take(2).any(is_wild))
}

/// Where texture coordinates lie on the picture that a statement names: `-s` scales them, then `-o` moves them.
fn placing_of(rest: &str) -> PicturePlacing {
    let pair = |option: &'static str, missing: f64| {
        let mut numbers = numbers_behind(rest, option);
        let mut next = || numbers.next().filter(|x| x.abs() <= LARGEST_PLACING);
        let first = next();
        [first.unwrap_or(missing), first.and_then(|_| next()).unwrap_or(missing)]
    };
    let ([su, sv], [ou, ov]) = (pair("-s", 1.0), pair("-o", 0.0));
    // They count from the lower left corner there.
    PicturePlacing([su, 0.0, ou, 0.0, sv, 1.0 - sv - ov])
}

/// The text behind its first word.
fn after_word<'a>(text: &'a str, word: &str) -> &'a str {
    let text = text.trim_start();
    text.strip_prefix(word).unwrap_or(text).trim_start()
}

/// Reads the libraries that `mtllib` lines name, as far as they were sent along.
pub(super) fn read_libraries(files: &FileSet, lines: &[&[u8]]) -> MaterialLibrary {
    let mut library = MaterialLibrary::new();
    let mut read = BTreeSet::new();
    for name in lines.iter().flat_map(|line| library_names(line)) {
        if let Some(text) = files.companions.get(&name)
            && read.insert(name)
        {
            read_library(text, files, &mut library);
        }
    }
    library
}

fn read_library(text: &[u8], files: &FileSet, library: &mut MaterialLibrary) {
    let mut current: Option<NamedMaterial> = None;
    let mut normals_at = PicturePlacing::PLAIN;
    let mut keep = |material: Option<NamedMaterial>, normals_at: PicturePlacing| {
        if let Some(mut material) = material {
            if let Some(look) = &mut material.look {
                place_normals(look, normals_at);
            }
            // The first of a name counts, as in other readers.
            library
                .entry(material.name.clone())
                .or_insert_with(|| Arc::new(material));
        }
    };
    statements_of(text, |keyword, rest| {
        if keyword == "newmtl" {
            let look = Some(BaseLook::default());
            let name = rest.to_owned();
            keep(current.replace(NamedMaterial { name, look }), normals_at);
            normals_at = PicturePlacing::PLAIN;
            return;
        }
        let Some(look) = current.as_mut().and_then(|m| m.look.as_mut()) else {
            return;
        };
        let share = |text: &str| {
            let value = text.split_whitespace().next().and_then(|word| number(word.as_bytes()));
            value.filter(|v| v.is_finite()).map(|v| v.clamp(0.0, 1.0) as f32)
        };
        match keyword {
            "Kd" => {
                let numbers: Vec<f32> = rest.split_whitespace().map_while(share).collect();
                match numbers.as_slice() {
                    [r, g, b, ..] => look.colour[..3].copy_from_slice(&[*r, *g, *b]),
                    // One number stands for grey.
                    [grey] => look.colour[..3].fill(*grey),
                    _ => {}
                }
            }
            "d" | "Tr" => {
                let value = share(rest.trim_start_matches("-halo"));
                if let Some(value) = value {
                    look.colour[3] = if keyword == "d" { value } else { 1.0 - value };
                    if look.colour[3] < 1.0 {
                        look.coverage = AlphaMode::Blend;
                    }
                }
            }
            "map_Kd" => {
                look.picture = picture_of(rest, files);
                if look.picture.is_some() {
                    look.placing = placing_of(rest);
                }
            }
            "norm" => {
                look.normals = picture_of(rest, files);
                normals_at = placing_of(rest);
            }
            "map_d" => look.coverage = AlphaMode::Blend,
            _ => {}
        }
    });
    keep(current, normals_at);
}

/// Texture coordinates are placed once for both pictures: a picture of normals that lies elsewhere than the one of colours is left
/// out, which [`warn_of_missing`] reports.
fn place_normals(look: &mut BaseLook, normals_at: PicturePlacing) {
    if look.normals.is_none() {
        return;
    }
    if look.picture.is_none() {
        look.placing = normals_at;
    } else if look.placing != normals_at {
        look.normals = None;
    }
}

/// The text of a library of materials, each with its name, and the pictures that they need by the names of their files.
pub(super) fn write_library(materials: &[(String, Arc<NamedMaterial>)]) -> (Vec<u8>, BTreeMap<String, Vec<u8>>) {
    let mut out = b"# pliant\n".to_vec();
    let mut pictures = BTreeMap::new();
    for (name, material) in materials {
        out.extend(format!("\nnewmtl {name}\n").bytes());
        let Some(look) = &material.look else { continue };
        let [r, g, b, opacity] = look.colour;
        out.extend_from_slice(b"Kd");
        for value in [r, g, b] {
            out.push(b' ');
            push_number(&mut out, f64::from(value), NumberPrecision::Single);
        }
        out.extend_from_slice(b"\nd ");
        push_number(&mut out, f64::from(opacity), NumberPrecision::Single);
        out.push(b'\n');
        for (keyword, picture) in [("map_Kd", &look.picture), ("norm", &look.normals)] {
            let Some(picture) = picture else { continue };
            let name = printable(&picture.name);
            out.extend(format!("{keyword} {name}\n").bytes());
            if keyword == "map_Kd" && look.coverage != AlphaMode::Opaque {
                out.extend(format!("map_d {name}\n").bytes());
            }
            if let Some(bytes) = &picture.bytes {
                pictures.insert(name, bytes.to_vec());
            }
        }
    }
    (out, pictures)
}
