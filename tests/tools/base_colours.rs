//! `pliant render` in a model's own colours: textures, vertex colours, cut-outs, sides, and pictures that cannot be drawn.

use crate::render::SeenPicture;
use crate::support::commands::Workplace;
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use std::fs;

/// Runs `pliant render` on a model with 200 × 100 pixels; what it says, and its pixels.
fn render_model(folder: &Workplace, model: &str, more: &str) -> (String, Vec<[u8; 3]>) {
    let view = if more.contains("--view") { "" } else { "--view 0,0" };
    let ran = folder.done(&format!("render {model} -o seen.png --size 200x100 {view} {more}"));
    let pixels = SeenPicture::open(&folder.at("seen.png")).pixels;
    fs::remove_file(folder.at("seen.png")).expect("it is there");
    (ran.err, pixels)
}

fn pixel(pixels: &[[u8; 3]], x: usize, y: usize) -> [u8; 3] {
    pixels[y * 200 + x]
}

/// A PNG of one row.
fn row_png(texels: &[[u8; 4]]) -> Vec<u8> {
    picture_png(texels, texels.len() as u32)
}

/// A PNG of rows of so many pixels.
fn picture_png(texels: &[[u8; 4]], width: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, width, texels.len() as u32 / width);
    encoder.set_color(png::ColorType::Rgba);
    let mut writer = encoder.write_header().expect("a header");
    writer.write_image_data(texels.as_flattened()).expect("texels");
    writer.finish().expect("an end");
    bytes
}

/// The header of a PNG of 20,000 pixels each way, and nothing more.
fn endless_png() -> Vec<u8> {
    let mut bytes = row_png(&[[0; 4]]);
    bytes[16..20].copy_from_slice(&20_000u32.to_be_bytes());
    bytes[20..24].copy_from_slice(&20_000u32.to_be_bytes());
    let sum = png_checksum(&bytes[12..29]);
    bytes[29..33].copy_from_slice(&sum.to_be_bytes());
    bytes
}

/// CRC-32 as PNG has it.
fn png_checksum(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |sum, &byte| {
        (0..8).fold(sum ^ u32::from(byte), |s, _| {
            if s & 1 == 1 { s >> 1 ^ 0xedb8_8320 } else { s >> 1 }
        })
    })
}

fn data_uri(kind: &str, bytes: &[u8]) -> String {
    format!("data:{kind};base64,{}", STANDARD.encode(bytes))
}

/// A board four units wide and two high that looks at the eye, with this material and picture.
fn board(material: &str, image: &str) -> String {
    let corners: [[f32; 5]; 4] = [
        [-2.0, -1.0, 0.0, 0.0, 1.0],
        [2.0, -1.0, 0.0, 1.0, 1.0],
        [2.0, 1.0, 0.0, 1.0, 0.0],
        [-2.0, 1.0, 0.0, 0.0, 0.0],
    ];
    let mut bytes: Vec<u8> = corners
        .iter()
        .flat_map(|c| &c[..3])
        .flat_map(|x| x.to_le_bytes())
        .collect();
    bytes.extend(corners.iter().flat_map(|c| &c[3..]).flat_map(|x| x.to_le_bytes()));
    bytes.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|x| x.to_le_bytes()));
    let buffer = data_uri("application/octet-stream", &bytes);
    format!(
        r#"{{"asset":{{"version":"2.0"}},"scene":0,"scenes":[{{"nodes":[0]}}],"nodes":[{{"mesh":0}}],
        "meshes":[{{"primitives":[{{"attributes":{{"POSITION":0,"TEXCOORD_0":1}},"indices":2,"material":0}}]}}],
        "accessors":[{{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3","min":[-2,-1,0],"max":[2,1,0]}},
        {{"bufferView":1,"componentType":5126,"count":4,"type":"VEC2"}},
        {{"bufferView":2,"componentType":5123,"count":6,"type":"SCALAR"}}],
        "bufferViews":[{{"buffer":0,"byteLength":48}},{{"buffer":0,"byteOffset":48,"byteLength":32}},
        {{"buffer":0,"byteOffset":80,"byteLength":12}}],
        "buffers":[{{"byteLength":92,"uri":"{buffer}"}}],
        "materials":[{{"name":"board",{material}}}],"textures":[{{"source":0,"sampler":0}}],
        "samplers":[{{"magFilter":9728,"wrapS":33071,"wrapT":33071}}],"images":[{{"uri":"{image}"}}]}}"#
    )
}

const TEXTURED: &str = r#""pbrMetallicRoughness":{"baseColorFactor":[1,1,1,1],"baseColorTexture":{"index":0}}"#;

/// A JPEG of 8 × 8 red pixels.
const RED_JPEG: &str = concat!(
    "/9j/4AAQSkZJRgABAQAAAQABAAD/2wBDAA0JCgsKCA0LCgsODg0PEyAVExISEyccHhcgLikxMC4pLSwzOko+MzZGNywtQFdBRkxO",
    "UlNSMj5aYVpQYEpRUk//2wBDAQ4ODhMREyYVFSZPNS01T09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09PT09P",
    "T09PT09PT0//wAARCAAIAAgDAREAAhEBAxEB/8QAFAABAAAAAAAAAAAAAAAAAAAABv/EABQQAQAAAAAAAAAAAAAAAAAAAAD/xAAV",
    "AQEBAAAAAAAAAAAAAAAAAAAFB//EABQRAQAAAAAAAAAAAAAAAAAAAAD/2gAMAwEAAhEDEQA/AD4ZSX//2Q==",
);

#[test]
fn textures_lie_where_their_coordinates_say() {
    let folder = Workplace::empty();
    let picture = data_uri("image/png", &row_png(&[[255, 0, 0, 255], [0, 0, 255, 255]]));
    folder.put("board.gltf", board(TEXTURED, &picture));
    let (reply, seen) = render_model(&folder, "board.gltf", "");
    assert!(!reply.contains("warning"), "{reply}");
    let [left, right] = [pixel(&seen, 60, 50), pixel(&seen, 140, 50)];
    assert!(left[0] > 150 && left[1] == 0 && left[2] == 0, "{left:?}");
    assert!(right[2] > 150 && right[0] == 0 && right[1] == 0, "{right:?}");

    // The same from a file beside it, turned by the texture's transform, and by any number of threads.
    folder.put("two.png", row_png(&[[255, 0, 0, 255], [0, 0, 255, 255]]));
    let turned = TEXTURED.replace(
        r#"{"index":0}"#,
        r#"{"index":0,"extensions":{"KHR_texture_transform":{"scale":[-1,1],"offset":[1,0]}}}"#,
    );
    folder.put("turned.gltf", board(&turned, "two.png"));
    let (_, other) = render_model(&folder, "turned.gltf", "--threads 2");
    assert_eq!((pixel(&other, 60, 50), pixel(&other, 140, 50)), (right, left));
    let (_, plain) = render_model(&folder, "board.gltf", "--color plain");
    let clay = pixel(&plain, 60, 50);
    assert!(clay[0].abs_diff(clay[2]) < 40, "{clay:?}");

    let jpeg = format!("data:image/jpeg;base64,{RED_JPEG}");
    folder.put("jpeg.gltf", board(TEXTURED, &jpeg));
    let (reply, seen) = render_model(&folder, "jpeg.gltf", "");
    let middle = pixel(&seen, 100, 50);
    assert!(
        !reply.contains("warning") && middle[0] > 150 && middle[1] < 20,
        "{middle:?}, {reply}"
    );

    // Without `doubleSided` there is nothing to see from behind.
    let (_, behind) = render_model(&folder, "board.gltf", "--view 180,0");
    assert_eq!(pixel(&behind, 60, 50), pixel(&behind, 0, 50));
    let both = format!(r#""doubleSided":true,{TEXTURED}"#);
    folder.put("both.gltf", board(&both, &picture));
    let (_, behind) = render_model(&folder, "both.gltf", "--view 180,0");
    assert!(pixel(&behind, 140, 50)[0] > 100, "red on the other side");
}

#[test]
fn a_texture_is_the_right_way_up_in_gltf_and_obj() {
    let folder = Workplace::empty();
    let picture = picture_png(&[[255, 0, 0, 255], [0, 0, 255, 255]], 1);
    folder.put("flag.png", &picture);
    folder.put("board.gltf", board(TEXTURED, "flag.png"));
    folder.put("board.mtl", "newmtl flag\nmap_Kd flag.png\n");
    // In OBJ texture coordinates count from below. Its corners need no copies, so that uv and vertices have one order.
    let corners = "v -2 -1 0\nv 2 -1 0\nv 2 1 0\nv -2 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\n";
    let head = "mtllib board.mtl\nusemtl flag\n";
    folder.put("board.obj", format!("{head}{corners}f 1/1 2/2 3/3\nf 1/1 3/3 4/4\n"));
    for name in ["board.gltf", "board.obj"] {
        let (reply, seen) = render_model(&folder, name, "");
        assert!(!reply.contains("warning"), "{reply}");
        let [above, below] = [pixel(&seen, 100, 30), pixel(&seen, 100, 70)];
        // Two texels of an OBJ blend into each other, and by repetition across the border.
        let is = |p: [u8; 3], strong: usize, weak: usize| p[strong] > 150 && p[weak] < 80 && p[1] == 0;
        assert!(is(above, 0, 2) && is(below, 2, 0), "{name}: {above:?} {below:?}");
    }
}

#[test]
fn each_material_of_an_obj_is_seen_on_its_own_faces() {
    let folder = Workplace::empty();
    folder.put("two.mtl", "newmtl red\nKd 1 0 0\nnewmtl blue\nKd 0 0 1\n");
    let corners = "v -2 -1 0\nv 0 -1 0\nv 2 -1 0\nv -2 1 0\nv 0 1 0\nv 2 1 0\n";
    // Faces of both by turns, so that their order and that of what is drawn differ.
    let faces = "usemtl red\nf 1 2 5\nusemtl blue\nf 2 3 6\nusemtl red\nf 1 5 4\nusemtl blue\nf 2 6 5\n";
    folder.put("two.obj", format!("mtllib two.mtl\n{corners}{faces}"));
    let (_, seen) = render_model(&folder, "two.obj", "");
    for y in [35, 65] {
        let [left, right] = [pixel(&seen, 60, y), pixel(&seen, 140, y)];
        assert!(
            left[0] > 150 && left[2] == 0 && right[2] > 150 && right[0] == 0,
            "{left:?} {right:?}"
        );
    }
    // Numbers of the file's vertices keep their places: the right end is pulled, which is blue by its material.
    folder.put(
        "pulled.obj",
        format!("mtllib two.mtl\n{}{faces}", corners.replace("v 2 ", "v 4 ")),
    );
    let (_, seen) = render_model(&folder, "pulled.obj", "--before two.obj --color stretch");
    let [still, pulled] = [seen[50 * 400 + 230], seen[50 * 400 + 380]];
    assert!(
        pulled[0] > pulled[2] + 60 && still[0] < still[2] + 30,
        "{still:?} {pulled:?}"
    );
}

#[test]
fn opacity_cuts_out_and_lets_through() {
    let folder = Workplace::empty();
    let picture = data_uri("image/png", &row_png(&[[0, 255, 0, 0], [0, 255, 0, 255]]));
    let masked = format!(r#""alphaMode":"MASK",{TEXTURED}"#);
    folder.put("masked.gltf", board(&masked, &picture));
    let (_, seen) = render_model(&folder, "masked.gltf", "");
    assert_eq!(pixel(&seen, 60, 50), pixel(&seen, 0, 50), "the left half is cut out");
    assert!(pixel(&seen, 140, 50)[1] > 150);

    let glass = r#""alphaMode":"BLEND","pbrMetallicRoughness":{"baseColorFactor":[0,1,0,0.5]}"#;
    folder.put("glass.gltf", board(glass, &picture));
    let (_, seen) = render_model(&folder, "glass.gltf", "");
    let [through, sky] = [pixel(&seen, 60, 50), pixel(&seen, 0, 50)];
    assert!(
        through[0] > 80 && through[0] < sky[0] - 20 && through[1] > 150,
        "{through:?} over {sky:?}"
    );
}

#[test]
fn vertex_colours_of_any_format_are_drawn() {
    let folder = Workplace::empty();
    let head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n\
                property uchar red\nproperty uchar green\nproperty uchar blue\n\
                element face 2\nproperty list uchar int vertex_indices\nend_header\n";
    let corner = |x: i32, y: i32| format!("{x} {y} 0 255 0 0\n");
    let corners = [corner(-2, -1), corner(2, -1), corner(2, 1), corner(-2, 1)].concat();
    folder.put("red.ply", format!("{head}{corners}3 0 1 2\n3 0 2 3\n"));
    let (_, seen) = render_model(&folder, "red.ply", "");
    let red = pixel(&seen, 100, 50);
    assert!(red[0] > 150 && red[1] == 0 && red[2] == 0, "{red:?}");
}

#[test]
fn a_picture_that_cannot_be_drawn_is_reported_and_its_plain_colour_shown() {
    let folder = Workplace::empty();
    let material = TEXTURED.replace("[1,1,1,1]", "[0,0,1,1]");
    let whole = row_png(&[[255, 0, 0, 255]]);
    let cases = [
        ("nowhere.png".to_owned(), "is missing"),
        (data_uri("image/png", &whole[..whole.len() - 20]), "not a complete PNG"),
        (data_uri("image/png", &endless_png()), "20000 x 20000"),
        (data_uri("image/png", b"GIF89a and so on"), "neither PNG nor JPEG"),
        (data_uri("image/jpeg", &[0xff, 0xd8, 0xff, 0xe0, 0, 16]), "JPEG"),
        ("../outside.png".to_owned(), "outside"),
    ];
    for (image, reason) in cases {
        folder.put("board.gltf", board(&material, &image));
        let (reply, seen) = render_model(&folder, "board.gltf", "");
        assert!(reply.contains("warning: board.gltf: board:"), "{reply}");
        assert!(reply.contains(reason) || reason == "outside", "{reply}");
        let blue = pixel(&seen, 100, 50);
        assert!(blue[2] > 150 && blue[0] == 0, "{blue:?} for {reason}");
    }
}
