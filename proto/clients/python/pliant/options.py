"""Options: how poses are solved, and how a session is built."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, Union

from typing_extensions import TypedDict

from .regions import enum
from .values import mapping, number, put, seen, whole
from .v1 import pliant_pb2 as pb


class SolveFields(TypedDict, total=False):
    """How poses are solved, all optional; the server's defaults hold for what is absent."""

    #: Relative residual to reach, 1e-12 to 1.
    tolerance: float
    #: Largest displacement that may be missing, as a fraction of the bounding box's diagonal.
    max_error: float
    #: Milliseconds after which the best result so far is taken. Not for commits.
    budget_ms: float
    #: Better and better frames for one pose. Only on a stream.
    progressive: bool
    #: Rotation re-fits after the second pass. Default 4 on commit, 0 while dragging.
    refine: int
    #: How rotations are found between handles.
    first_pass: Literal["harmonic", "diffusion", "linear_frames"]
    #: The deformation method.
    method: Literal["graph", "spatial_rbf"]
    #: Weight of rotation smoothing in re-fits.
    rotation_smoothing: float
    #: Whether a commit with re-fits gives back the volume that twists and pulls would lose.
    volume: Literal["keep", "free"]
    #: Where re-fits on a stream begin: with what the pose before has found, or each pose as its commit would, on coarse levels.
    fit: Literal["continued", "coarse_first"]
    #: What a commit does about surfaces that the pose pushes through each other: they cross, or are moved apart.
    contact: Literal["ignore", "avoid"]
    #: What surfaces that have crossed keep from each other, model units, with contact "avoid".
    clearance: float
    #: The revision of a commit from whose shape re-fits go on, instead of from nothing: in commits, and with fit "coarse_first".
    from_revision: int
    #: Frames also carry normals.
    normals: bool
    #: Frames also carry tangents.
    tangents: bool
    #: Only vertices that moved by more than this fraction of the diagonal travel. Frames are whole all the same.
    changed_only: float
    #: How numbers travel: as they are, as 16 bits between the corners of the frame's box, these compressed, or of these only what
    #: differs from the frame before (on streams; not with ``changed_only``).
    encoding: Literal["f32", "u16", "meshopt", "delta"]
    #: Count self-intersections in the quality of a committed pose.
    self_intersections: bool
    #: Frames also carry the gradient of the motion around each vertex: what turns and stretches Gaussian splats and other passengers
    #: with an extent. Not with ``changed_only``.
    gradients: bool
    #: Unacknowledged frames in flight. Only on a stream.
    window: int


_PLAIN = ("tolerance", "max_error", "budget_ms", "progressive", "refine", "rotation_smoothing", "clearance", "from_revision", "window")
_OUTPUT = ("normals", "tangents", "changed_only", "self_intersections", "gradients")


def options(fields: SolveFields) -> pb.Options:
    """Options as the schema carries them."""
    message = pb.Options()
    for name, value in fields.items():
        if name in _PLAIN:
            put(message, name, value)
        elif name in _OUTPUT:
            put(message.output, name, value)
        elif name == "encoding":
            if value not in ("f32", "u16", "meshopt", "delta"):
                raise ValueError(f"encoding: {seen(value)}, f32, u16, meshopt or delta is allowed")
            message.output.encoding = enum(name, pb.Frame.Encoding, value)
        elif name == "first_pass":
            message.first_pass = enum(name, pb.Options.FirstPass, value)
        elif name == "volume":
            message.volume = enum(name, pb.Options.Volume, value)
        elif name == "contact":
            message.contact = enum(name, pb.Options.Contact, value)
        elif name == "fit":
            message.fit = enum(name, pb.Options.Fit, value)
        elif name == "method":
            message.method = enum(name, pb.Options.Method, value)
        else:
            allowed = ", ".join(SolveFields.__annotations__)
            raise TypeError(f"{name}: no such option; allowed are {allowed}")
    return message


class VolumeGraph(TypedDict, total=False):
    """The interior nodes that keep the volume."""

    #: Whether they are built: where the model has an inside, never, or always.
    mode: Literal["auto", "off", "required"]
    #: What interior nodes follow: the shape, or the triangles as in the paper.
    kind: Literal["shape", "paper"]
    #: Lattice interval in model units.
    interval: float
    #: Lattice neighbours of an interior node.
    valence: Literal[8, 14]
    #: Depth of the copies of vertices in model units.
    shell_offset: float
    #: What edges inside weigh relative to the default, 1e-3 to 1e3.
    stiffness: float


class KeepApart(TypedDict, total=False):
    """Parts that get no ties while others are tied."""

    #: Indices of primitives: parts with vertices of any of them.
    primitives: Sequence[int]
    #: Numbers of connected parts.
    components: Sequence[int]


class NodePassenger(TypedDict):
    """A node of a glTF that rides along: a socket, a camera, a light, and its children."""

    #: Its index in the file, or its name, which then stands for all nodes of that name. No joint of a skin.
    node: Union[int, str]


class CreateFields(TypedDict, total=False):
    """How a session is built from its model, all optional."""

    #: "glb" (or "vrm"), "gltf", "obj", "ply", "off", "stl", "3mf", "fbx", "splat" or "spz"; absent = recognised by the first bytes.
    format: str
    volume_graph: Union[Literal["auto", "off", "required"], VolumeGraph]
    #: What happens to parts in which no handle lies.
    components: Literal["follow", "hold", "free"]
    #: Weights of the edges of the surface, by default "cotangent", with the volume graph of kind "paper" "uniform".
    weights: Literal["uniform", "cotangent"]
    #: Free text for people.
    label: str
    #: How long the session outlives its last use, such as "15m".
    ttl: str
    #: Vertices at most this far apart become one, in model units.
    weld: float
    #: Operators of the multigrid hierarchy.
    operators: Literal["finite_volume", "paper"]
    #: What rides along without being solved: primitives by their indices or the names of their nodes, and other nodes.
    passengers: Sequence[Union[int, str, NodePassenger]]
    #: Whether morph targets of glTF turn and grow with the surface under them.
    morph_targets: Literal["follow", "keep"]
    #: Whether joints of skinned glTF move and turn with what they hold.
    rig: Literal["follow", "keep", "move"]
    #: Whether bones become longer and shorter with the body, where joints follow.
    bone_lengths: Literal["follow", "keep"]
    #: Names of joints below which alone bones keep their lengths.
    rigid_chains: Sequence[str]
    #: Whether parts that touch are tied, so that they deform as one.
    parts: Literal["tied", "separate"]
    #: How far apart two parts may lie to be tied, in model units; absent = chosen from the model.
    tie_distance: float
    #: Parts that get no ties.
    keep_apart: KeepApart
    #: Whether Gaussian splats that are larger than the bend around them are divided.
    large_splats: Literal["divide", "keep"]
    #: About how many triangles the surface around a model of Gaussian splats has; absent = 20000.
    cage_triangles: int


def create_options(fields: CreateFields) -> pb.CreateOptions:
    """Creation options as the schema carries them."""
    message = pb.CreateOptions()
    for name, value in fields.items():
        if name in ("format", "label", "ttl"):
            put(message, name, value)
        elif name == "weld":
            message.weld.tolerance = number(name, value)
        elif name == "components":
            message.components = enum(name, pb.CreateOptions.Components, value)
        elif name == "weights":
            message.weights = enum(name, pb.CreateOptions.Weights, value)
        elif name == "operators":
            message.operators = enum(name, pb.CreateOptions.Operators, value)
        elif name == "passengers":
            if isinstance(value, str) or not isinstance(value, Sequence):
                raise TypeError(f"passengers: {seen(value)}, a list of indices and names of primitives is allowed")
            for which in value:
                _passenger(which, message.passengers.add())
        elif name == "morph_targets":
            message.morph_targets = enum(name, pb.CreateOptions.MorphTargets.Rule, value)
        elif name == "rig":
            message.rig = enum(name, pb.CreateOptions.Rig.Rule, value)
        elif name == "bone_lengths":
            message.bone_lengths = enum(name, pb.CreateOptions.BoneLengths.Rule, value)
        elif name == "rigid_chains":
            if isinstance(value, str) or not isinstance(value, Sequence) or not all(isinstance(v, str) for v in value):
                raise TypeError(f"rigid_chains: {seen(value)}, a list of names of joints is allowed")
            message.rigid_chains.extend(value)
        elif name == "parts":
            message.parts = enum(name, pb.CreateOptions.Parts, value)
        elif name == "tie_distance":
            message.tie_distance = number(name, value)
        elif name == "keep_apart":
            _keep_apart(fields["keep_apart"], message.keep_apart)
        elif name == "large_splats":
            message.large_splats = enum(name, pb.CreateOptions.LargeSplats.Rule, value)
        elif name == "cage_triangles":
            put(message, name, value)
        elif name == "volume_graph":
            graph = fields["volume_graph"]
            _volume_graph({"mode": graph} if isinstance(graph, str) else graph, message.volume_graph)
        else:
            allowed = ", ".join(CreateFields.__annotations__)
            raise TypeError(f"{name}: no such option of a session; allowed are {allowed}")
    return message


def _passenger(which: Union[int, str, NodePassenger], message: pb.Passenger) -> None:
    if not isinstance(which, Mapping):
        put(message, "primitives_named" if isinstance(which, str) else "primitive", which)
    elif list(which) != ["node"]:
        raise TypeError(f"passengers: {seen(which)}, a dict has the key node alone")
    else:
        put(message, "nodes_named" if isinstance(which["node"], str) else "node", which["node"])


def _keep_apart(fields: KeepApart, message: pb.CreateOptions.KeepApart) -> None:
    message.SetInParent()
    for name, value in mapping("keep_apart", fields, "a dict").items():
        if name not in ("primitives", "components"):
            raise TypeError(f"keep_apart: {name}: allowed are primitives and components")
        getattr(message, name).extend(whole(f"keep_apart: {name}", index) for index in value)


def _volume_graph(fields: VolumeGraph, message: pb.CreateOptions.VolumeGraph) -> None:
    for name, value in mapping("volume_graph", fields, "auto, off, required or a dict").items():
        if name == "mode":
            message.mode = enum(name, pb.CreateOptions.VolumeGraph.Mode, value)
        elif name == "kind":
            message.kind = enum(name, pb.CreateOptions.VolumeGraph.Kind, value)
        elif name in ("interval", "valence", "shell_offset", "stiffness"):
            put(message, name, value)
        else:
            raise TypeError(f"volume_graph: {name}: allowed are mode, kind, interval, valence, shell_offset and stiffness")
