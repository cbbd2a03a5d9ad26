//! Small FBX files as text, made by the tests themselves.

use std::fmt::Write as _;

/// A file in the making: objects and how they are connected.
pub struct FbxText {
    objects: String,
    connections: String,
    settings: String,
}

/// A list of numbers as FBX writes it.
pub fn array<T: ToString>(values: &[T]) -> String {
    let text: Vec<String> = values.iter().map(T::to_string).collect();
    format!("*{} {{ a: {} }}", values.len(), text.join(","))
}

/// A matrix of a shift.
pub fn shift(x: f64, y: f64, z: f64) -> [f64; 16] {
    [1., 0., 0., 0., 0., 1., 0., 0., 0., 0., 1., 0., x, y, z, 1.]
}

impl FbxText {
    /// A file in centimetres with Y up.
    pub fn new() -> Self {
        Self::with_axes(1.0, [1, 2, 0])
    }

    /// A file of a unit in centimetres, with the axes that point up, to the front and to the side.
    pub fn with_axes(unit: f64, [up, front, side]: [u8; 3]) -> Self {
        let front_sign = if up == 2 { -1 } else { 1 };
        let settings = format!(
            r#"GlobalSettings: {{ Version: 1000
Properties70: {{
P: "UpAxis", "int", "Integer", "",{up}
P: "UpAxisSign", "int", "Integer", "",1
P: "FrontAxis", "int", "Integer", "",{front}
P: "FrontAxisSign", "int", "Integer", "",{front_sign}
P: "CoordAxis", "int", "Integer", "",{side}
P: "CoordAxisSign", "int", "Integer", "",1
P: "UnitScaleFactor", "double", "Number", "",{unit}
}} }}
"#
        );
        Self {
            objects: String::new(),
            connections: String::new(),
            settings,
        }
    }

    /// Adds an object of a kind with what it holds.
    pub fn object(&mut self, id: u32, kind: &str, name: &str, class: &str, body: &str) -> &mut Self {
        writeln!(self.objects, "{kind}: {id}, \"{name}\", \"{class}\" {{\n{body}\n}}").expect("a string");
        self
    }

    /// Hangs an object on another.
    pub fn connect(&mut self, child: u32, parent: u32) -> &mut Self {
        writeln!(self.connections, "C: \"OO\",{child},{parent}").expect("a string");
        self
    }

    /// Lets an object drive a property of another.
    pub fn drive(&mut self, child: u32, parent: u32, property: &str) -> &mut Self {
        writeln!(self.connections, "C: \"OP\",{child},{parent}, \"{property}\"").expect("a string");
        self
    }

    /// Adds a node at a place below another.
    pub fn node(&mut self, id: u32, class: &str, name: &str, at: [f64; 3], parent: u32) -> &mut Self {
        let [x, y, z] = at;
        let body = format!(
            "Version: 232\nProperties70: {{\nP: \"Lcl Translation\", \"Lcl Translation\", \"\", \"A\",{x},{y},{z}\n}}"
        );
        self.object(id, "Model", &format!("Model::{name}"), class, &body)
            .connect(id, parent)
    }

    /// Adds the mesh of a node; `more` are its layers.
    pub fn mesh(&mut self, id: u32, node: u32, points: &[[f64; 3]], faces: &[&[i64]], more: &str) -> &mut Self {
        let corners: Vec<i64> = faces
            .iter()
            .flat_map(|face| {
                let last = face.len() - 1;
                face.iter()
                    .enumerate()
                    .map(move |(i, &v)| if i == last { -1 - v } else { v })
            })
            .collect();
        let body = format!(
            "Vertices: {}\nPolygonVertexIndex: {}\nGeometryVersion: 124\n{more}",
            array(points.as_flattened()),
            array(&corners)
        );
        self.object(id, "Geometry", "Geometry::mesh", "Mesh", &body)
            .connect(id, node)
    }

    /// The file.
    pub fn text(&self) -> String {
        let Self {
            objects,
            connections,
            settings,
        } = self;
        format!(
            "; FBX 7.4.0 project file\nFBXHeaderExtension: {{\nFBXHeaderVersion: 1003\nFBXVersion: 7400\n}}\n{settings}\
             Objects: {{\n{objects}}}\nConnections: {{\n{connections}}}\n"
        )
    }
}

/// The corners of a cube of 200 cm whose floor lies at height 0.
pub const CUBE: [[f64; 3]; 8] = [
    [-100., 0., -100.],
    [100., 0., -100.],
    [100., 0., 100.],
    [-100., 0., 100.],
    [-100., 200., -100.],
    [100., 200., -100.],
    [100., 200., 100.],
    [-100., 200., 100.],
];

/// Its faces, counter-clockwise from outside.
pub const CUBE_FACES: [&[i64]; 6] = [
    &[0, 1, 2, 3],
    &[7, 6, 5, 4],
    &[0, 4, 5, 1],
    &[1, 5, 6, 2],
    &[2, 6, 7, 3],
    &[3, 7, 4, 0],
];

/// A cube of two materials with two sets of texture coordinates, one normal for each face, and colours.
pub fn cube() -> FbxText {
    let normals = [
        [0., -1., 0.],
        [0., 1., 0.],
        [0., 0., -1.],
        [1., 0., 0.],
        [0., 0., 1.],
        [-1., 0., 0.],
    ];
    let by_corner: Vec<f64> = normals.iter().flat_map(|n| [n; 4]).flatten().copied().collect();
    let square: Vec<u32> = (0..6).flat_map(|_| 0..4).collect();
    let by_position: Vec<i64> = CUBE_FACES.iter().flat_map(|f| f.iter().copied()).collect();
    let shades: Vec<f64> = (0..8).flat_map(|i| [f64::from(i) / 8.0, 0.5, 0.25, 1.0]).collect();
    let uv = |set: u32, low: f64| {
        let corners = [low, low, 1.0, low, 1.0, 1.0, low, 1.0];
        format!(
            "LayerElementUV: {set} {{\nVersion: 101\nName: \"map{set}\"\nMappingInformationType: \"ByPolygonVertex\"\n\
             ReferenceInformationType: \"IndexToDirect\"\nUV: {}\nUVIndex: {}\n}}",
            array(&corners),
            array(&square)
        )
    };
    let layers = format!(
        "LayerElementNormal: 0 {{\nVersion: 101\nName: \"\"\nMappingInformationType: \"ByPolygonVertex\"\n\
         ReferenceInformationType: \"Direct\"\nNormals: {}\n}}\n{}\n{}\n\
         LayerElementColor: 0 {{\nVersion: 101\nName: \"tint\"\nMappingInformationType: \"ByPolygonVertex\"\n\
         ReferenceInformationType: \"IndexToDirect\"\nColors: {}\nColorIndex: {}\n}}\n\
         LayerElementMaterial: 0 {{\nVersion: 101\nName: \"\"\nMappingInformationType: \"ByPolygon\"\n\
         ReferenceInformationType: \"IndexToDirect\"\nMaterials: *6 {{ a: 0,0,0,0,1,1 }}\n}}\n\
         Layer: 0 {{\nVersion: 100\n\
         LayerElement: {{ Type: \"LayerElementNormal\" \nTypedIndex: 0 }}\n\
         LayerElement: {{ Type: \"LayerElementUV\" \nTypedIndex: 0 }}\n\
         LayerElement: {{ Type: \"LayerElementColor\" \nTypedIndex: 0 }}\n\
         LayerElement: {{ Type: \"LayerElementMaterial\" \nTypedIndex: 0 }}\n}}\n\
         Layer: 1 {{\nVersion: 100\nLayerElement: {{ Type: \"LayerElementUV\" \nTypedIndex: 1 }}\n}}",
        array(&by_corner),
        uv(0, 0.0),
        uv(1, 0.5),
        array(&shades),
        array(&by_position),
    );
    let mut file = FbxText::new();
    file.node(200, "Mesh", "box", [0., 50., 0.], 0)
        .mesh(100, 200, &CUBE, &CUBE_FACES, &layers);
    for (id, name, colour) in [(300, "red", "0.8,0.1,0.1"), (301, "glass", "0.1,0.2,0.9")] {
        let opacity = if id == 301 {
            "P: \"Opacity\", \"double\", \"Number\", \"\",0.5\n"
        } else {
            ""
        };
        let body = format!(
            "Version: 102\nShadingModel: \"phong\"\nProperties70: {{\nP: \"DiffuseColor\", \"Color\", \"\", \"A\",{colour}\n{opacity}}}"
        );
        file.object(id, "Material", &format!("Material::{name}"), "", &body)
            .connect(id, 200);
    }
    file
}

/// A bar of 300 cm, 20 cm thick, in three storeys, on two bones; the upper one, at half height, turns about z in a clip. Both
/// bones were bound where the nodes of `rest` are not.
pub fn bar() -> FbxText {
    let storeys = [0.0, 100.0, 200.0, 300.0];
    let ring = [[-10., -10.], [10., -10.], [10., 10.], [-10., 10.]];
    let points: Vec<[f64; 3]> = storeys.iter().flat_map(|y| ring.map(|[x, z]| [x, *y, z])).collect();
    let mut faces: Vec<Vec<i64>> = vec![vec![0, 1, 2, 3], vec![15, 14, 13, 12]];
    for storey in 0..3 {
        for side in 0..4 {
            let (a, b) = (4 * storey + side, 4 * storey + (side + 1) % 4);
            faces.push(vec![a, a + 4, b + 4, b]);
        }
    }
    let faces: Vec<&[i64]> = faces.iter().map(Vec::as_slice).collect();
    let mut file = FbxText::new();
    file.node(200, "Mesh", "bar", [0.; 3], 0)
        .mesh(100, 200, &points, &faces, "")
        .node(500, "LimbNode", "lower", [0.; 3], 0)
        // Bound at 150; in the rest pose 40 to the side.
        .node(501, "LimbNode", "upper", [40., 150., 0.], 500)
        .object(
            400,
            "Deformer",
            "Deformer::",
            "Skin",
            "Version: 101\nLink_DeformAcuracy: 50",
        )
        .connect(400, 100);
    // The lowest ring has no weights at all, the second hangs on both.
    let low = (array(&[4, 5, 6, 7]), array(&[0.75; 4]));
    let high = (
        array(&(4..16).collect::<Vec<u32>>()),
        array(&[[0.25; 4], [1.0; 4], [1.0; 4]].concat()),
    );
    for (id, bone, (indices, weights), height) in [(401, 500, low, 0.0), (402, 501, high, 150.0)] {
        let body = format!(
            "Version: 100\nIndexes: {indices}\nWeights: {weights}\nTransform: {}\nTransformLink: {}",
            array(&shift(0.0, -height, 0.0)),
            array(&shift(0.0, height, 0.0)),
        );
        file.object(id, "Deformer", "SubDeformer::", "Cluster", &body)
            .connect(id, 400)
            .connect(bone, id);
    }
    let second = 46_186_158_000_i64;
    let turn = format!(
        "Default: 0\nKeyVer: 4008\nKeyTime: {}\nKeyValueFloat: {}\nKeyAttrFlags: *1 {{ a: 260 }}\n\
         KeyAttrDataFloat: *4 {{ a: 0,0,0,0 }}\nKeyAttrRefCount: *1 {{ a: 2 }}",
        array(&[0, second]),
        array(&[0.0, 90.0])
    );
    let stack = format!("Properties70: {{\nP: \"LocalStop\", \"KTime\", \"Time\", \"\",{second}\n}}");
    file.object(700, "AnimationStack", "AnimStack::wave", "", &stack)
        .object(701, "AnimationLayer", "AnimLayer::base", "", "")
        .object(
            702,
            "AnimationCurveNode",
            "AnimCurveNode::R",
            "",
            "Properties70: {\nP: \"d|Z\", \"Number\", \"\", \"A\",0\n}",
        )
        .object(703, "AnimationCurve", "AnimCurve::", "", &turn)
        .connect(701, 700)
        .connect(702, 701)
        .drive(702, 501, "Lcl Rotation")
        .drive(703, 702, "d|Z");
    file
}

/// A cube whose blend shape "peak" lifts one corner of its lid by 100 cm.
pub fn shaped_cube() -> FbxText {
    let mut file = FbxText::new();
    file.node(200, "Mesh", "box", [0.; 3], 0)
        .mesh(100, 200, &CUBE, &CUBE_FACES, "")
        .object(600, "Deformer", "Deformer::", "BlendShape", "Version: 100")
        .object(
            601,
            "Deformer",
            "SubDeformer::peak",
            "BlendShapeChannel",
            "Version: 100\nDeformPercent: 0\nFullWeights: *1 { a: 100 }",
        )
        .object(
            602,
            "Geometry",
            "Geometry::peak",
            "Shape",
            "Version: 100\nIndexes: *1 { a: 6 }\nVertices: *3 { a: 0,100,0 }\nNormals: *3 { a: 0,0,0 }",
        )
        .connect(600, 100)
        .connect(601, 600)
        .connect(602, 601);
    file
}
