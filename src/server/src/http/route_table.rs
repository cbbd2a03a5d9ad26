//! Every path and method with its API description; a test compares it with the router.

/// A route as the API description has it.
pub(crate) struct Route {
    pub method: &'static str,
    pub path: &'static str,
    /// The rpc of the schema that it is, whose comment describes it.
    pub rpc: Option<&'static str>,
    /// What is said beside that comment.
    pub summary: &'static str,
    /// Message of the JSON body.
    pub takes: Option<&'static str>,
    /// Message of the JSON answer.
    pub gives: Option<&'static str>,
    /// Status of success.
    pub status: u16,
    /// Query parameters and what they mean.
    pub query: &'static [(&'static str, &'static str)],
    /// Whether it takes an idempotency key.
    pub keyed: bool,
}

const PLAIN: Route = Route {
    method: "get",
    path: "",
    rpc: None,
    summary: "",
    takes: None,
    gives: None,
    status: 200,
    query: &[],
    keyed: false,
};

const FORMAT: (&str, &str) = ("format", "glb (or vrm), gltf, obj, ply, off, stl, 3mf, splat or spz");
/// The same of a model that is opened.
const OPENED_FORMAT: (&str, &str) = (
    "format",
    "glb (or vrm), gltf, obj, ply, off, stl, 3mf, fbx, splat or spz",
);

/// Every route but the pages for people, and `/mcp`, which lists its tools to agents in a protocol of its own.
pub(crate) const ROUTES: [Route; 26] = [
    Route {
        method: "post",
        path: "/v1/sessions",
        rpc: Some("CreateSession"),
        summary: "Open a session. The body is the model, or a form with the parts model, options and companion files. 200 on an idempotent repeat.",
        gives: Some("Session"),
        status: 201,
        query: &[
            OPENED_FORMAT,
            (
                "options",
                "CreateOptions as JSON; keepApart, passengers and rigidChains hold lists and can be given here alone",
            ),
            ("label", "CreateOptions.label"),
            ("ttl", "CreateOptions.ttl"),
            ("components", "CreateOptions.components"),
            ("weights", "CreateOptions.weights"),
            ("operators", "CreateOptions.operators"),
            ("parts", "CreateOptions.parts"),
            ("tieDistance", "CreateOptions.tieDistance"),
            ("rig", "CreateOptions.rig"),
            ("morphTargets", "CreateOptions.morphTargets"),
            ("boneLengths", "CreateOptions.boneLengths"),
            ("largeSplats", "CreateOptions.largeSplats"),
            ("cageTriangles", "CreateOptions.cageTriangles"),
            (
                "volumeGraph",
                "CreateOptions.volumeGraph.mode; its other fields as volumeGraph.interval and so on",
            ),
            ("weld", "CreateOptions.weld.tolerance"),
            (
                "sample",
                "creature or figure: open a built-in model; the body stays empty. The figure has a skeleton and clips, the creature none",
            ),
        ],
        keyed: true,
        ..PLAIN
    },
    Route {
        path: "/v1/sessions",
        rpc: Some("ListSessions"),
        summary: "List sessions.",
        gives: Some("ListSessionsResponse"),
        query: &[
            ("pageSize", "sessions a page, 1 to 1000"),
            ("pageToken", "nextPageToken of the page before"),
        ],
        ..PLAIN
    },
    Route {
        path: "/v1/sessions/{id}",
        rpc: Some("GetSession"),
        summary: "Describe a session.",
        gives: Some("Session"),
        ..PLAIN
    },
    Route {
        method: "delete",
        path: "/v1/sessions/{id}",
        rpc: Some("DeleteSession"),
        summary: "Close a session.",
        status: 204,
        ..PLAIN
    },
    Route {
        method: "put",
        path: "/v1/sessions/{id}/handles",
        rpc: Some("SetHandles"),
        summary: "Replace all handles.",
        takes: Some("SetHandlesRequest"),
        gives: Some("Session"),
        keyed: true,
        ..PLAIN
    },
    Route {
        method: "patch",
        path: "/v1/sessions/{id}/handles/{handleId}",
        summary: "Change the given fields of one handle, or add it.",
        takes: Some("Handle"),
        gives: Some("Session"),
        keyed: true,
        ..PLAIN
    },
    Route {
        method: "delete",
        path: "/v1/sessions/{id}/handles/{handleId}",
        summary: "Remove one handle.",
        gives: Some("Session"),
        keyed: true,
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/solve",
        rpc: Some("Solve"),
        summary: "Solve and commit one pose. Accept chooses JSON frames, the vertex buffer (application/octet-stream) or the deformed model.",
        takes: Some("SolveRequest"),
        gives: Some("Frames"),
        keyed: true,
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/edits",
        rpc: Some("Edit"),
        summary: "Change the topology: cut, delete, fill, subdivide, remesh, smooth, decimate, merge, wrap, unintersect, insert a curve or weld.",
        takes: Some("EditRequest"),
        gives: Some("EditResult"),
        keyed: true,
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/carry",
        rpc: Some("Carry"),
        summary: "Carry points, and a model, along with the current shape.",
        takes: Some("CarryRequest"),
        gives: Some("CarryResponse"),
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/crossings",
        rpc: Some("Crossings"),
        summary: "Where the surface of the current shape passes through itself.",
        takes: Some("CrossingsRequest"),
        gives: Some("CrossingsResponse"),
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/rig",
        rpc: Some("MakeRig"),
        summary: "The rig that a recording, or a preset, drives the model by, and how sure its joints are.",
        takes: Some("MakeRigRequest"),
        gives: Some("MakeRigResponse"),
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/transfer",
        rpc: Some("Transfer"),
        summary: "The model with blend shapes that come from another one, as a GLB; with shape, the model in another shape, as the other one takes it on; with fit too, the model, an outfit of the other one, on the body that shape is. The header x-pliant-transferred counts what came.",
        takes: Some("TransferRequest"),
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/animations",
        rpc: Some("Animate"),
        summary: "Drive the model by a clip. The body is a form with the parts options and clip (a BVH file), or the options as JSON. Accept chooses frames in a row, a line of JSON each (application/x-ndjson) or length-delimited messages (application/vnd.google.protobuf), or a GLB that plays the clip. The example plays a clip of the model itself: open the session with sample=figure, the creature has none.",
        takes: Some("AnimateOptions"),
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/undo",
        rpc: Some("Undo"),
        summary: "Undo.",
        gives: Some("Session"),
        keyed: true,
        ..PLAIN
    },
    Route {
        method: "post",
        path: "/v1/sessions/{id}/redo",
        rpc: Some("Redo"),
        summary: "Redo.",
        gives: Some("Session"),
        keyed: true,
        ..PLAIN
    },
    Route {
        path: "/v1/sessions/{id}/history",
        rpc: Some("History"),
        summary: "List commits.",
        gives: Some("HistoryResponse"),
        ..PLAIN
    },
    Route {
        path: "/v1/sessions/{id}/model",
        rpc: Some("Export"),
        summary: "Download the model. Honours Range, If-Range and If-None-Match. Companion files of a glTF are named by Link headers; x-pliant-followed counts what followed the shape, x-pliant-warning says what the file has not.",
        query: &[FORMAT, ("uri", "a companion file of a glTF instead of the main file")],
        ..PLAIN
    },
    Route {
        path: "/v1/sessions/{id}/positions",
        summary: "Download the vertex buffer: little-endian 32-bit x, y, z per render vertex, relative to the header x-pliant-origin (three numbers) where it is there. Honours Range and ETag.",
        ..PLAIN
    },
    Route {
        path: "/v1/sessions/{id}/stream",
        rpc: Some("Deform"),
        summary: "Upgrade to a WebSocket: binary DeformRequest messages in, binary DeformResponse messages out; optional sub-protocol pliant.v1.",
        status: 101,
        ..PLAIN
    },
    Route {
        path: "/v1/limits",
        rpc: Some("GetLimits"),
        summary: "The limits of this server.",
        gives: Some("Limits"),
        ..PLAIN
    },
    Route {
        path: "/v1/sample.glb",
        summary: "A built-in model.",
        query: &[("name", "creature (when absent) or figure")],
        ..PLAIN
    },
    Route {
        path: "/healthz",
        summary: "200 while the process lives.",
        ..PLAIN
    },
    Route {
        path: "/readyz",
        summary: "200 while new work is taken, else 503.",
        ..PLAIN
    },
    Route {
        path: "/metrics",
        summary: "Counts as OpenMetrics text.",
        ..PLAIN
    },
    Route {
        path: "/openapi.json",
        summary: "This description; /docs shows it to people.",
        ..PLAIN
    },
];
