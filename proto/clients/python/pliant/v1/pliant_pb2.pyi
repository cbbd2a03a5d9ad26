from google.protobuf.internal import containers as _containers
from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from collections.abc import Iterable as _Iterable, Mapping as _Mapping
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class CreateSessionRequest(_message.Message):
    __slots__ = ("options", "chunk", "companion")
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    COMPANION_FIELD_NUMBER: _ClassVar[int]
    options: CreateOptions
    chunk: bytes
    companion: Companion
    def __init__(self, options: _Optional[_Union[CreateOptions, _Mapping]] = ..., chunk: _Optional[bytes] = ..., companion: _Optional[_Union[Companion, _Mapping]] = ...) -> None: ...

class Companion(_message.Message):
    __slots__ = ("uri",)
    URI_FIELD_NUMBER: _ClassVar[int]
    uri: str
    def __init__(self, uri: _Optional[str] = ...) -> None: ...

class CreateOptions(_message.Message):
    __slots__ = ("format", "volume_graph", "components", "weights", "label", "ttl", "weld", "operators", "morph_targets", "rig", "bone_lengths", "rigid_chains", "parts", "tie_distance", "keep_apart", "passengers", "large_splats", "cage_triangles")
    class Components(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        FOLLOW: _ClassVar[CreateOptions.Components]
        HOLD: _ClassVar[CreateOptions.Components]
        FREE: _ClassVar[CreateOptions.Components]
    FOLLOW: CreateOptions.Components
    HOLD: CreateOptions.Components
    FREE: CreateOptions.Components
    class Parts(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        TIED: _ClassVar[CreateOptions.Parts]
        SEPARATE: _ClassVar[CreateOptions.Parts]
    TIED: CreateOptions.Parts
    SEPARATE: CreateOptions.Parts
    class Weights(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNIFORM: _ClassVar[CreateOptions.Weights]
        COTANGENT: _ClassVar[CreateOptions.Weights]
    UNIFORM: CreateOptions.Weights
    COTANGENT: CreateOptions.Weights
    class Operators(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        FINITE_VOLUME: _ClassVar[CreateOptions.Operators]
        PAPER: _ClassVar[CreateOptions.Operators]
    FINITE_VOLUME: CreateOptions.Operators
    PAPER: CreateOptions.Operators
    class VolumeGraph(_message.Message):
        __slots__ = ("mode", "interval", "valence", "shell_offset", "kind", "stiffness")
        class Mode(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            AUTO: _ClassVar[CreateOptions.VolumeGraph.Mode]
            OFF: _ClassVar[CreateOptions.VolumeGraph.Mode]
            REQUIRED: _ClassVar[CreateOptions.VolumeGraph.Mode]
        AUTO: CreateOptions.VolumeGraph.Mode
        OFF: CreateOptions.VolumeGraph.Mode
        REQUIRED: CreateOptions.VolumeGraph.Mode
        class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            SHAPE: _ClassVar[CreateOptions.VolumeGraph.Kind]
            PAPER: _ClassVar[CreateOptions.VolumeGraph.Kind]
        SHAPE: CreateOptions.VolumeGraph.Kind
        PAPER: CreateOptions.VolumeGraph.Kind
        MODE_FIELD_NUMBER: _ClassVar[int]
        INTERVAL_FIELD_NUMBER: _ClassVar[int]
        VALENCE_FIELD_NUMBER: _ClassVar[int]
        SHELL_OFFSET_FIELD_NUMBER: _ClassVar[int]
        KIND_FIELD_NUMBER: _ClassVar[int]
        STIFFNESS_FIELD_NUMBER: _ClassVar[int]
        mode: CreateOptions.VolumeGraph.Mode
        interval: float
        valence: int
        shell_offset: float
        kind: CreateOptions.VolumeGraph.Kind
        stiffness: float
        def __init__(self, mode: _Optional[_Union[CreateOptions.VolumeGraph.Mode, str]] = ..., interval: _Optional[float] = ..., valence: _Optional[int] = ..., shell_offset: _Optional[float] = ..., kind: _Optional[_Union[CreateOptions.VolumeGraph.Kind, str]] = ..., stiffness: _Optional[float] = ...) -> None: ...
    class KeepApart(_message.Message):
        __slots__ = ("primitives", "components")
        PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
        COMPONENTS_FIELD_NUMBER: _ClassVar[int]
        primitives: _containers.RepeatedScalarFieldContainer[int]
        components: _containers.RepeatedScalarFieldContainer[int]
        def __init__(self, primitives: _Optional[_Iterable[int]] = ..., components: _Optional[_Iterable[int]] = ...) -> None: ...
    class Weld(_message.Message):
        __slots__ = ("tolerance",)
        TOLERANCE_FIELD_NUMBER: _ClassVar[int]
        tolerance: float
        def __init__(self, tolerance: _Optional[float] = ...) -> None: ...
    class MorphTargets(_message.Message):
        __slots__ = ()
        class Rule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            FOLLOW: _ClassVar[CreateOptions.MorphTargets.Rule]
            KEEP: _ClassVar[CreateOptions.MorphTargets.Rule]
        FOLLOW: CreateOptions.MorphTargets.Rule
        KEEP: CreateOptions.MorphTargets.Rule
        def __init__(self) -> None: ...
    class Rig(_message.Message):
        __slots__ = ()
        class Rule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            FOLLOW: _ClassVar[CreateOptions.Rig.Rule]
            KEEP: _ClassVar[CreateOptions.Rig.Rule]
            MOVE: _ClassVar[CreateOptions.Rig.Rule]
        FOLLOW: CreateOptions.Rig.Rule
        KEEP: CreateOptions.Rig.Rule
        MOVE: CreateOptions.Rig.Rule
        def __init__(self) -> None: ...
    class BoneLengths(_message.Message):
        __slots__ = ()
        class Rule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            FOLLOW: _ClassVar[CreateOptions.BoneLengths.Rule]
            KEEP: _ClassVar[CreateOptions.BoneLengths.Rule]
        FOLLOW: CreateOptions.BoneLengths.Rule
        KEEP: CreateOptions.BoneLengths.Rule
        def __init__(self) -> None: ...
    class LargeSplats(_message.Message):
        __slots__ = ()
        class Rule(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            DIVIDE: _ClassVar[CreateOptions.LargeSplats.Rule]
            KEEP: _ClassVar[CreateOptions.LargeSplats.Rule]
        DIVIDE: CreateOptions.LargeSplats.Rule
        KEEP: CreateOptions.LargeSplats.Rule
        def __init__(self) -> None: ...
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    VOLUME_GRAPH_FIELD_NUMBER: _ClassVar[int]
    COMPONENTS_FIELD_NUMBER: _ClassVar[int]
    WEIGHTS_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    TTL_FIELD_NUMBER: _ClassVar[int]
    WELD_FIELD_NUMBER: _ClassVar[int]
    OPERATORS_FIELD_NUMBER: _ClassVar[int]
    MORPH_TARGETS_FIELD_NUMBER: _ClassVar[int]
    RIG_FIELD_NUMBER: _ClassVar[int]
    BONE_LENGTHS_FIELD_NUMBER: _ClassVar[int]
    RIGID_CHAINS_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    TIE_DISTANCE_FIELD_NUMBER: _ClassVar[int]
    KEEP_APART_FIELD_NUMBER: _ClassVar[int]
    PASSENGERS_FIELD_NUMBER: _ClassVar[int]
    LARGE_SPLATS_FIELD_NUMBER: _ClassVar[int]
    CAGE_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    format: str
    volume_graph: CreateOptions.VolumeGraph
    components: CreateOptions.Components
    weights: CreateOptions.Weights
    label: str
    ttl: str
    weld: CreateOptions.Weld
    operators: CreateOptions.Operators
    morph_targets: CreateOptions.MorphTargets.Rule
    rig: CreateOptions.Rig.Rule
    bone_lengths: CreateOptions.BoneLengths.Rule
    rigid_chains: _containers.RepeatedScalarFieldContainer[str]
    parts: CreateOptions.Parts
    tie_distance: float
    keep_apart: CreateOptions.KeepApart
    passengers: _containers.RepeatedCompositeFieldContainer[Passenger]
    large_splats: CreateOptions.LargeSplats.Rule
    cage_triangles: int
    def __init__(self, format: _Optional[str] = ..., volume_graph: _Optional[_Union[CreateOptions.VolumeGraph, _Mapping]] = ..., components: _Optional[_Union[CreateOptions.Components, str]] = ..., weights: _Optional[_Union[CreateOptions.Weights, str]] = ..., label: _Optional[str] = ..., ttl: _Optional[str] = ..., weld: _Optional[_Union[CreateOptions.Weld, _Mapping]] = ..., operators: _Optional[_Union[CreateOptions.Operators, str]] = ..., morph_targets: _Optional[_Union[CreateOptions.MorphTargets.Rule, str]] = ..., rig: _Optional[_Union[CreateOptions.Rig.Rule, str]] = ..., bone_lengths: _Optional[_Union[CreateOptions.BoneLengths.Rule, str]] = ..., rigid_chains: _Optional[_Iterable[str]] = ..., parts: _Optional[_Union[CreateOptions.Parts, str]] = ..., tie_distance: _Optional[float] = ..., keep_apart: _Optional[_Union[CreateOptions.KeepApart, _Mapping]] = ..., passengers: _Optional[_Iterable[_Union[Passenger, _Mapping]]] = ..., large_splats: _Optional[_Union[CreateOptions.LargeSplats.Rule, str]] = ..., cage_triangles: _Optional[int] = ...) -> None: ...

class Passenger(_message.Message):
    __slots__ = ("name", "primitive", "primitives_named", "points", "file", "node", "nodes_named")
    class Points(_message.Message):
        __slots__ = ("positions", "rotations")
        POSITIONS_FIELD_NUMBER: _ClassVar[int]
        ROTATIONS_FIELD_NUMBER: _ClassVar[int]
        positions: _containers.RepeatedScalarFieldContainer[float]
        rotations: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, positions: _Optional[_Iterable[float]] = ..., rotations: _Optional[_Iterable[float]] = ...) -> None: ...
    class File(_message.Message):
        __slots__ = ("model", "file", "format", "output")
        MODEL_FIELD_NUMBER: _ClassVar[int]
        FILE_FIELD_NUMBER: _ClassVar[int]
        FORMAT_FIELD_NUMBER: _ClassVar[int]
        OUTPUT_FIELD_NUMBER: _ClassVar[int]
        model: bytes
        file: str
        format: str
        output: str
        def __init__(self, model: _Optional[bytes] = ..., file: _Optional[str] = ..., format: _Optional[str] = ..., output: _Optional[str] = ...) -> None: ...
    NAME_FIELD_NUMBER: _ClassVar[int]
    PRIMITIVE_FIELD_NUMBER: _ClassVar[int]
    PRIMITIVES_NAMED_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    FILE_FIELD_NUMBER: _ClassVar[int]
    NODE_FIELD_NUMBER: _ClassVar[int]
    NODES_NAMED_FIELD_NUMBER: _ClassVar[int]
    name: str
    primitive: int
    primitives_named: str
    points: Passenger.Points
    file: Passenger.File
    node: int
    nodes_named: str
    def __init__(self, name: _Optional[str] = ..., primitive: _Optional[int] = ..., primitives_named: _Optional[str] = ..., points: _Optional[_Union[Passenger.Points, _Mapping]] = ..., file: _Optional[_Union[Passenger.File, _Mapping]] = ..., node: _Optional[int] = ..., nodes_named: _Optional[str] = ...) -> None: ...

class SessionRequest(_message.Message):
    __slots__ = ("session_id",)
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    def __init__(self, session_id: _Optional[str] = ...) -> None: ...

class ListSessionsRequest(_message.Message):
    __slots__ = ("page_size", "page_token")
    PAGE_SIZE_FIELD_NUMBER: _ClassVar[int]
    PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    page_size: int
    page_token: str
    def __init__(self, page_size: _Optional[int] = ..., page_token: _Optional[str] = ...) -> None: ...

class ListSessionsResponse(_message.Message):
    __slots__ = ("sessions", "next_page_token")
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    NEXT_PAGE_TOKEN_FIELD_NUMBER: _ClassVar[int]
    sessions: _containers.RepeatedCompositeFieldContainer[Session]
    next_page_token: str
    def __init__(self, sessions: _Optional[_Iterable[_Union[Session, _Mapping]]] = ..., next_page_token: _Optional[str] = ...) -> None: ...

class DeleteSessionResponse(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Primitive(_message.Message):
    __slots__ = ("node", "mesh", "primitive", "name", "first_vertex", "vertex_count", "index_count", "has_normals", "has_tangents", "passenger")
    NODE_FIELD_NUMBER: _ClassVar[int]
    MESH_FIELD_NUMBER: _ClassVar[int]
    PRIMITIVE_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    FIRST_VERTEX_FIELD_NUMBER: _ClassVar[int]
    VERTEX_COUNT_FIELD_NUMBER: _ClassVar[int]
    INDEX_COUNT_FIELD_NUMBER: _ClassVar[int]
    HAS_NORMALS_FIELD_NUMBER: _ClassVar[int]
    HAS_TANGENTS_FIELD_NUMBER: _ClassVar[int]
    PASSENGER_FIELD_NUMBER: _ClassVar[int]
    node: int
    mesh: int
    primitive: int
    name: str
    first_vertex: int
    vertex_count: int
    index_count: int
    has_normals: bool
    has_tangents: bool
    passenger: bool
    def __init__(self, node: _Optional[int] = ..., mesh: _Optional[int] = ..., primitive: _Optional[int] = ..., name: _Optional[str] = ..., first_vertex: _Optional[int] = ..., vertex_count: _Optional[int] = ..., index_count: _Optional[int] = ..., has_normals: bool = ..., has_tangents: bool = ..., passenger: bool = ...) -> None: ...

class Warning(_message.Message):
    __slots__ = ("code", "message", "where", "vertices", "position")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    WHERE_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    code: str
    message: str
    where: str
    vertices: _containers.RepeatedScalarFieldContainer[int]
    position: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, code: _Optional[str] = ..., message: _Optional[str] = ..., where: _Optional[str] = ..., vertices: _Optional[_Iterable[int]] = ..., position: _Optional[_Iterable[float]] = ...) -> None: ...

class ModelFacts(_message.Message):
    __slots__ = ("format", "bytes", "sha256", "vertices", "triangles")
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    SHA256_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    format: str
    bytes: int
    sha256: str
    vertices: int
    triangles: int
    def __init__(self, format: _Optional[str] = ..., bytes: _Optional[int] = ..., sha256: _Optional[str] = ..., vertices: _Optional[int] = ..., triangles: _Optional[int] = ...) -> None: ...

class SolverFacts(_message.Message):
    __slots__ = ("solver_vertices", "graph_vertices", "graph_edges", "components", "levels", "bytes", "ties", "loose_parts", "loose", "stiff_parts")
    class Level(_message.Message):
        __slots__ = ("vertices", "edges")
        VERTICES_FIELD_NUMBER: _ClassVar[int]
        EDGES_FIELD_NUMBER: _ClassVar[int]
        vertices: int
        edges: int
        def __init__(self, vertices: _Optional[int] = ..., edges: _Optional[int] = ...) -> None: ...
    class LoosePart(_message.Message):
        __slots__ = ("component", "vertices", "primitive", "name")
        COMPONENT_FIELD_NUMBER: _ClassVar[int]
        VERTICES_FIELD_NUMBER: _ClassVar[int]
        PRIMITIVE_FIELD_NUMBER: _ClassVar[int]
        NAME_FIELD_NUMBER: _ClassVar[int]
        component: int
        vertices: int
        primitive: int
        name: str
        def __init__(self, component: _Optional[int] = ..., vertices: _Optional[int] = ..., primitive: _Optional[int] = ..., name: _Optional[str] = ...) -> None: ...
    SOLVER_VERTICES_FIELD_NUMBER: _ClassVar[int]
    GRAPH_VERTICES_FIELD_NUMBER: _ClassVar[int]
    GRAPH_EDGES_FIELD_NUMBER: _ClassVar[int]
    COMPONENTS_FIELD_NUMBER: _ClassVar[int]
    LEVELS_FIELD_NUMBER: _ClassVar[int]
    BYTES_FIELD_NUMBER: _ClassVar[int]
    TIES_FIELD_NUMBER: _ClassVar[int]
    LOOSE_PARTS_FIELD_NUMBER: _ClassVar[int]
    LOOSE_FIELD_NUMBER: _ClassVar[int]
    STIFF_PARTS_FIELD_NUMBER: _ClassVar[int]
    solver_vertices: int
    graph_vertices: int
    graph_edges: int
    components: int
    levels: _containers.RepeatedCompositeFieldContainer[SolverFacts.Level]
    bytes: int
    ties: int
    loose_parts: int
    loose: _containers.RepeatedCompositeFieldContainer[SolverFacts.LoosePart]
    stiff_parts: int
    def __init__(self, solver_vertices: _Optional[int] = ..., graph_vertices: _Optional[int] = ..., graph_edges: _Optional[int] = ..., components: _Optional[int] = ..., levels: _Optional[_Iterable[_Union[SolverFacts.Level, _Mapping]]] = ..., bytes: _Optional[int] = ..., ties: _Optional[int] = ..., loose_parts: _Optional[int] = ..., loose: _Optional[_Iterable[_Union[SolverFacts.LoosePart, _Mapping]]] = ..., stiff_parts: _Optional[int] = ...) -> None: ...

class Session(_message.Message):
    __slots__ = ("id", "revision", "primitives", "warnings", "build_ms", "model", "solver", "expires_at", "label", "handles", "limits", "created_at", "origin", "work")
    class BuildMsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    ID_FIELD_NUMBER: _ClassVar[int]
    REVISION_FIELD_NUMBER: _ClassVar[int]
    PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    BUILD_MS_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    SOLVER_FIELD_NUMBER: _ClassVar[int]
    EXPIRES_AT_FIELD_NUMBER: _ClassVar[int]
    LABEL_FIELD_NUMBER: _ClassVar[int]
    HANDLES_FIELD_NUMBER: _ClassVar[int]
    LIMITS_FIELD_NUMBER: _ClassVar[int]
    CREATED_AT_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    WORK_FIELD_NUMBER: _ClassVar[int]
    id: str
    revision: int
    primitives: _containers.RepeatedCompositeFieldContainer[Primitive]
    warnings: _containers.RepeatedCompositeFieldContainer[Warning]
    build_ms: _containers.ScalarMap[str, float]
    model: ModelFacts
    solver: SolverFacts
    expires_at: str
    label: str
    handles: _containers.RepeatedCompositeFieldContainer[HandleFacts]
    limits: Limits
    created_at: str
    origin: _containers.RepeatedScalarFieldContainer[float]
    work: Work
    def __init__(self, id: _Optional[str] = ..., revision: _Optional[int] = ..., primitives: _Optional[_Iterable[_Union[Primitive, _Mapping]]] = ..., warnings: _Optional[_Iterable[_Union[Warning, _Mapping]]] = ..., build_ms: _Optional[_Mapping[str, float]] = ..., model: _Optional[_Union[ModelFacts, _Mapping]] = ..., solver: _Optional[_Union[SolverFacts, _Mapping]] = ..., expires_at: _Optional[str] = ..., label: _Optional[str] = ..., handles: _Optional[_Iterable[_Union[HandleFacts, _Mapping]]] = ..., limits: _Optional[_Union[Limits, _Mapping]] = ..., created_at: _Optional[str] = ..., origin: _Optional[_Iterable[float]] = ..., work: _Optional[_Union[Work, _Mapping]] = ...) -> None: ...

class Work(_message.Message):
    __slots__ = ("kind", "stage", "fraction", "elapsed_ms")
    KIND_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    ELAPSED_MS_FIELD_NUMBER: _ClassVar[int]
    kind: str
    stage: str
    fraction: float
    elapsed_ms: float
    def __init__(self, kind: _Optional[str] = ..., stage: _Optional[str] = ..., fraction: _Optional[float] = ..., elapsed_ms: _Optional[float] = ...) -> None: ...

class HandleFacts(_message.Message):
    __slots__ = ("id", "vertices", "interior_nodes", "centroid", "pose", "pivot", "found_turn")
    ID_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    INTERIOR_NODES_FIELD_NUMBER: _ClassVar[int]
    CENTROID_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    PIVOT_FIELD_NUMBER: _ClassVar[int]
    FOUND_TURN_FIELD_NUMBER: _ClassVar[int]
    id: str
    vertices: int
    interior_nodes: int
    centroid: _containers.RepeatedScalarFieldContainer[float]
    pose: HandlePose
    pivot: _containers.RepeatedScalarFieldContainer[float]
    found_turn: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, id: _Optional[str] = ..., vertices: _Optional[int] = ..., interior_nodes: _Optional[int] = ..., centroid: _Optional[_Iterable[float]] = ..., pose: _Optional[_Union[HandlePose, _Mapping]] = ..., pivot: _Optional[_Iterable[float]] = ..., found_turn: _Optional[_Iterable[float]] = ...) -> None: ...

class FoundTurn(_message.Message):
    __slots__ = ("id", "rotation_vector")
    ID_FIELD_NUMBER: _ClassVar[int]
    ROTATION_VECTOR_FIELD_NUMBER: _ClassVar[int]
    id: str
    rotation_vector: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, id: _Optional[str] = ..., rotation_vector: _Optional[_Iterable[float]] = ...) -> None: ...

class Limits(_message.Message):
    __slots__ = ("upload_bytes", "vertices", "sessions", "memory_bytes", "handles", "message_bytes", "window", "part_bytes", "ttl_seconds", "history", "solve_ms", "streams", "animations", "clip_bytes", "clip_joints", "animation_frames", "animation_vertices", "quotas")
    UPLOAD_BYTES_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    MEMORY_BYTES_FIELD_NUMBER: _ClassVar[int]
    HANDLES_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_BYTES_FIELD_NUMBER: _ClassVar[int]
    WINDOW_FIELD_NUMBER: _ClassVar[int]
    PART_BYTES_FIELD_NUMBER: _ClassVar[int]
    TTL_SECONDS_FIELD_NUMBER: _ClassVar[int]
    HISTORY_FIELD_NUMBER: _ClassVar[int]
    SOLVE_MS_FIELD_NUMBER: _ClassVar[int]
    STREAMS_FIELD_NUMBER: _ClassVar[int]
    ANIMATIONS_FIELD_NUMBER: _ClassVar[int]
    CLIP_BYTES_FIELD_NUMBER: _ClassVar[int]
    CLIP_JOINTS_FIELD_NUMBER: _ClassVar[int]
    ANIMATION_FRAMES_FIELD_NUMBER: _ClassVar[int]
    ANIMATION_VERTICES_FIELD_NUMBER: _ClassVar[int]
    QUOTAS_FIELD_NUMBER: _ClassVar[int]
    upload_bytes: int
    vertices: int
    sessions: int
    memory_bytes: int
    handles: int
    message_bytes: int
    window: int
    part_bytes: int
    ttl_seconds: float
    history: int
    solve_ms: float
    streams: int
    animations: int
    clip_bytes: int
    clip_joints: int
    animation_frames: int
    animation_vertices: int
    quotas: Quotas
    def __init__(self, upload_bytes: _Optional[int] = ..., vertices: _Optional[int] = ..., sessions: _Optional[int] = ..., memory_bytes: _Optional[int] = ..., handles: _Optional[int] = ..., message_bytes: _Optional[int] = ..., window: _Optional[int] = ..., part_bytes: _Optional[int] = ..., ttl_seconds: _Optional[float] = ..., history: _Optional[int] = ..., solve_ms: _Optional[float] = ..., streams: _Optional[int] = ..., animations: _Optional[int] = ..., clip_bytes: _Optional[int] = ..., clip_joints: _Optional[int] = ..., animation_frames: _Optional[int] = ..., animation_vertices: _Optional[int] = ..., quotas: _Optional[_Union[Quotas, _Mapping]] = ...) -> None: ...

class Quotas(_message.Message):
    __slots__ = ("sessions", "memory_bytes", "stored_bytes", "upload_bytes_per_minute", "solve_seconds_per_minute", "streams")
    SESSIONS_FIELD_NUMBER: _ClassVar[int]
    MEMORY_BYTES_FIELD_NUMBER: _ClassVar[int]
    STORED_BYTES_FIELD_NUMBER: _ClassVar[int]
    UPLOAD_BYTES_PER_MINUTE_FIELD_NUMBER: _ClassVar[int]
    SOLVE_SECONDS_PER_MINUTE_FIELD_NUMBER: _ClassVar[int]
    STREAMS_FIELD_NUMBER: _ClassVar[int]
    sessions: QuotaState
    memory_bytes: QuotaState
    stored_bytes: QuotaState
    upload_bytes_per_minute: QuotaState
    solve_seconds_per_minute: QuotaState
    streams: QuotaState
    def __init__(self, sessions: _Optional[_Union[QuotaState, _Mapping]] = ..., memory_bytes: _Optional[_Union[QuotaState, _Mapping]] = ..., stored_bytes: _Optional[_Union[QuotaState, _Mapping]] = ..., upload_bytes_per_minute: _Optional[_Union[QuotaState, _Mapping]] = ..., solve_seconds_per_minute: _Optional[_Union[QuotaState, _Mapping]] = ..., streams: _Optional[_Union[QuotaState, _Mapping]] = ...) -> None: ...

class QuotaState(_message.Message):
    __slots__ = ("allowed", "left")
    ALLOWED_FIELD_NUMBER: _ClassVar[int]
    LEFT_FIELD_NUMBER: _ClassVar[int]
    allowed: float
    left: float
    def __init__(self, allowed: _Optional[float] = ..., left: _Optional[float] = ...) -> None: ...

class GetLimitsRequest(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Region(_message.Message):
    __slots__ = ("vertices", "half_space", "sphere", "box", "capsule", "tube", "component", "primitive", "weights", "anchors")
    class Range(_message.Message):
        __slots__ = ("first", "count")
        FIRST_FIELD_NUMBER: _ClassVar[int]
        COUNT_FIELD_NUMBER: _ClassVar[int]
        first: int
        count: int
        def __init__(self, first: _Optional[int] = ..., count: _Optional[int] = ...) -> None: ...
    class Vertices(_message.Message):
        __slots__ = ("indices", "ranges")
        INDICES_FIELD_NUMBER: _ClassVar[int]
        RANGES_FIELD_NUMBER: _ClassVar[int]
        indices: _containers.RepeatedScalarFieldContainer[int]
        ranges: _containers.RepeatedCompositeFieldContainer[Region.Range]
        def __init__(self, indices: _Optional[_Iterable[int]] = ..., ranges: _Optional[_Iterable[_Union[Region.Range, _Mapping]]] = ...) -> None: ...
    class HalfSpace(_message.Message):
        __slots__ = ("normal", "offset")
        NORMAL_FIELD_NUMBER: _ClassVar[int]
        OFFSET_FIELD_NUMBER: _ClassVar[int]
        normal: _containers.RepeatedScalarFieldContainer[float]
        offset: float
        def __init__(self, normal: _Optional[_Iterable[float]] = ..., offset: _Optional[float] = ...) -> None: ...
    class Sphere(_message.Message):
        __slots__ = ("center", "radius")
        CENTER_FIELD_NUMBER: _ClassVar[int]
        RADIUS_FIELD_NUMBER: _ClassVar[int]
        center: _containers.RepeatedScalarFieldContainer[float]
        radius: float
        def __init__(self, center: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ...) -> None: ...
    class Box(_message.Message):
        __slots__ = ("min", "max")
        MIN_FIELD_NUMBER: _ClassVar[int]
        MAX_FIELD_NUMBER: _ClassVar[int]
        min: _containers.RepeatedScalarFieldContainer[float]
        max: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, min: _Optional[_Iterable[float]] = ..., max: _Optional[_Iterable[float]] = ...) -> None: ...
    class Capsule(_message.Message):
        __slots__ = ("to", "radius")
        FROM_FIELD_NUMBER: _ClassVar[int]
        TO_FIELD_NUMBER: _ClassVar[int]
        RADIUS_FIELD_NUMBER: _ClassVar[int]
        to: _containers.RepeatedScalarFieldContainer[float]
        radius: float
        def __init__(self, to: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ..., **kwargs) -> None: ...
    class Tube(_message.Message):
        __slots__ = ("points", "radius")
        POINTS_FIELD_NUMBER: _ClassVar[int]
        RADIUS_FIELD_NUMBER: _ClassVar[int]
        points: _containers.RepeatedScalarFieldContainer[float]
        radius: float
        def __init__(self, points: _Optional[_Iterable[float]] = ..., radius: _Optional[float] = ...) -> None: ...
    class Part(_message.Message):
        __slots__ = ("index",)
        INDEX_FIELD_NUMBER: _ClassVar[int]
        index: int
        def __init__(self, index: _Optional[int] = ...) -> None: ...
    class Weights(_message.Message):
        __slots__ = ("values",)
        VALUES_FIELD_NUMBER: _ClassVar[int]
        values: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, values: _Optional[_Iterable[float]] = ...) -> None: ...
    class Anchors(_message.Message):
        __slots__ = ("faces", "corners", "weights")
        FACES_FIELD_NUMBER: _ClassVar[int]
        CORNERS_FIELD_NUMBER: _ClassVar[int]
        WEIGHTS_FIELD_NUMBER: _ClassVar[int]
        faces: _containers.RepeatedScalarFieldContainer[int]
        corners: _containers.RepeatedScalarFieldContainer[int]
        weights: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, faces: _Optional[_Iterable[int]] = ..., corners: _Optional[_Iterable[int]] = ..., weights: _Optional[_Iterable[float]] = ...) -> None: ...
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    HALF_SPACE_FIELD_NUMBER: _ClassVar[int]
    SPHERE_FIELD_NUMBER: _ClassVar[int]
    BOX_FIELD_NUMBER: _ClassVar[int]
    CAPSULE_FIELD_NUMBER: _ClassVar[int]
    TUBE_FIELD_NUMBER: _ClassVar[int]
    COMPONENT_FIELD_NUMBER: _ClassVar[int]
    PRIMITIVE_FIELD_NUMBER: _ClassVar[int]
    WEIGHTS_FIELD_NUMBER: _ClassVar[int]
    ANCHORS_FIELD_NUMBER: _ClassVar[int]
    vertices: Region.Vertices
    half_space: Region.HalfSpace
    sphere: Region.Sphere
    box: Region.Box
    capsule: Region.Capsule
    tube: Region.Tube
    component: Region.Part
    primitive: Region.Part
    weights: Region.Weights
    anchors: Region.Anchors
    def __init__(self, vertices: _Optional[_Union[Region.Vertices, _Mapping]] = ..., half_space: _Optional[_Union[Region.HalfSpace, _Mapping]] = ..., sphere: _Optional[_Union[Region.Sphere, _Mapping]] = ..., box: _Optional[_Union[Region.Box, _Mapping]] = ..., capsule: _Optional[_Union[Region.Capsule, _Mapping]] = ..., tube: _Optional[_Union[Region.Tube, _Mapping]] = ..., component: _Optional[_Union[Region.Part, _Mapping]] = ..., primitive: _Optional[_Union[Region.Part, _Mapping]] = ..., weights: _Optional[_Union[Region.Weights, _Mapping]] = ..., anchors: _Optional[_Union[Region.Anchors, _Mapping]] = ...) -> None: ...

class HandlePose(_message.Message):
    __slots__ = ("translation", "rotation", "rotation_vector", "scale", "pivot", "free_rotation", "targets", "guide")
    TRANSLATION_FIELD_NUMBER: _ClassVar[int]
    ROTATION_FIELD_NUMBER: _ClassVar[int]
    ROTATION_VECTOR_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    PIVOT_FIELD_NUMBER: _ClassVar[int]
    FREE_ROTATION_FIELD_NUMBER: _ClassVar[int]
    TARGETS_FIELD_NUMBER: _ClassVar[int]
    GUIDE_FIELD_NUMBER: _ClassVar[int]
    translation: _containers.RepeatedScalarFieldContainer[float]
    rotation: _containers.RepeatedScalarFieldContainer[float]
    rotation_vector: _containers.RepeatedScalarFieldContainer[float]
    scale: _containers.RepeatedScalarFieldContainer[float]
    pivot: _containers.RepeatedScalarFieldContainer[float]
    free_rotation: bool
    targets: VertexTargets
    guide: GuidePose
    def __init__(self, translation: _Optional[_Iterable[float]] = ..., rotation: _Optional[_Iterable[float]] = ..., rotation_vector: _Optional[_Iterable[float]] = ..., scale: _Optional[_Iterable[float]] = ..., pivot: _Optional[_Iterable[float]] = ..., free_rotation: bool = ..., targets: _Optional[_Union[VertexTargets, _Mapping]] = ..., guide: _Optional[_Union[GuidePose, _Mapping]] = ...) -> None: ...

class Guide(_message.Message):
    __slots__ = ("curve", "lattice", "cage")
    class Curve(_message.Message):
        __slots__ = ("points", "keep_length")
        POINTS_FIELD_NUMBER: _ClassVar[int]
        KEEP_LENGTH_FIELD_NUMBER: _ClassVar[int]
        points: _containers.RepeatedScalarFieldContainer[float]
        keep_length: bool
        def __init__(self, points: _Optional[_Iterable[float]] = ..., keep_length: bool = ...) -> None: ...
    class Lattice(_message.Message):
        __slots__ = ("origin", "edges", "counts")
        ORIGIN_FIELD_NUMBER: _ClassVar[int]
        EDGES_FIELD_NUMBER: _ClassVar[int]
        COUNTS_FIELD_NUMBER: _ClassVar[int]
        origin: _containers.RepeatedScalarFieldContainer[float]
        edges: _containers.RepeatedScalarFieldContainer[float]
        counts: _containers.RepeatedScalarFieldContainer[int]
        def __init__(self, origin: _Optional[_Iterable[float]] = ..., edges: _Optional[_Iterable[float]] = ..., counts: _Optional[_Iterable[int]] = ...) -> None: ...
    class Cage(_message.Message):
        __slots__ = ("positions", "triangles")
        POSITIONS_FIELD_NUMBER: _ClassVar[int]
        TRIANGLES_FIELD_NUMBER: _ClassVar[int]
        positions: _containers.RepeatedScalarFieldContainer[float]
        triangles: _containers.RepeatedScalarFieldContainer[int]
        def __init__(self, positions: _Optional[_Iterable[float]] = ..., triangles: _Optional[_Iterable[int]] = ...) -> None: ...
    CURVE_FIELD_NUMBER: _ClassVar[int]
    LATTICE_FIELD_NUMBER: _ClassVar[int]
    CAGE_FIELD_NUMBER: _ClassVar[int]
    curve: Guide.Curve
    lattice: Guide.Lattice
    cage: Guide.Cage
    def __init__(self, curve: _Optional[_Union[Guide.Curve, _Mapping]] = ..., lattice: _Optional[_Union[Guide.Lattice, _Mapping]] = ..., cage: _Optional[_Union[Guide.Cage, _Mapping]] = ...) -> None: ...

class GuidePose(_message.Message):
    __slots__ = ("positions", "twists", "scales")
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    TWISTS_FIELD_NUMBER: _ClassVar[int]
    SCALES_FIELD_NUMBER: _ClassVar[int]
    positions: _containers.RepeatedScalarFieldContainer[float]
    twists: _containers.RepeatedScalarFieldContainer[float]
    scales: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, positions: _Optional[_Iterable[float]] = ..., twists: _Optional[_Iterable[float]] = ..., scales: _Optional[_Iterable[float]] = ...) -> None: ...

class VertexTargets(_message.Message):
    __slots__ = ("positions", "weights", "first", "normals")
    POSITIONS_FIELD_NUMBER: _ClassVar[int]
    WEIGHTS_FIELD_NUMBER: _ClassVar[int]
    FIRST_FIELD_NUMBER: _ClassVar[int]
    NORMALS_FIELD_NUMBER: _ClassVar[int]
    positions: bytes
    weights: bytes
    first: int
    normals: bytes
    def __init__(self, positions: _Optional[bytes] = ..., weights: _Optional[bytes] = ..., first: _Optional[int] = ..., normals: _Optional[bytes] = ...) -> None: ...

class Handle(_message.Message):
    __slots__ = ("id", "region", "constrains", "stiffness", "rigid", "pose", "falloff", "targets", "guide")
    class Constrains(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        POSITION: _ClassVar[Handle.Constrains]
        ROTATION: _ClassVar[Handle.Constrains]
        SCALE: _ClassVar[Handle.Constrains]
    POSITION: Handle.Constrains
    ROTATION: Handle.Constrains
    SCALE: Handle.Constrains
    class Targets(_message.Message):
        __slots__ = ("stiffness_per", "tangential")
        class StiffnessPer(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            VERTEX: _ClassVar[Handle.Targets.StiffnessPer]
            AREA: _ClassVar[Handle.Targets.StiffnessPer]
        VERTEX: Handle.Targets.StiffnessPer
        AREA: Handle.Targets.StiffnessPer
        STIFFNESS_PER_FIELD_NUMBER: _ClassVar[int]
        TANGENTIAL_FIELD_NUMBER: _ClassVar[int]
        stiffness_per: Handle.Targets.StiffnessPer
        tangential: float
        def __init__(self, stiffness_per: _Optional[_Union[Handle.Targets.StiffnessPer, str]] = ..., tangential: _Optional[float] = ...) -> None: ...
    ID_FIELD_NUMBER: _ClassVar[int]
    REGION_FIELD_NUMBER: _ClassVar[int]
    CONSTRAINS_FIELD_NUMBER: _ClassVar[int]
    STIFFNESS_FIELD_NUMBER: _ClassVar[int]
    RIGID_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    FALLOFF_FIELD_NUMBER: _ClassVar[int]
    TARGETS_FIELD_NUMBER: _ClassVar[int]
    GUIDE_FIELD_NUMBER: _ClassVar[int]
    id: str
    region: Region
    constrains: _containers.RepeatedScalarFieldContainer[Handle.Constrains]
    stiffness: float
    rigid: bool
    pose: HandlePose
    falloff: Falloff
    targets: Handle.Targets
    guide: Guide
    def __init__(self, id: _Optional[str] = ..., region: _Optional[_Union[Region, _Mapping]] = ..., constrains: _Optional[_Iterable[_Union[Handle.Constrains, str]]] = ..., stiffness: _Optional[float] = ..., rigid: bool = ..., pose: _Optional[_Union[HandlePose, _Mapping]] = ..., falloff: _Optional[_Union[Falloff, _Mapping]] = ..., targets: _Optional[_Union[Handle.Targets, _Mapping]] = ..., guide: _Optional[_Union[Guide, _Mapping]] = ...) -> None: ...

class Falloff(_message.Message):
    __slots__ = ("radius", "kind")
    class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NONE: _ClassVar[Falloff.Kind]
        LINEAR: _ClassVar[Falloff.Kind]
        SMOOTH: _ClassVar[Falloff.Kind]
    NONE: Falloff.Kind
    LINEAR: Falloff.Kind
    SMOOTH: Falloff.Kind
    RADIUS_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    radius: float
    kind: Falloff.Kind
    def __init__(self, radius: _Optional[float] = ..., kind: _Optional[_Union[Falloff.Kind, str]] = ...) -> None: ...

class Plane(_message.Message):
    __slots__ = ("normal", "offset")
    NORMAL_FIELD_NUMBER: _ClassVar[int]
    OFFSET_FIELD_NUMBER: _ClassVar[int]
    normal: _containers.RepeatedScalarFieldContainer[float]
    offset: float
    def __init__(self, normal: _Optional[_Iterable[float]] = ..., offset: _Optional[float] = ...) -> None: ...

class Stiff(_message.Message):
    __slots__ = ("primitives", "components", "regions", "all", "auto", "strength")
    PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    COMPONENTS_FIELD_NUMBER: _ClassVar[int]
    REGIONS_FIELD_NUMBER: _ClassVar[int]
    ALL_FIELD_NUMBER: _ClassVar[int]
    AUTO_FIELD_NUMBER: _ClassVar[int]
    STRENGTH_FIELD_NUMBER: _ClassVar[int]
    primitives: _containers.RepeatedScalarFieldContainer[int]
    components: _containers.RepeatedScalarFieldContainer[int]
    regions: _containers.RepeatedCompositeFieldContainer[Region]
    all: bool
    auto: bool
    strength: float
    def __init__(self, primitives: _Optional[_Iterable[int]] = ..., components: _Optional[_Iterable[int]] = ..., regions: _Optional[_Iterable[_Union[Region, _Mapping]]] = ..., all: bool = ..., auto: bool = ..., strength: _Optional[float] = ...) -> None: ...

class SetHandlesRequest(_message.Message):
    __slots__ = ("session_id", "handles", "symmetry_plane", "region_of_interest", "stiff")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    HANDLES_FIELD_NUMBER: _ClassVar[int]
    SYMMETRY_PLANE_FIELD_NUMBER: _ClassVar[int]
    REGION_OF_INTEREST_FIELD_NUMBER: _ClassVar[int]
    STIFF_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    handles: _containers.RepeatedCompositeFieldContainer[Handle]
    symmetry_plane: Plane
    region_of_interest: Region
    stiff: Stiff
    def __init__(self, session_id: _Optional[str] = ..., handles: _Optional[_Iterable[_Union[Handle, _Mapping]]] = ..., symmetry_plane: _Optional[_Union[Plane, _Mapping]] = ..., region_of_interest: _Optional[_Union[Region, _Mapping]] = ..., stiff: _Optional[_Union[Stiff, _Mapping]] = ...) -> None: ...

class Pose(_message.Message):
    __slots__ = ("seq", "handles", "commit", "idempotency_key", "more")
    class Entry(_message.Message):
        __slots__ = ("id", "pose")
        ID_FIELD_NUMBER: _ClassVar[int]
        POSE_FIELD_NUMBER: _ClassVar[int]
        id: str
        pose: HandlePose
        def __init__(self, id: _Optional[str] = ..., pose: _Optional[_Union[HandlePose, _Mapping]] = ...) -> None: ...
    SEQ_FIELD_NUMBER: _ClassVar[int]
    HANDLES_FIELD_NUMBER: _ClassVar[int]
    COMMIT_FIELD_NUMBER: _ClassVar[int]
    IDEMPOTENCY_KEY_FIELD_NUMBER: _ClassVar[int]
    MORE_FIELD_NUMBER: _ClassVar[int]
    seq: int
    handles: _containers.RepeatedCompositeFieldContainer[Pose.Entry]
    commit: bool
    idempotency_key: str
    more: bool
    def __init__(self, seq: _Optional[int] = ..., handles: _Optional[_Iterable[_Union[Pose.Entry, _Mapping]]] = ..., commit: bool = ..., idempotency_key: _Optional[str] = ..., more: bool = ...) -> None: ...

class Output(_message.Message):
    __slots__ = ("normals", "tangents", "changed_only", "encoding", "self_intersections", "gradients")
    NORMALS_FIELD_NUMBER: _ClassVar[int]
    TANGENTS_FIELD_NUMBER: _ClassVar[int]
    CHANGED_ONLY_FIELD_NUMBER: _ClassVar[int]
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    SELF_INTERSECTIONS_FIELD_NUMBER: _ClassVar[int]
    GRADIENTS_FIELD_NUMBER: _ClassVar[int]
    normals: bool
    tangents: bool
    changed_only: float
    encoding: Frame.Encoding
    self_intersections: bool
    gradients: bool
    def __init__(self, normals: bool = ..., tangents: bool = ..., changed_only: _Optional[float] = ..., encoding: _Optional[_Union[Frame.Encoding, str]] = ..., self_intersections: bool = ..., gradients: bool = ...) -> None: ...

class Options(_message.Message):
    __slots__ = ("tolerance", "max_error", "budget_ms", "progressive", "refine", "first_pass", "method", "rotation_smoothing", "output", "window", "volume", "fit", "contact", "clearance", "from_revision")
    class FirstPass(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        HARMONIC: _ClassVar[Options.FirstPass]
        DIFFUSION: _ClassVar[Options.FirstPass]
        LINEAR_FRAMES: _ClassVar[Options.FirstPass]
    HARMONIC: Options.FirstPass
    DIFFUSION: Options.FirstPass
    LINEAR_FRAMES: Options.FirstPass
    class Method(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        GRAPH: _ClassVar[Options.Method]
        SPATIAL_RBF: _ClassVar[Options.Method]
    GRAPH: Options.Method
    SPATIAL_RBF: Options.Method
    class Volume(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        KEEP: _ClassVar[Options.Volume]
        FREE: _ClassVar[Options.Volume]
    KEEP: Options.Volume
    FREE: Options.Volume
    class Fit(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        CONTINUED: _ClassVar[Options.Fit]
        COARSE_FIRST: _ClassVar[Options.Fit]
    CONTINUED: Options.Fit
    COARSE_FIRST: Options.Fit
    class Contact(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        IGNORE: _ClassVar[Options.Contact]
        AVOID: _ClassVar[Options.Contact]
    IGNORE: Options.Contact
    AVOID: Options.Contact
    TOLERANCE_FIELD_NUMBER: _ClassVar[int]
    MAX_ERROR_FIELD_NUMBER: _ClassVar[int]
    BUDGET_MS_FIELD_NUMBER: _ClassVar[int]
    PROGRESSIVE_FIELD_NUMBER: _ClassVar[int]
    REFINE_FIELD_NUMBER: _ClassVar[int]
    FIRST_PASS_FIELD_NUMBER: _ClassVar[int]
    METHOD_FIELD_NUMBER: _ClassVar[int]
    ROTATION_SMOOTHING_FIELD_NUMBER: _ClassVar[int]
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    WINDOW_FIELD_NUMBER: _ClassVar[int]
    VOLUME_FIELD_NUMBER: _ClassVar[int]
    FIT_FIELD_NUMBER: _ClassVar[int]
    CONTACT_FIELD_NUMBER: _ClassVar[int]
    CLEARANCE_FIELD_NUMBER: _ClassVar[int]
    FROM_REVISION_FIELD_NUMBER: _ClassVar[int]
    tolerance: float
    max_error: float
    budget_ms: float
    progressive: bool
    refine: int
    first_pass: Options.FirstPass
    method: Options.Method
    rotation_smoothing: float
    output: Output
    window: int
    volume: Options.Volume
    fit: Options.Fit
    contact: Options.Contact
    clearance: float
    from_revision: int
    def __init__(self, tolerance: _Optional[float] = ..., max_error: _Optional[float] = ..., budget_ms: _Optional[float] = ..., progressive: bool = ..., refine: _Optional[int] = ..., first_pass: _Optional[_Union[Options.FirstPass, str]] = ..., method: _Optional[_Union[Options.Method, str]] = ..., rotation_smoothing: _Optional[float] = ..., output: _Optional[_Union[Output, _Mapping]] = ..., window: _Optional[int] = ..., volume: _Optional[_Union[Options.Volume, str]] = ..., fit: _Optional[_Union[Options.Fit, str]] = ..., contact: _Optional[_Union[Options.Contact, str]] = ..., clearance: _Optional[float] = ..., from_revision: _Optional[int] = ...) -> None: ...

class Ack(_message.Message):
    __slots__ = ("seq",)
    SEQ_FIELD_NUMBER: _ClassVar[int]
    seq: int
    def __init__(self, seq: _Optional[int] = ...) -> None: ...

class Ping(_message.Message):
    __slots__ = ("nonce",)
    NONCE_FIELD_NUMBER: _ClassVar[int]
    nonce: int
    def __init__(self, nonce: _Optional[int] = ...) -> None: ...

class DeformRequest(_message.Message):
    __slots__ = ("session_id", "options", "pose", "ack", "ping")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    ACK_FIELD_NUMBER: _ClassVar[int]
    PING_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    options: Options
    pose: Pose
    ack: Ack
    ping: Ping
    def __init__(self, session_id: _Optional[str] = ..., options: _Optional[_Union[Options, _Mapping]] = ..., pose: _Optional[_Union[Pose, _Mapping]] = ..., ack: _Optional[_Union[Ack, _Mapping]] = ..., ping: _Optional[_Union[Ping, _Mapping]] = ...) -> None: ...

class Frame(_message.Message):
    __slots__ = ("seq", "revision", "part", "parts", "first_vertex", "encoding", "data", "final", "residual", "max_error", "solve_ms", "queue_ms", "superseded", "attribute", "vertex_count", "indices", "box_min", "box_max", "quality", "animated", "number", "found_turns", "origin")
    class Encoding(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        F32: _ClassVar[Frame.Encoding]
        U16: _ClassVar[Frame.Encoding]
        MESHOPT: _ClassVar[Frame.Encoding]
        DELTA: _ClassVar[Frame.Encoding]
    F32: Frame.Encoding
    U16: Frame.Encoding
    MESHOPT: Frame.Encoding
    DELTA: Frame.Encoding
    class Attribute(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        POSITION: _ClassVar[Frame.Attribute]
        NORMAL: _ClassVar[Frame.Attribute]
        TANGENT: _ClassVar[Frame.Attribute]
        ROTATION: _ClassVar[Frame.Attribute]
        STRETCH: _ClassVar[Frame.Attribute]
        SHEAR: _ClassVar[Frame.Attribute]
    POSITION: Frame.Attribute
    NORMAL: Frame.Attribute
    TANGENT: Frame.Attribute
    ROTATION: Frame.Attribute
    STRETCH: Frame.Attribute
    SHEAR: Frame.Attribute
    SEQ_FIELD_NUMBER: _ClassVar[int]
    REVISION_FIELD_NUMBER: _ClassVar[int]
    PART_FIELD_NUMBER: _ClassVar[int]
    PARTS_FIELD_NUMBER: _ClassVar[int]
    FIRST_VERTEX_FIELD_NUMBER: _ClassVar[int]
    ENCODING_FIELD_NUMBER: _ClassVar[int]
    DATA_FIELD_NUMBER: _ClassVar[int]
    FINAL_FIELD_NUMBER: _ClassVar[int]
    RESIDUAL_FIELD_NUMBER: _ClassVar[int]
    MAX_ERROR_FIELD_NUMBER: _ClassVar[int]
    SOLVE_MS_FIELD_NUMBER: _ClassVar[int]
    QUEUE_MS_FIELD_NUMBER: _ClassVar[int]
    SUPERSEDED_FIELD_NUMBER: _ClassVar[int]
    ATTRIBUTE_FIELD_NUMBER: _ClassVar[int]
    VERTEX_COUNT_FIELD_NUMBER: _ClassVar[int]
    INDICES_FIELD_NUMBER: _ClassVar[int]
    BOX_MIN_FIELD_NUMBER: _ClassVar[int]
    BOX_MAX_FIELD_NUMBER: _ClassVar[int]
    QUALITY_FIELD_NUMBER: _ClassVar[int]
    ANIMATED_FIELD_NUMBER: _ClassVar[int]
    NUMBER_FIELD_NUMBER: _ClassVar[int]
    FOUND_TURNS_FIELD_NUMBER: _ClassVar[int]
    ORIGIN_FIELD_NUMBER: _ClassVar[int]
    seq: int
    revision: int
    part: int
    parts: int
    first_vertex: int
    encoding: Frame.Encoding
    data: bytes
    final: bool
    residual: float
    max_error: float
    solve_ms: float
    queue_ms: float
    superseded: int
    attribute: Frame.Attribute
    vertex_count: int
    indices: _containers.RepeatedScalarFieldContainer[int]
    box_min: _containers.RepeatedScalarFieldContainer[float]
    box_max: _containers.RepeatedScalarFieldContainer[float]
    quality: Quality
    animated: Animated
    number: int
    found_turns: _containers.RepeatedCompositeFieldContainer[FoundTurn]
    origin: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, seq: _Optional[int] = ..., revision: _Optional[int] = ..., part: _Optional[int] = ..., parts: _Optional[int] = ..., first_vertex: _Optional[int] = ..., encoding: _Optional[_Union[Frame.Encoding, str]] = ..., data: _Optional[bytes] = ..., final: bool = ..., residual: _Optional[float] = ..., max_error: _Optional[float] = ..., solve_ms: _Optional[float] = ..., queue_ms: _Optional[float] = ..., superseded: _Optional[int] = ..., attribute: _Optional[_Union[Frame.Attribute, str]] = ..., vertex_count: _Optional[int] = ..., indices: _Optional[_Iterable[int]] = ..., box_min: _Optional[_Iterable[float]] = ..., box_max: _Optional[_Iterable[float]] = ..., quality: _Optional[_Union[Quality, _Mapping]] = ..., animated: _Optional[_Union[Animated, _Mapping]] = ..., number: _Optional[int] = ..., found_turns: _Optional[_Iterable[_Union[FoundTurn, _Mapping]]] = ..., origin: _Optional[_Iterable[float]] = ...) -> None: ...

class Animated(_message.Message):
    __slots__ = ("index", "count", "time", "root_translation", "root_rotation", "digest", "cycles", "stage", "fraction", "report")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    TIME_FIELD_NUMBER: _ClassVar[int]
    ROOT_TRANSLATION_FIELD_NUMBER: _ClassVar[int]
    ROOT_ROTATION_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    CYCLES_FIELD_NUMBER: _ClassVar[int]
    STAGE_FIELD_NUMBER: _ClassVar[int]
    FRACTION_FIELD_NUMBER: _ClassVar[int]
    REPORT_FIELD_NUMBER: _ClassVar[int]
    index: int
    count: int
    time: float
    root_translation: _containers.RepeatedScalarFieldContainer[float]
    root_rotation: _containers.RepeatedScalarFieldContainer[float]
    digest: str
    cycles: int
    stage: str
    fraction: float
    report: AnimationReport
    def __init__(self, index: _Optional[int] = ..., count: _Optional[int] = ..., time: _Optional[float] = ..., root_translation: _Optional[_Iterable[float]] = ..., root_rotation: _Optional[_Iterable[float]] = ..., digest: _Optional[str] = ..., cycles: _Optional[int] = ..., stage: _Optional[str] = ..., fraction: _Optional[float] = ..., report: _Optional[_Union[AnimationReport, _Mapping]] = ...) -> None: ...

class AnimateOptions(_message.Message):
    __slots__ = ("session_id", "clip", "bvh", "bvh_size", "rig", "fps", "first", "count", "skip_first", "scale", "refine", "tolerance", "root", "output", "window", "played_as", "max_targets", "bones", "plant_feet", "contact")
    class SkipFirst(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        AUTO: _ClassVar[AnimateOptions.SkipFirst]
        YES: _ClassVar[AnimateOptions.SkipFirst]
        NO: _ClassVar[AnimateOptions.SkipFirst]
    AUTO: AnimateOptions.SkipFirst
    YES: AnimateOptions.SkipFirst
    NO: AnimateOptions.SkipFirst
    class Root(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        NODE: _ClassVar[AnimateOptions.Root]
        BAKED: _ClassVar[AnimateOptions.Root]
        NONE: _ClassVar[AnimateOptions.Root]
    NODE: AnimateOptions.Root
    BAKED: AnimateOptions.Root
    NONE: AnimateOptions.Root
    class PlayedAs(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        MORPH: _ClassVar[AnimateOptions.PlayedAs]
        SKIN: _ClassVar[AnimateOptions.PlayedAs]
    MORPH: AnimateOptions.PlayedAs
    SKIN: AnimateOptions.PlayedAs
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    CLIP_FIELD_NUMBER: _ClassVar[int]
    BVH_FIELD_NUMBER: _ClassVar[int]
    BVH_SIZE_FIELD_NUMBER: _ClassVar[int]
    RIG_FIELD_NUMBER: _ClassVar[int]
    FPS_FIELD_NUMBER: _ClassVar[int]
    FIRST_FIELD_NUMBER: _ClassVar[int]
    COUNT_FIELD_NUMBER: _ClassVar[int]
    SKIP_FIRST_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    REFINE_FIELD_NUMBER: _ClassVar[int]
    TOLERANCE_FIELD_NUMBER: _ClassVar[int]
    ROOT_FIELD_NUMBER: _ClassVar[int]
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    WINDOW_FIELD_NUMBER: _ClassVar[int]
    PLAYED_AS_FIELD_NUMBER: _ClassVar[int]
    MAX_TARGETS_FIELD_NUMBER: _ClassVar[int]
    BONES_FIELD_NUMBER: _ClassVar[int]
    PLANT_FEET_FIELD_NUMBER: _ClassVar[int]
    CONTACT_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    clip: str
    bvh: bytes
    bvh_size: int
    rig: Rig
    fps: float
    first: int
    count: int
    skip_first: AnimateOptions.SkipFirst
    scale: float
    refine: int
    tolerance: float
    root: AnimateOptions.Root
    output: Output
    window: int
    played_as: AnimateOptions.PlayedAs
    max_targets: int
    bones: int
    plant_feet: bool
    contact: Options.Contact
    def __init__(self, session_id: _Optional[str] = ..., clip: _Optional[str] = ..., bvh: _Optional[bytes] = ..., bvh_size: _Optional[int] = ..., rig: _Optional[_Union[Rig, _Mapping]] = ..., fps: _Optional[float] = ..., first: _Optional[int] = ..., count: _Optional[int] = ..., skip_first: _Optional[_Union[AnimateOptions.SkipFirst, str]] = ..., scale: _Optional[float] = ..., refine: _Optional[int] = ..., tolerance: _Optional[float] = ..., root: _Optional[_Union[AnimateOptions.Root, str]] = ..., output: _Optional[_Union[Output, _Mapping]] = ..., window: _Optional[int] = ..., played_as: _Optional[_Union[AnimateOptions.PlayedAs, str]] = ..., max_targets: _Optional[int] = ..., bones: _Optional[int] = ..., plant_feet: bool = ..., contact: _Optional[_Union[Options.Contact, str]] = ...) -> None: ...

class AnimateRequest(_message.Message):
    __slots__ = ("options", "chunk", "ack", "cancel")
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    CHUNK_FIELD_NUMBER: _ClassVar[int]
    ACK_FIELD_NUMBER: _ClassVar[int]
    CANCEL_FIELD_NUMBER: _ClassVar[int]
    options: AnimateOptions
    chunk: bytes
    ack: Ack
    cancel: Cancel
    def __init__(self, options: _Optional[_Union[AnimateOptions, _Mapping]] = ..., chunk: _Optional[bytes] = ..., ack: _Optional[_Union[Ack, _Mapping]] = ..., cancel: _Optional[_Union[Cancel, _Mapping]] = ...) -> None: ...

class Cancel(_message.Message):
    __slots__ = ()
    def __init__(self) -> None: ...

class Notice(_message.Message):
    __slots__ = ("code", "message", "resume_token")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    RESUME_TOKEN_FIELD_NUMBER: _ClassVar[int]
    code: str
    message: str
    resume_token: str
    def __init__(self, code: _Optional[str] = ..., message: _Optional[str] = ..., resume_token: _Optional[str] = ...) -> None: ...

class Error(_message.Message):
    __slots__ = ("code", "message", "seq")
    CODE_FIELD_NUMBER: _ClassVar[int]
    MESSAGE_FIELD_NUMBER: _ClassVar[int]
    SEQ_FIELD_NUMBER: _ClassVar[int]
    code: int
    message: str
    seq: int
    def __init__(self, code: _Optional[int] = ..., message: _Optional[str] = ..., seq: _Optional[int] = ...) -> None: ...

class DeformResponse(_message.Message):
    __slots__ = ("frame", "notice", "error", "pong")
    FRAME_FIELD_NUMBER: _ClassVar[int]
    NOTICE_FIELD_NUMBER: _ClassVar[int]
    ERROR_FIELD_NUMBER: _ClassVar[int]
    PONG_FIELD_NUMBER: _ClassVar[int]
    frame: Frame
    notice: Notice
    error: Error
    pong: Ping
    def __init__(self, frame: _Optional[_Union[Frame, _Mapping]] = ..., notice: _Optional[_Union[Notice, _Mapping]] = ..., error: _Optional[_Union[Error, _Mapping]] = ..., pong: _Optional[_Union[Ping, _Mapping]] = ...) -> None: ...

class SolveRequest(_message.Message):
    __slots__ = ("session_id", "pose", "options")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    POSE_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    pose: Pose
    options: Options
    def __init__(self, session_id: _Optional[str] = ..., pose: _Optional[_Union[Pose, _Mapping]] = ..., options: _Optional[_Union[Options, _Mapping]] = ...) -> None: ...

class EditRequest(_message.Message):
    __slots__ = ("session_id", "on", "cut", "subdivide", "decimate", "delete", "fill", "remesh", "merge", "insert_curve", "weld", "smooth", "clean", "adopt", "wrap", "unintersect")
    class Cap(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        CONTINUED: _ClassVar[EditRequest.Cap]
        FLAT: _ClassVar[EditRequest.Cap]
    CONTINUED: EditRequest.Cap
    FLAT: EditRequest.Cap
    class On(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        CURRENT: _ClassVar[EditRequest.On]
        REST: _ClassVar[EditRequest.On]
    CURRENT: EditRequest.On
    REST: EditRequest.On
    class Cut(_message.Message):
        __slots__ = ("plane", "keep", "fill", "polyline", "path", "closed", "cap", "material")
        class Keep(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            BOTH: _ClassVar[EditRequest.Cut.Keep]
            ABOVE: _ClassVar[EditRequest.Cut.Keep]
            BELOW: _ClassVar[EditRequest.Cut.Keep]
        BOTH: EditRequest.Cut.Keep
        ABOVE: EditRequest.Cut.Keep
        BELOW: EditRequest.Cut.Keep
        PLANE_FIELD_NUMBER: _ClassVar[int]
        KEEP_FIELD_NUMBER: _ClassVar[int]
        FILL_FIELD_NUMBER: _ClassVar[int]
        POLYLINE_FIELD_NUMBER: _ClassVar[int]
        PATH_FIELD_NUMBER: _ClassVar[int]
        CLOSED_FIELD_NUMBER: _ClassVar[int]
        CAP_FIELD_NUMBER: _ClassVar[int]
        MATERIAL_FIELD_NUMBER: _ClassVar[int]
        plane: Plane
        keep: EditRequest.Cut.Keep
        fill: bool
        polyline: _containers.RepeatedScalarFieldContainer[float]
        path: _containers.RepeatedScalarFieldContainer[int]
        closed: bool
        cap: EditRequest.Cap
        material: str
        def __init__(self, plane: _Optional[_Union[Plane, _Mapping]] = ..., keep: _Optional[_Union[EditRequest.Cut.Keep, str]] = ..., fill: bool = ..., polyline: _Optional[_Iterable[float]] = ..., path: _Optional[_Iterable[int]] = ..., closed: bool = ..., cap: _Optional[_Union[EditRequest.Cap, str]] = ..., material: _Optional[str] = ...) -> None: ...
    class Subdivide(_message.Message):
        __slots__ = ("region", "scheme", "auto", "crease_degrees", "creases", "crease_primitives", "sharpness")
        class Scheme(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            LOOP: _ClassVar[EditRequest.Subdivide.Scheme]
            MIDPOINT: _ClassVar[EditRequest.Subdivide.Scheme]
        LOOP: EditRequest.Subdivide.Scheme
        MIDPOINT: EditRequest.Subdivide.Scheme
        REGION_FIELD_NUMBER: _ClassVar[int]
        SCHEME_FIELD_NUMBER: _ClassVar[int]
        AUTO_FIELD_NUMBER: _ClassVar[int]
        CREASE_DEGREES_FIELD_NUMBER: _ClassVar[int]
        CREASES_FIELD_NUMBER: _ClassVar[int]
        CREASE_PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
        SHARPNESS_FIELD_NUMBER: _ClassVar[int]
        region: Region
        scheme: EditRequest.Subdivide.Scheme
        auto: bool
        crease_degrees: float
        creases: _containers.RepeatedScalarFieldContainer[int]
        crease_primitives: bool
        sharpness: float
        def __init__(self, region: _Optional[_Union[Region, _Mapping]] = ..., scheme: _Optional[_Union[EditRequest.Subdivide.Scheme, str]] = ..., auto: bool = ..., crease_degrees: _Optional[float] = ..., creases: _Optional[_Iterable[int]] = ..., crease_primitives: bool = ..., sharpness: _Optional[float] = ...) -> None: ...
    class Decimate(_message.Message):
        __slots__ = ("region", "ratio")
        REGION_FIELD_NUMBER: _ClassVar[int]
        RATIO_FIELD_NUMBER: _ClassVar[int]
        region: Region
        ratio: float
        def __init__(self, region: _Optional[_Union[Region, _Mapping]] = ..., ratio: _Optional[float] = ...) -> None: ...
    class Delete(_message.Message):
        __slots__ = ("region", "fill")
        REGION_FIELD_NUMBER: _ClassVar[int]
        FILL_FIELD_NUMBER: _ClassVar[int]
        region: Region
        fill: bool
        def __init__(self, region: _Optional[_Union[Region, _Mapping]] = ..., fill: bool = ...) -> None: ...
    class Fill(_message.Message):
        __slots__ = ("region", "cap", "material")
        REGION_FIELD_NUMBER: _ClassVar[int]
        CAP_FIELD_NUMBER: _ClassVar[int]
        MATERIAL_FIELD_NUMBER: _ClassVar[int]
        region: Region
        cap: EditRequest.Cap
        material: str
        def __init__(self, region: _Optional[_Union[Region, _Mapping]] = ..., cap: _Optional[_Union[EditRequest.Cap, str]] = ..., material: _Optional[str] = ...) -> None: ...
    class Remesh(_message.Message):
        __slots__ = ("region", "edge_length", "auto", "max_deviation", "sharp_degrees")
        REGION_FIELD_NUMBER: _ClassVar[int]
        EDGE_LENGTH_FIELD_NUMBER: _ClassVar[int]
        AUTO_FIELD_NUMBER: _ClassVar[int]
        MAX_DEVIATION_FIELD_NUMBER: _ClassVar[int]
        SHARP_DEGREES_FIELD_NUMBER: _ClassVar[int]
        region: Region
        edge_length: float
        auto: bool
        max_deviation: float
        sharp_degrees: float
        def __init__(self, region: _Optional[_Union[Region, _Mapping]] = ..., edge_length: _Optional[float] = ..., auto: bool = ..., max_deviation: _Optional[float] = ..., sharp_degrees: _Optional[float] = ...) -> None: ...
    class Smooth(_message.Message):
        __slots__ = ("region", "kind", "iterations", "strength", "sharp_degrees")
        class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            SMOOTH: _ClassVar[EditRequest.Smooth.Kind]
            RELAX: _ClassVar[EditRequest.Smooth.Kind]
        SMOOTH: EditRequest.Smooth.Kind
        RELAX: EditRequest.Smooth.Kind
        REGION_FIELD_NUMBER: _ClassVar[int]
        KIND_FIELD_NUMBER: _ClassVar[int]
        ITERATIONS_FIELD_NUMBER: _ClassVar[int]
        STRENGTH_FIELD_NUMBER: _ClassVar[int]
        SHARP_DEGREES_FIELD_NUMBER: _ClassVar[int]
        region: Region
        kind: EditRequest.Smooth.Kind
        iterations: int
        strength: float
        sharp_degrees: float
        def __init__(self, region: _Optional[_Union[Region, _Mapping]] = ..., kind: _Optional[_Union[EditRequest.Smooth.Kind, str]] = ..., iterations: _Optional[int] = ..., strength: _Optional[float] = ..., sharp_degrees: _Optional[float] = ...) -> None: ...
    class Merge(_message.Message):
        __slots__ = ("model", "session", "file", "transform", "how", "tolerance", "format")
        class How(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            WELD: _ClassVar[EditRequest.Merge.How]
            STITCH: _ClassVar[EditRequest.Merge.How]
            LOOSE: _ClassVar[EditRequest.Merge.How]
        WELD: EditRequest.Merge.How
        STITCH: EditRequest.Merge.How
        LOOSE: EditRequest.Merge.How
        MODEL_FIELD_NUMBER: _ClassVar[int]
        SESSION_FIELD_NUMBER: _ClassVar[int]
        FILE_FIELD_NUMBER: _ClassVar[int]
        TRANSFORM_FIELD_NUMBER: _ClassVar[int]
        HOW_FIELD_NUMBER: _ClassVar[int]
        TOLERANCE_FIELD_NUMBER: _ClassVar[int]
        FORMAT_FIELD_NUMBER: _ClassVar[int]
        model: bytes
        session: str
        file: str
        transform: _containers.RepeatedScalarFieldContainer[float]
        how: EditRequest.Merge.How
        tolerance: float
        format: str
        def __init__(self, model: _Optional[bytes] = ..., session: _Optional[str] = ..., file: _Optional[str] = ..., transform: _Optional[_Iterable[float]] = ..., how: _Optional[_Union[EditRequest.Merge.How, str]] = ..., tolerance: _Optional[float] = ..., format: _Optional[str] = ...) -> None: ...
    class InsertCurve(_message.Message):
        __slots__ = ("points", "closed")
        POINTS_FIELD_NUMBER: _ClassVar[int]
        CLOSED_FIELD_NUMBER: _ClassVar[int]
        points: _containers.RepeatedScalarFieldContainer[float]
        closed: bool
        def __init__(self, points: _Optional[_Iterable[float]] = ..., closed: bool = ...) -> None: ...
    class Weld(_message.Message):
        __slots__ = ("tolerance",)
        TOLERANCE_FIELD_NUMBER: _ClassVar[int]
        tolerance: float
        def __init__(self, tolerance: _Optional[float] = ...) -> None: ...
    class Clean(_message.Message):
        __slots__ = ("keep_largest", "smallest_share", "smallest_size", "duplicates_within")
        KEEP_LARGEST_FIELD_NUMBER: _ClassVar[int]
        SMALLEST_SHARE_FIELD_NUMBER: _ClassVar[int]
        SMALLEST_SIZE_FIELD_NUMBER: _ClassVar[int]
        DUPLICATES_WITHIN_FIELD_NUMBER: _ClassVar[int]
        keep_largest: int
        smallest_share: float
        smallest_size: float
        duplicates_within: float
        def __init__(self, keep_largest: _Optional[int] = ..., smallest_share: _Optional[float] = ..., smallest_size: _Optional[float] = ..., duplicates_within: _Optional[float] = ...) -> None: ...
    class Adopt(_message.Message):
        __slots__ = ("positions", "first", "more", "shape")
        POSITIONS_FIELD_NUMBER: _ClassVar[int]
        FIRST_FIELD_NUMBER: _ClassVar[int]
        MORE_FIELD_NUMBER: _ClassVar[int]
        SHAPE_FIELD_NUMBER: _ClassVar[int]
        positions: bytes
        first: int
        more: bool
        shape: str
        def __init__(self, positions: _Optional[bytes] = ..., first: _Optional[int] = ..., more: bool = ..., shape: _Optional[str] = ...) -> None: ...
    class Wrap(_message.Message):
        __slots__ = ("model", "session", "file", "format", "landmarks", "mask", "in_place")
        class Landmark(_message.Message):
            __slots__ = ("name", "own_vertex", "own_point", "target_vertex", "target_point")
            NAME_FIELD_NUMBER: _ClassVar[int]
            OWN_VERTEX_FIELD_NUMBER: _ClassVar[int]
            OWN_POINT_FIELD_NUMBER: _ClassVar[int]
            TARGET_VERTEX_FIELD_NUMBER: _ClassVar[int]
            TARGET_POINT_FIELD_NUMBER: _ClassVar[int]
            name: str
            own_vertex: int
            own_point: _containers.RepeatedScalarFieldContainer[float]
            target_vertex: int
            target_point: _containers.RepeatedScalarFieldContainer[float]
            def __init__(self, name: _Optional[str] = ..., own_vertex: _Optional[int] = ..., own_point: _Optional[_Iterable[float]] = ..., target_vertex: _Optional[int] = ..., target_point: _Optional[_Iterable[float]] = ...) -> None: ...
        MODEL_FIELD_NUMBER: _ClassVar[int]
        SESSION_FIELD_NUMBER: _ClassVar[int]
        FILE_FIELD_NUMBER: _ClassVar[int]
        FORMAT_FIELD_NUMBER: _ClassVar[int]
        LANDMARKS_FIELD_NUMBER: _ClassVar[int]
        MASK_FIELD_NUMBER: _ClassVar[int]
        IN_PLACE_FIELD_NUMBER: _ClassVar[int]
        model: bytes
        session: str
        file: str
        format: str
        landmarks: _containers.RepeatedCompositeFieldContainer[EditRequest.Wrap.Landmark]
        mask: Region
        in_place: bool
        def __init__(self, model: _Optional[bytes] = ..., session: _Optional[str] = ..., file: _Optional[str] = ..., format: _Optional[str] = ..., landmarks: _Optional[_Iterable[_Union[EditRequest.Wrap.Landmark, _Mapping]]] = ..., mask: _Optional[_Union[Region, _Mapping]] = ..., in_place: bool = ...) -> None: ...
    class Unintersect(_message.Message):
        __slots__ = ("fixed", "clearance")
        FIXED_FIELD_NUMBER: _ClassVar[int]
        CLEARANCE_FIELD_NUMBER: _ClassVar[int]
        fixed: Region
        clearance: float
        def __init__(self, fixed: _Optional[_Union[Region, _Mapping]] = ..., clearance: _Optional[float] = ...) -> None: ...
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    ON_FIELD_NUMBER: _ClassVar[int]
    CUT_FIELD_NUMBER: _ClassVar[int]
    SUBDIVIDE_FIELD_NUMBER: _ClassVar[int]
    DECIMATE_FIELD_NUMBER: _ClassVar[int]
    DELETE_FIELD_NUMBER: _ClassVar[int]
    FILL_FIELD_NUMBER: _ClassVar[int]
    REMESH_FIELD_NUMBER: _ClassVar[int]
    MERGE_FIELD_NUMBER: _ClassVar[int]
    INSERT_CURVE_FIELD_NUMBER: _ClassVar[int]
    WELD_FIELD_NUMBER: _ClassVar[int]
    SMOOTH_FIELD_NUMBER: _ClassVar[int]
    CLEAN_FIELD_NUMBER: _ClassVar[int]
    ADOPT_FIELD_NUMBER: _ClassVar[int]
    WRAP_FIELD_NUMBER: _ClassVar[int]
    UNINTERSECT_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    on: EditRequest.On
    cut: EditRequest.Cut
    subdivide: EditRequest.Subdivide
    decimate: EditRequest.Decimate
    delete: EditRequest.Delete
    fill: EditRequest.Fill
    remesh: EditRequest.Remesh
    merge: EditRequest.Merge
    insert_curve: EditRequest.InsertCurve
    weld: EditRequest.Weld
    smooth: EditRequest.Smooth
    clean: EditRequest.Clean
    adopt: EditRequest.Adopt
    wrap: EditRequest.Wrap
    unintersect: EditRequest.Unintersect
    def __init__(self, session_id: _Optional[str] = ..., on: _Optional[_Union[EditRequest.On, str]] = ..., cut: _Optional[_Union[EditRequest.Cut, _Mapping]] = ..., subdivide: _Optional[_Union[EditRequest.Subdivide, _Mapping]] = ..., decimate: _Optional[_Union[EditRequest.Decimate, _Mapping]] = ..., delete: _Optional[_Union[EditRequest.Delete, _Mapping]] = ..., fill: _Optional[_Union[EditRequest.Fill, _Mapping]] = ..., remesh: _Optional[_Union[EditRequest.Remesh, _Mapping]] = ..., merge: _Optional[_Union[EditRequest.Merge, _Mapping]] = ..., insert_curve: _Optional[_Union[EditRequest.InsertCurve, _Mapping]] = ..., weld: _Optional[_Union[EditRequest.Weld, _Mapping]] = ..., smooth: _Optional[_Union[EditRequest.Smooth, _Mapping]] = ..., clean: _Optional[_Union[EditRequest.Clean, _Mapping]] = ..., adopt: _Optional[_Union[EditRequest.Adopt, _Mapping]] = ..., wrap: _Optional[_Union[EditRequest.Wrap, _Mapping]] = ..., unintersect: _Optional[_Union[EditRequest.Unintersect, _Mapping]] = ...) -> None: ...

class WrapReport(_message.Message):
    __slots__ = ("to_target", "from_target", "landmarks", "vertices", "unpulled_vertices", "flipped_triangles", "edge_distortion", "crossings_before", "crossings")
    class Distances(_message.Message):
        __slots__ = ("p50", "p95", "max")
        P50_FIELD_NUMBER: _ClassVar[int]
        P95_FIELD_NUMBER: _ClassVar[int]
        MAX_FIELD_NUMBER: _ClassVar[int]
        p50: float
        p95: float
        max: float
        def __init__(self, p50: _Optional[float] = ..., p95: _Optional[float] = ..., max: _Optional[float] = ...) -> None: ...
    TO_TARGET_FIELD_NUMBER: _ClassVar[int]
    FROM_TARGET_FIELD_NUMBER: _ClassVar[int]
    LANDMARKS_FIELD_NUMBER: _ClassVar[int]
    VERTICES_FIELD_NUMBER: _ClassVar[int]
    UNPULLED_VERTICES_FIELD_NUMBER: _ClassVar[int]
    FLIPPED_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    EDGE_DISTORTION_FIELD_NUMBER: _ClassVar[int]
    CROSSINGS_BEFORE_FIELD_NUMBER: _ClassVar[int]
    CROSSINGS_FIELD_NUMBER: _ClassVar[int]
    to_target: WrapReport.Distances
    from_target: WrapReport.Distances
    landmarks: WrapReport.Distances
    vertices: int
    unpulled_vertices: int
    flipped_triangles: int
    edge_distortion: float
    crossings_before: int
    crossings: int
    def __init__(self, to_target: _Optional[_Union[WrapReport.Distances, _Mapping]] = ..., from_target: _Optional[_Union[WrapReport.Distances, _Mapping]] = ..., landmarks: _Optional[_Union[WrapReport.Distances, _Mapping]] = ..., vertices: _Optional[int] = ..., unpulled_vertices: _Optional[int] = ..., flipped_triangles: _Optional[int] = ..., edge_distortion: _Optional[float] = ..., crossings_before: _Optional[int] = ..., crossings: _Optional[int] = ...) -> None: ...

class UnintersectReport(_message.Message):
    __slots__ = ("crossings_before", "crossings", "moved_vertices", "largest_move", "rms_move", "largest_move_in_edges", "rms_move_in_edges")
    CROSSINGS_BEFORE_FIELD_NUMBER: _ClassVar[int]
    CROSSINGS_FIELD_NUMBER: _ClassVar[int]
    MOVED_VERTICES_FIELD_NUMBER: _ClassVar[int]
    LARGEST_MOVE_FIELD_NUMBER: _ClassVar[int]
    RMS_MOVE_FIELD_NUMBER: _ClassVar[int]
    LARGEST_MOVE_IN_EDGES_FIELD_NUMBER: _ClassVar[int]
    RMS_MOVE_IN_EDGES_FIELD_NUMBER: _ClassVar[int]
    crossings_before: int
    crossings: int
    moved_vertices: int
    largest_move: float
    rms_move: float
    largest_move_in_edges: float
    rms_move_in_edges: float
    def __init__(self, crossings_before: _Optional[int] = ..., crossings: _Optional[int] = ..., moved_vertices: _Optional[int] = ..., largest_move: _Optional[float] = ..., rms_move: _Optional[float] = ..., largest_move_in_edges: _Optional[float] = ..., rms_move_in_edges: _Optional[float] = ...) -> None: ...

class EditResult(_message.Message):
    __slots__ = ("revision", "before", "after", "handles_kept", "warnings", "ms", "kept", "curve", "digest", "repaired", "deviation", "volume_change", "creases", "wrap", "unintersect")
    class Counts(_message.Message):
        __slots__ = ("vertices", "faces")
        VERTICES_FIELD_NUMBER: _ClassVar[int]
        FACES_FIELD_NUMBER: _ClassVar[int]
        vertices: int
        faces: int
        def __init__(self, vertices: _Optional[int] = ..., faces: _Optional[int] = ...) -> None: ...
    class MsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    class Run(_message.Message):
        __slots__ = ("was", "now", "count")
        WAS_FIELD_NUMBER: _ClassVar[int]
        NOW_FIELD_NUMBER: _ClassVar[int]
        COUNT_FIELD_NUMBER: _ClassVar[int]
        was: int
        now: int
        count: int
        def __init__(self, was: _Optional[int] = ..., now: _Optional[int] = ..., count: _Optional[int] = ...) -> None: ...
    REVISION_FIELD_NUMBER: _ClassVar[int]
    BEFORE_FIELD_NUMBER: _ClassVar[int]
    AFTER_FIELD_NUMBER: _ClassVar[int]
    HANDLES_KEPT_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    MS_FIELD_NUMBER: _ClassVar[int]
    KEPT_FIELD_NUMBER: _ClassVar[int]
    CURVE_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    REPAIRED_FIELD_NUMBER: _ClassVar[int]
    DEVIATION_FIELD_NUMBER: _ClassVar[int]
    VOLUME_CHANGE_FIELD_NUMBER: _ClassVar[int]
    CREASES_FIELD_NUMBER: _ClassVar[int]
    WRAP_FIELD_NUMBER: _ClassVar[int]
    UNINTERSECT_FIELD_NUMBER: _ClassVar[int]
    revision: int
    before: EditResult.Counts
    after: EditResult.Counts
    handles_kept: _containers.RepeatedScalarFieldContainer[str]
    warnings: _containers.RepeatedCompositeFieldContainer[Warning]
    ms: _containers.ScalarMap[str, float]
    kept: _containers.RepeatedCompositeFieldContainer[EditResult.Run]
    curve: _containers.RepeatedScalarFieldContainer[int]
    digest: str
    repaired: bool
    deviation: float
    volume_change: float
    creases: _containers.RepeatedScalarFieldContainer[int]
    wrap: WrapReport
    unintersect: UnintersectReport
    def __init__(self, revision: _Optional[int] = ..., before: _Optional[_Union[EditResult.Counts, _Mapping]] = ..., after: _Optional[_Union[EditResult.Counts, _Mapping]] = ..., handles_kept: _Optional[_Iterable[str]] = ..., warnings: _Optional[_Iterable[_Union[Warning, _Mapping]]] = ..., ms: _Optional[_Mapping[str, float]] = ..., kept: _Optional[_Iterable[_Union[EditResult.Run, _Mapping]]] = ..., curve: _Optional[_Iterable[int]] = ..., digest: _Optional[str] = ..., repaired: bool = ..., deviation: _Optional[float] = ..., volume_change: _Optional[float] = ..., creases: _Optional[_Iterable[int]] = ..., wrap: _Optional[_Union[WrapReport, _Mapping]] = ..., unintersect: _Optional[_Union[UnintersectReport, _Mapping]] = ...) -> None: ...

class Commit(_message.Message):
    __slots__ = ("revision", "kind", "digest")
    REVISION_FIELD_NUMBER: _ClassVar[int]
    KIND_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    revision: int
    kind: str
    digest: str
    def __init__(self, revision: _Optional[int] = ..., kind: _Optional[str] = ..., digest: _Optional[str] = ...) -> None: ...

class HistoryResponse(_message.Message):
    __slots__ = ("commits", "current")
    COMMITS_FIELD_NUMBER: _ClassVar[int]
    CURRENT_FIELD_NUMBER: _ClassVar[int]
    commits: _containers.RepeatedCompositeFieldContainer[Commit]
    current: int
    def __init__(self, commits: _Optional[_Iterable[_Union[Commit, _Mapping]]] = ..., current: _Optional[int] = ...) -> None: ...

class ExportRequest(_message.Message):
    __slots__ = ("session_id", "format")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    format: str
    def __init__(self, session_id: _Optional[str] = ..., format: _Optional[str] = ...) -> None: ...

class Followed(_message.Message):
    __slots__ = ("joints", "moved_joints", "clips", "rewritten_clips", "morph_targets", "carried_morph_targets", "passengers", "moved_passengers", "farthest", "passenger_nodes", "moved_passenger_nodes")
    class Joint(_message.Message):
        __slots__ = ("node", "name", "distance")
        NODE_FIELD_NUMBER: _ClassVar[int]
        NAME_FIELD_NUMBER: _ClassVar[int]
        DISTANCE_FIELD_NUMBER: _ClassVar[int]
        node: int
        name: str
        distance: float
        def __init__(self, node: _Optional[int] = ..., name: _Optional[str] = ..., distance: _Optional[float] = ...) -> None: ...
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    MOVED_JOINTS_FIELD_NUMBER: _ClassVar[int]
    CLIPS_FIELD_NUMBER: _ClassVar[int]
    REWRITTEN_CLIPS_FIELD_NUMBER: _ClassVar[int]
    MORPH_TARGETS_FIELD_NUMBER: _ClassVar[int]
    CARRIED_MORPH_TARGETS_FIELD_NUMBER: _ClassVar[int]
    PASSENGERS_FIELD_NUMBER: _ClassVar[int]
    MOVED_PASSENGERS_FIELD_NUMBER: _ClassVar[int]
    FARTHEST_FIELD_NUMBER: _ClassVar[int]
    PASSENGER_NODES_FIELD_NUMBER: _ClassVar[int]
    MOVED_PASSENGER_NODES_FIELD_NUMBER: _ClassVar[int]
    joints: int
    moved_joints: int
    clips: int
    rewritten_clips: int
    morph_targets: int
    carried_morph_targets: int
    passengers: int
    moved_passengers: int
    farthest: _containers.RepeatedCompositeFieldContainer[Followed.Joint]
    passenger_nodes: int
    moved_passenger_nodes: int
    def __init__(self, joints: _Optional[int] = ..., moved_joints: _Optional[int] = ..., clips: _Optional[int] = ..., rewritten_clips: _Optional[int] = ..., morph_targets: _Optional[int] = ..., carried_morph_targets: _Optional[int] = ..., passengers: _Optional[int] = ..., moved_passengers: _Optional[int] = ..., farthest: _Optional[_Iterable[_Union[Followed.Joint, _Mapping]]] = ..., passenger_nodes: _Optional[int] = ..., moved_passenger_nodes: _Optional[int] = ...) -> None: ...

class Chunk(_message.Message):
    __slots__ = ("data", "uri", "followed", "warnings", "transferred")
    DATA_FIELD_NUMBER: _ClassVar[int]
    URI_FIELD_NUMBER: _ClassVar[int]
    FOLLOWED_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    TRANSFERRED_FIELD_NUMBER: _ClassVar[int]
    data: bytes
    uri: str
    followed: Followed
    warnings: _containers.RepeatedCompositeFieldContainer[Warning]
    transferred: TransferReport
    def __init__(self, data: _Optional[bytes] = ..., uri: _Optional[str] = ..., followed: _Optional[_Union[Followed, _Mapping]] = ..., warnings: _Optional[_Iterable[_Union[Warning, _Mapping]]] = ..., transferred: _Optional[_Union[TransferReport, _Mapping]] = ...) -> None: ...

class TransferRequest(_message.Message):
    __slots__ = ("session_id", "model", "session", "format", "landmarks", "shape", "shape_format", "output", "fit")
    class Fit(_message.Message):
        __slots__ = ("clearance",)
        CLEARANCE_FIELD_NUMBER: _ClassVar[int]
        clearance: float
        def __init__(self, clearance: _Optional[float] = ...) -> None: ...
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    SESSION_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    LANDMARKS_FIELD_NUMBER: _ClassVar[int]
    SHAPE_FIELD_NUMBER: _ClassVar[int]
    SHAPE_FORMAT_FIELD_NUMBER: _ClassVar[int]
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    FIT_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    model: bytes
    session: str
    format: str
    landmarks: _containers.RepeatedCompositeFieldContainer[EditRequest.Wrap.Landmark]
    shape: bytes
    shape_format: str
    output: str
    fit: TransferRequest.Fit
    def __init__(self, session_id: _Optional[str] = ..., model: _Optional[bytes] = ..., session: _Optional[str] = ..., format: _Optional[str] = ..., landmarks: _Optional[_Iterable[_Union[EditRequest.Wrap.Landmark, _Mapping]]] = ..., shape: _Optional[bytes] = ..., shape_format: _Optional[str] = ..., output: _Optional[str] = ..., fit: _Optional[_Union[TransferRequest.Fit, _Mapping]] = ...) -> None: ...

class TransferReport(_message.Message):
    __slots__ = ("shapes", "clips", "wrap", "fit")
    class Shape(_message.Message):
        __slots__ = ("name", "moved_vertices", "largest_move", "flipped_triangles", "flipped_in_source")
        NAME_FIELD_NUMBER: _ClassVar[int]
        MOVED_VERTICES_FIELD_NUMBER: _ClassVar[int]
        LARGEST_MOVE_FIELD_NUMBER: _ClassVar[int]
        FLIPPED_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
        FLIPPED_IN_SOURCE_FIELD_NUMBER: _ClassVar[int]
        name: str
        moved_vertices: int
        largest_move: float
        flipped_triangles: int
        flipped_in_source: int
        def __init__(self, name: _Optional[str] = ..., moved_vertices: _Optional[int] = ..., largest_move: _Optional[float] = ..., flipped_triangles: _Optional[int] = ..., flipped_in_source: _Optional[int] = ...) -> None: ...
    class Fit(_message.Message):
        __slots__ = ("vertices", "inside_at_rest", "inside_carried", "inside", "crossings_carried", "crossings", "edge_distortion")
        VERTICES_FIELD_NUMBER: _ClassVar[int]
        INSIDE_AT_REST_FIELD_NUMBER: _ClassVar[int]
        INSIDE_CARRIED_FIELD_NUMBER: _ClassVar[int]
        INSIDE_FIELD_NUMBER: _ClassVar[int]
        CROSSINGS_CARRIED_FIELD_NUMBER: _ClassVar[int]
        CROSSINGS_FIELD_NUMBER: _ClassVar[int]
        EDGE_DISTORTION_FIELD_NUMBER: _ClassVar[int]
        vertices: int
        inside_at_rest: int
        inside_carried: int
        inside: int
        crossings_carried: int
        crossings: int
        edge_distortion: float
        def __init__(self, vertices: _Optional[int] = ..., inside_at_rest: _Optional[int] = ..., inside_carried: _Optional[int] = ..., inside: _Optional[int] = ..., crossings_carried: _Optional[int] = ..., crossings: _Optional[int] = ..., edge_distortion: _Optional[float] = ...) -> None: ...
    SHAPES_FIELD_NUMBER: _ClassVar[int]
    CLIPS_FIELD_NUMBER: _ClassVar[int]
    WRAP_FIELD_NUMBER: _ClassVar[int]
    FIT_FIELD_NUMBER: _ClassVar[int]
    shapes: _containers.RepeatedCompositeFieldContainer[TransferReport.Shape]
    clips: int
    wrap: WrapReport
    fit: TransferReport.Fit
    def __init__(self, shapes: _Optional[_Iterable[_Union[TransferReport.Shape, _Mapping]]] = ..., clips: _Optional[int] = ..., wrap: _Optional[_Union[WrapReport, _Mapping]] = ..., fit: _Optional[_Union[TransferReport.Fit, _Mapping]] = ...) -> None: ...

class CarryRequest(_message.Message):
    __slots__ = ("session_id", "points", "rotations", "model", "format")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    ROTATIONS_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    FORMAT_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    points: _containers.RepeatedScalarFieldContainer[float]
    rotations: _containers.RepeatedScalarFieldContainer[float]
    model: bytes
    format: str
    def __init__(self, session_id: _Optional[str] = ..., points: _Optional[_Iterable[float]] = ..., rotations: _Optional[_Iterable[float]] = ..., model: _Optional[bytes] = ..., format: _Optional[str] = ...) -> None: ...

class CarryResponse(_message.Message):
    __slots__ = ("revision", "points", "rotations", "scales", "model", "warnings")
    REVISION_FIELD_NUMBER: _ClassVar[int]
    POINTS_FIELD_NUMBER: _ClassVar[int]
    ROTATIONS_FIELD_NUMBER: _ClassVar[int]
    SCALES_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    revision: int
    points: _containers.RepeatedScalarFieldContainer[float]
    rotations: _containers.RepeatedScalarFieldContainer[float]
    scales: _containers.RepeatedScalarFieldContainer[float]
    model: bytes
    warnings: _containers.RepeatedCompositeFieldContainer[Warning]
    def __init__(self, revision: _Optional[int] = ..., points: _Optional[_Iterable[float]] = ..., rotations: _Optional[_Iterable[float]] = ..., scales: _Optional[_Iterable[float]] = ..., model: _Optional[bytes] = ..., warnings: _Optional[_Iterable[_Union[Warning, _Mapping]]] = ...) -> None: ...

class CrossingsRequest(_message.Message):
    __slots__ = ("session_id", "limit", "pairs")
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    LIMIT_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    limit: int
    pairs: bool
    def __init__(self, session_id: _Optional[str] = ..., limit: _Optional[int] = ..., pairs: bool = ...) -> None: ...

class CrossingsResponse(_message.Message):
    __slots__ = ("revision", "triangles", "total", "at_rest", "total_at_rest", "pairs", "new_pairs", "at_rest_pairs", "held_pairs")
    class Pair(_message.Message):
        __slots__ = ("first", "second", "kind", "at", "depth")
        class Kind(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
            __slots__ = ()
            NEW: _ClassVar[CrossingsResponse.Pair.Kind]
            AT_REST: _ClassVar[CrossingsResponse.Pair.Kind]
            HELD: _ClassVar[CrossingsResponse.Pair.Kind]
        NEW: CrossingsResponse.Pair.Kind
        AT_REST: CrossingsResponse.Pair.Kind
        HELD: CrossingsResponse.Pair.Kind
        FIRST_FIELD_NUMBER: _ClassVar[int]
        SECOND_FIELD_NUMBER: _ClassVar[int]
        KIND_FIELD_NUMBER: _ClassVar[int]
        AT_FIELD_NUMBER: _ClassVar[int]
        DEPTH_FIELD_NUMBER: _ClassVar[int]
        first: int
        second: int
        kind: CrossingsResponse.Pair.Kind
        at: _containers.RepeatedScalarFieldContainer[float]
        depth: float
        def __init__(self, first: _Optional[int] = ..., second: _Optional[int] = ..., kind: _Optional[_Union[CrossingsResponse.Pair.Kind, str]] = ..., at: _Optional[_Iterable[float]] = ..., depth: _Optional[float] = ...) -> None: ...
    REVISION_FIELD_NUMBER: _ClassVar[int]
    TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    TOTAL_FIELD_NUMBER: _ClassVar[int]
    AT_REST_FIELD_NUMBER: _ClassVar[int]
    TOTAL_AT_REST_FIELD_NUMBER: _ClassVar[int]
    PAIRS_FIELD_NUMBER: _ClassVar[int]
    NEW_PAIRS_FIELD_NUMBER: _ClassVar[int]
    AT_REST_PAIRS_FIELD_NUMBER: _ClassVar[int]
    HELD_PAIRS_FIELD_NUMBER: _ClassVar[int]
    revision: int
    triangles: _containers.RepeatedScalarFieldContainer[int]
    total: int
    at_rest: _containers.RepeatedScalarFieldContainer[int]
    total_at_rest: int
    pairs: _containers.RepeatedCompositeFieldContainer[CrossingsResponse.Pair]
    new_pairs: int
    at_rest_pairs: int
    held_pairs: int
    def __init__(self, revision: _Optional[int] = ..., triangles: _Optional[_Iterable[int]] = ..., total: _Optional[int] = ..., at_rest: _Optional[_Iterable[int]] = ..., total_at_rest: _Optional[int] = ..., pairs: _Optional[_Iterable[_Union[CrossingsResponse.Pair, _Mapping]]] = ..., new_pairs: _Optional[int] = ..., at_rest_pairs: _Optional[int] = ..., held_pairs: _Optional[int] = ...) -> None: ...

class MakeRigRequest(_message.Message):
    __slots__ = ("session_id", "bvh", "preset", "joints", "up", "front")
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: Rig.Joint
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[Rig.Joint, _Mapping]] = ...) -> None: ...
    SESSION_ID_FIELD_NUMBER: _ClassVar[int]
    BVH_FIELD_NUMBER: _ClassVar[int]
    PRESET_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    UP_FIELD_NUMBER: _ClassVar[int]
    FRONT_FIELD_NUMBER: _ClassVar[int]
    session_id: str
    bvh: bytes
    preset: str
    joints: _containers.MessageMap[str, Rig.Joint]
    up: str
    front: str
    def __init__(self, session_id: _Optional[str] = ..., bvh: _Optional[bytes] = ..., preset: _Optional[str] = ..., joints: _Optional[_Mapping[str, Rig.Joint]] = ..., up: _Optional[str] = ..., front: _Optional[str] = ...) -> None: ...

class MakeRigResponse(_message.Message):
    __slots__ = ("rig", "joints", "source", "up", "front", "warnings")
    class Joint(_message.Message):
        __slots__ = ("name", "at", "score", "reason", "doubtful", "inside")
        NAME_FIELD_NUMBER: _ClassVar[int]
        AT_FIELD_NUMBER: _ClassVar[int]
        SCORE_FIELD_NUMBER: _ClassVar[int]
        REASON_FIELD_NUMBER: _ClassVar[int]
        DOUBTFUL_FIELD_NUMBER: _ClassVar[int]
        INSIDE_FIELD_NUMBER: _ClassVar[int]
        name: str
        at: _containers.RepeatedScalarFieldContainer[float]
        score: float
        reason: str
        doubtful: bool
        inside: bool
        def __init__(self, name: _Optional[str] = ..., at: _Optional[_Iterable[float]] = ..., score: _Optional[float] = ..., reason: _Optional[str] = ..., doubtful: bool = ..., inside: bool = ...) -> None: ...
    RIG_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    SOURCE_FIELD_NUMBER: _ClassVar[int]
    UP_FIELD_NUMBER: _ClassVar[int]
    FRONT_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    rig: Rig
    joints: _containers.RepeatedCompositeFieldContainer[MakeRigResponse.Joint]
    source: str
    up: str
    front: str
    warnings: _containers.RepeatedScalarFieldContainer[str]
    def __init__(self, rig: _Optional[_Union[Rig, _Mapping]] = ..., joints: _Optional[_Iterable[_Union[MakeRigResponse.Joint, _Mapping]]] = ..., source: _Optional[str] = ..., up: _Optional[str] = ..., front: _Optional[str] = ..., warnings: _Optional[_Iterable[str]] = ...) -> None: ...

class Expect(_message.Message):
    __slots__ = ("max_distance", "mean_distance", "normal_degrees", "flipped_triangles", "volume_change", "digest", "new_self_intersections")
    MAX_DISTANCE_FIELD_NUMBER: _ClassVar[int]
    MEAN_DISTANCE_FIELD_NUMBER: _ClassVar[int]
    NORMAL_DEGREES_FIELD_NUMBER: _ClassVar[int]
    FLIPPED_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    VOLUME_CHANGE_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    NEW_SELF_INTERSECTIONS_FIELD_NUMBER: _ClassVar[int]
    max_distance: float
    mean_distance: float
    normal_degrees: float
    flipped_triangles: int
    volume_change: float
    digest: str
    new_self_intersections: int
    def __init__(self, max_distance: _Optional[float] = ..., mean_distance: _Optional[float] = ..., normal_degrees: _Optional[float] = ..., flipped_triangles: _Optional[int] = ..., volume_change: _Optional[float] = ..., digest: _Optional[str] = ..., new_self_intersections: _Optional[int] = ...) -> None: ...

class Step(_message.Message):
    __slots__ = ("pose", "edit")
    POSE_FIELD_NUMBER: _ClassVar[int]
    EDIT_FIELD_NUMBER: _ClassVar[int]
    pose: Pose
    edit: EditRequest
    def __init__(self, pose: _Optional[_Union[Pose, _Mapping]] = ..., edit: _Optional[_Union[EditRequest, _Mapping]] = ...) -> None: ...

class Job(_message.Message):
    __slots__ = ("create", "handles", "steps", "options", "expect", "symmetry_plane", "region_of_interest", "stiff")
    CREATE_FIELD_NUMBER: _ClassVar[int]
    HANDLES_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    OPTIONS_FIELD_NUMBER: _ClassVar[int]
    EXPECT_FIELD_NUMBER: _ClassVar[int]
    SYMMETRY_PLANE_FIELD_NUMBER: _ClassVar[int]
    REGION_OF_INTEREST_FIELD_NUMBER: _ClassVar[int]
    STIFF_FIELD_NUMBER: _ClassVar[int]
    create: CreateOptions
    handles: _containers.RepeatedCompositeFieldContainer[Handle]
    steps: _containers.RepeatedCompositeFieldContainer[Step]
    options: Options
    expect: Expect
    symmetry_plane: Plane
    region_of_interest: Region
    stiff: Stiff
    def __init__(self, create: _Optional[_Union[CreateOptions, _Mapping]] = ..., handles: _Optional[_Iterable[_Union[Handle, _Mapping]]] = ..., steps: _Optional[_Iterable[_Union[Step, _Mapping]]] = ..., options: _Optional[_Union[Options, _Mapping]] = ..., expect: _Optional[_Union[Expect, _Mapping]] = ..., symmetry_plane: _Optional[_Union[Plane, _Mapping]] = ..., region_of_interest: _Optional[_Union[Region, _Mapping]] = ..., stiff: _Optional[_Union[Stiff, _Mapping]] = ...) -> None: ...

class Report(_message.Message):
    __slots__ = ("model", "warnings", "steps", "quality", "digest", "solver", "build_ms", "handles", "output", "passengers", "followed")
    class Step(_message.Message):
        __slots__ = ("kind", "ms", "cycles", "residual", "max_error", "levels", "bytes", "quality", "digest", "field_cycles", "solver", "edit")
        class MsEntry(_message.Message):
            __slots__ = ("key", "value")
            KEY_FIELD_NUMBER: _ClassVar[int]
            VALUE_FIELD_NUMBER: _ClassVar[int]
            key: str
            value: float
            def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
        KIND_FIELD_NUMBER: _ClassVar[int]
        MS_FIELD_NUMBER: _ClassVar[int]
        CYCLES_FIELD_NUMBER: _ClassVar[int]
        RESIDUAL_FIELD_NUMBER: _ClassVar[int]
        MAX_ERROR_FIELD_NUMBER: _ClassVar[int]
        LEVELS_FIELD_NUMBER: _ClassVar[int]
        BYTES_FIELD_NUMBER: _ClassVar[int]
        QUALITY_FIELD_NUMBER: _ClassVar[int]
        DIGEST_FIELD_NUMBER: _ClassVar[int]
        FIELD_CYCLES_FIELD_NUMBER: _ClassVar[int]
        SOLVER_FIELD_NUMBER: _ClassVar[int]
        EDIT_FIELD_NUMBER: _ClassVar[int]
        kind: str
        ms: _containers.ScalarMap[str, float]
        cycles: int
        residual: float
        max_error: float
        levels: int
        bytes: int
        quality: Quality
        digest: str
        field_cycles: int
        solver: str
        edit: EditResult
        def __init__(self, kind: _Optional[str] = ..., ms: _Optional[_Mapping[str, float]] = ..., cycles: _Optional[int] = ..., residual: _Optional[float] = ..., max_error: _Optional[float] = ..., levels: _Optional[int] = ..., bytes: _Optional[int] = ..., quality: _Optional[_Union[Quality, _Mapping]] = ..., digest: _Optional[str] = ..., field_cycles: _Optional[int] = ..., solver: _Optional[str] = ..., edit: _Optional[_Union[EditResult, _Mapping]] = ...) -> None: ...
    class BuildMsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    class Passenger(_message.Message):
        __slots__ = ("name", "positions", "rotations", "scales", "output", "nodes")
        NAME_FIELD_NUMBER: _ClassVar[int]
        POSITIONS_FIELD_NUMBER: _ClassVar[int]
        ROTATIONS_FIELD_NUMBER: _ClassVar[int]
        SCALES_FIELD_NUMBER: _ClassVar[int]
        OUTPUT_FIELD_NUMBER: _ClassVar[int]
        NODES_FIELD_NUMBER: _ClassVar[int]
        name: str
        positions: _containers.RepeatedScalarFieldContainer[float]
        rotations: _containers.RepeatedScalarFieldContainer[float]
        scales: _containers.RepeatedScalarFieldContainer[float]
        output: str
        nodes: _containers.RepeatedScalarFieldContainer[int]
        def __init__(self, name: _Optional[str] = ..., positions: _Optional[_Iterable[float]] = ..., rotations: _Optional[_Iterable[float]] = ..., scales: _Optional[_Iterable[float]] = ..., output: _Optional[str] = ..., nodes: _Optional[_Iterable[int]] = ...) -> None: ...
    MODEL_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    STEPS_FIELD_NUMBER: _ClassVar[int]
    QUALITY_FIELD_NUMBER: _ClassVar[int]
    DIGEST_FIELD_NUMBER: _ClassVar[int]
    SOLVER_FIELD_NUMBER: _ClassVar[int]
    BUILD_MS_FIELD_NUMBER: _ClassVar[int]
    HANDLES_FIELD_NUMBER: _ClassVar[int]
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    PASSENGERS_FIELD_NUMBER: _ClassVar[int]
    FOLLOWED_FIELD_NUMBER: _ClassVar[int]
    model: ModelFacts
    warnings: _containers.RepeatedCompositeFieldContainer[Warning]
    steps: _containers.RepeatedCompositeFieldContainer[Report.Step]
    quality: Quality
    digest: str
    solver: SolverFacts
    build_ms: _containers.ScalarMap[str, float]
    handles: _containers.RepeatedCompositeFieldContainer[HandleFacts]
    output: _containers.RepeatedScalarFieldContainer[str]
    passengers: _containers.RepeatedCompositeFieldContainer[Report.Passenger]
    followed: Followed
    def __init__(self, model: _Optional[_Union[ModelFacts, _Mapping]] = ..., warnings: _Optional[_Iterable[_Union[Warning, _Mapping]]] = ..., steps: _Optional[_Iterable[_Union[Report.Step, _Mapping]]] = ..., quality: _Optional[_Union[Quality, _Mapping]] = ..., digest: _Optional[str] = ..., solver: _Optional[_Union[SolverFacts, _Mapping]] = ..., build_ms: _Optional[_Mapping[str, float]] = ..., handles: _Optional[_Iterable[_Union[HandleFacts, _Mapping]]] = ..., output: _Optional[_Iterable[str]] = ..., passengers: _Optional[_Iterable[_Union[Report.Passenger, _Mapping]]] = ..., followed: _Optional[_Union[Followed, _Mapping]] = ...) -> None: ...

class Quality(_message.Message):
    __slots__ = ("edge_rms", "volume_change", "area_change", "flipped_triangles", "max_stretch", "self_intersections", "faces_too_large", "open_surface", "off_rigid", "new_self_intersections")
    EDGE_RMS_FIELD_NUMBER: _ClassVar[int]
    VOLUME_CHANGE_FIELD_NUMBER: _ClassVar[int]
    AREA_CHANGE_FIELD_NUMBER: _ClassVar[int]
    FLIPPED_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
    MAX_STRETCH_FIELD_NUMBER: _ClassVar[int]
    SELF_INTERSECTIONS_FIELD_NUMBER: _ClassVar[int]
    FACES_TOO_LARGE_FIELD_NUMBER: _ClassVar[int]
    OPEN_SURFACE_FIELD_NUMBER: _ClassVar[int]
    OFF_RIGID_FIELD_NUMBER: _ClassVar[int]
    NEW_SELF_INTERSECTIONS_FIELD_NUMBER: _ClassVar[int]
    edge_rms: float
    volume_change: float
    area_change: float
    flipped_triangles: int
    max_stretch: float
    self_intersections: int
    faces_too_large: int
    open_surface: bool
    off_rigid: float
    new_self_intersections: int
    def __init__(self, edge_rms: _Optional[float] = ..., volume_change: _Optional[float] = ..., area_change: _Optional[float] = ..., flipped_triangles: _Optional[int] = ..., max_stretch: _Optional[float] = ..., self_intersections: _Optional[int] = ..., faces_too_large: _Optional[int] = ..., open_surface: bool = ..., off_rigid: _Optional[float] = ..., new_self_intersections: _Optional[int] = ...) -> None: ...

class Inspection(_message.Message):
    __slots__ = ("model", "primitives", "solver", "warnings", "components", "boundary_loops", "non_manifold_edges", "non_manifold_vertices", "seam_vertices", "closed", "box_min", "box_max", "area", "volume", "memory_estimate", "degenerate_faces", "duplicate_faces", "unreferenced_vertices", "nodes", "node_count", "hard_parts")
    MODEL_FIELD_NUMBER: _ClassVar[int]
    PRIMITIVES_FIELD_NUMBER: _ClassVar[int]
    SOLVER_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    COMPONENTS_FIELD_NUMBER: _ClassVar[int]
    BOUNDARY_LOOPS_FIELD_NUMBER: _ClassVar[int]
    NON_MANIFOLD_EDGES_FIELD_NUMBER: _ClassVar[int]
    NON_MANIFOLD_VERTICES_FIELD_NUMBER: _ClassVar[int]
    SEAM_VERTICES_FIELD_NUMBER: _ClassVar[int]
    CLOSED_FIELD_NUMBER: _ClassVar[int]
    BOX_MIN_FIELD_NUMBER: _ClassVar[int]
    BOX_MAX_FIELD_NUMBER: _ClassVar[int]
    AREA_FIELD_NUMBER: _ClassVar[int]
    VOLUME_FIELD_NUMBER: _ClassVar[int]
    MEMORY_ESTIMATE_FIELD_NUMBER: _ClassVar[int]
    DEGENERATE_FACES_FIELD_NUMBER: _ClassVar[int]
    DUPLICATE_FACES_FIELD_NUMBER: _ClassVar[int]
    UNREFERENCED_VERTICES_FIELD_NUMBER: _ClassVar[int]
    NODES_FIELD_NUMBER: _ClassVar[int]
    NODE_COUNT_FIELD_NUMBER: _ClassVar[int]
    HARD_PARTS_FIELD_NUMBER: _ClassVar[int]
    model: ModelFacts
    primitives: _containers.RepeatedCompositeFieldContainer[Primitive]
    solver: SolverFacts
    warnings: _containers.RepeatedCompositeFieldContainer[Warning]
    components: int
    boundary_loops: int
    non_manifold_edges: int
    non_manifold_vertices: int
    seam_vertices: int
    closed: bool
    box_min: _containers.RepeatedScalarFieldContainer[float]
    box_max: _containers.RepeatedScalarFieldContainer[float]
    area: float
    volume: float
    memory_estimate: int
    degenerate_faces: int
    duplicate_faces: int
    unreferenced_vertices: int
    nodes: _containers.RepeatedCompositeFieldContainer[ModelNode]
    node_count: int
    hard_parts: _containers.RepeatedScalarFieldContainer[int]
    def __init__(self, model: _Optional[_Union[ModelFacts, _Mapping]] = ..., primitives: _Optional[_Iterable[_Union[Primitive, _Mapping]]] = ..., solver: _Optional[_Union[SolverFacts, _Mapping]] = ..., warnings: _Optional[_Iterable[_Union[Warning, _Mapping]]] = ..., components: _Optional[int] = ..., boundary_loops: _Optional[int] = ..., non_manifold_edges: _Optional[int] = ..., non_manifold_vertices: _Optional[int] = ..., seam_vertices: _Optional[int] = ..., closed: bool = ..., box_min: _Optional[_Iterable[float]] = ..., box_max: _Optional[_Iterable[float]] = ..., area: _Optional[float] = ..., volume: _Optional[float] = ..., memory_estimate: _Optional[int] = ..., degenerate_faces: _Optional[int] = ..., duplicate_faces: _Optional[int] = ..., unreferenced_vertices: _Optional[int] = ..., nodes: _Optional[_Iterable[_Union[ModelNode, _Mapping]]] = ..., node_count: _Optional[int] = ..., hard_parts: _Optional[_Iterable[int]] = ...) -> None: ...

class ModelNode(_message.Message):
    __slots__ = ("index", "name", "joint", "position")
    INDEX_FIELD_NUMBER: _ClassVar[int]
    NAME_FIELD_NUMBER: _ClassVar[int]
    JOINT_FIELD_NUMBER: _ClassVar[int]
    POSITION_FIELD_NUMBER: _ClassVar[int]
    index: int
    name: str
    joint: bool
    position: _containers.RepeatedScalarFieldContainer[float]
    def __init__(self, index: _Optional[int] = ..., name: _Optional[str] = ..., joint: bool = ..., position: _Optional[_Iterable[float]] = ...) -> None: ...

class Rig(_message.Message):
    __slots__ = ("version", "joints", "bones", "reference_frame", "scale", "model", "up")
    class Rest(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        REST_UNSPECIFIED: _ClassVar[Rig.Rest]
        DIRECTION: _ClassVar[Rig.Rest]
        ORIENTATION: _ClassVar[Rig.Rest]
        PARENT: _ClassVar[Rig.Rest]
    REST_UNSPECIFIED: Rig.Rest
    DIRECTION: Rig.Rest
    ORIENTATION: Rig.Rest
    PARENT: Rig.Rest
    class Joint(_message.Message):
        __slots__ = ("at",)
        AT_FIELD_NUMBER: _ClassVar[int]
        at: _containers.RepeatedScalarFieldContainer[float]
        def __init__(self, at: _Optional[_Iterable[float]] = ...) -> None: ...
    class Bone(_message.Message):
        __slots__ = ("id", "to", "parent", "joint", "aim", "rest", "radius", "slices", "span", "joint_radius", "limit_degrees")
        ID_FIELD_NUMBER: _ClassVar[int]
        FROM_FIELD_NUMBER: _ClassVar[int]
        TO_FIELD_NUMBER: _ClassVar[int]
        PARENT_FIELD_NUMBER: _ClassVar[int]
        JOINT_FIELD_NUMBER: _ClassVar[int]
        AIM_FIELD_NUMBER: _ClassVar[int]
        REST_FIELD_NUMBER: _ClassVar[int]
        RADIUS_FIELD_NUMBER: _ClassVar[int]
        SLICES_FIELD_NUMBER: _ClassVar[int]
        SPAN_FIELD_NUMBER: _ClassVar[int]
        JOINT_RADIUS_FIELD_NUMBER: _ClassVar[int]
        LIMIT_DEGREES_FIELD_NUMBER: _ClassVar[int]
        id: str
        to: str
        parent: str
        joint: str
        aim: str
        rest: Rig.Rest
        radius: float
        slices: int
        span: _containers.RepeatedScalarFieldContainer[float]
        joint_radius: float
        limit_degrees: float
        def __init__(self, id: _Optional[str] = ..., to: _Optional[str] = ..., parent: _Optional[str] = ..., joint: _Optional[str] = ..., aim: _Optional[str] = ..., rest: _Optional[_Union[Rig.Rest, str]] = ..., radius: _Optional[float] = ..., slices: _Optional[int] = ..., span: _Optional[_Iterable[float]] = ..., joint_radius: _Optional[float] = ..., limit_degrees: _Optional[float] = ..., **kwargs) -> None: ...
    class JointsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: Rig.Joint
        def __init__(self, key: _Optional[str] = ..., value: _Optional[_Union[Rig.Joint, _Mapping]] = ...) -> None: ...
    VERSION_FIELD_NUMBER: _ClassVar[int]
    JOINTS_FIELD_NUMBER: _ClassVar[int]
    BONES_FIELD_NUMBER: _ClassVar[int]
    REFERENCE_FRAME_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    MODEL_FIELD_NUMBER: _ClassVar[int]
    UP_FIELD_NUMBER: _ClassVar[int]
    version: int
    joints: _containers.MessageMap[str, Rig.Joint]
    bones: _containers.RepeatedCompositeFieldContainer[Rig.Bone]
    reference_frame: int
    scale: float
    model: str
    up: str
    def __init__(self, version: _Optional[int] = ..., joints: _Optional[_Mapping[str, Rig.Joint]] = ..., bones: _Optional[_Iterable[_Union[Rig.Bone, _Mapping]]] = ..., reference_frame: _Optional[int] = ..., scale: _Optional[float] = ..., model: _Optional[str] = ..., up: _Optional[str] = ...) -> None: ...

class AnimationReport(_message.Message):
    __slots__ = ("frames", "totals", "handles", "warnings", "scale", "build_ms", "output", "written_error", "feet")
    class FrameReport(_message.Message):
        __slots__ = ("index", "time", "ms", "cycles", "volume_change", "flipped_triangles", "max_stretch", "edge_rms", "digest", "root_translation", "root_rotation", "self_intersections", "new_self_intersections")
        INDEX_FIELD_NUMBER: _ClassVar[int]
        TIME_FIELD_NUMBER: _ClassVar[int]
        MS_FIELD_NUMBER: _ClassVar[int]
        CYCLES_FIELD_NUMBER: _ClassVar[int]
        VOLUME_CHANGE_FIELD_NUMBER: _ClassVar[int]
        FLIPPED_TRIANGLES_FIELD_NUMBER: _ClassVar[int]
        MAX_STRETCH_FIELD_NUMBER: _ClassVar[int]
        EDGE_RMS_FIELD_NUMBER: _ClassVar[int]
        DIGEST_FIELD_NUMBER: _ClassVar[int]
        ROOT_TRANSLATION_FIELD_NUMBER: _ClassVar[int]
        ROOT_ROTATION_FIELD_NUMBER: _ClassVar[int]
        SELF_INTERSECTIONS_FIELD_NUMBER: _ClassVar[int]
        NEW_SELF_INTERSECTIONS_FIELD_NUMBER: _ClassVar[int]
        index: int
        time: float
        ms: float
        cycles: int
        volume_change: float
        flipped_triangles: int
        max_stretch: float
        edge_rms: float
        digest: str
        root_translation: _containers.RepeatedScalarFieldContainer[float]
        root_rotation: _containers.RepeatedScalarFieldContainer[float]
        self_intersections: int
        new_self_intersections: int
        def __init__(self, index: _Optional[int] = ..., time: _Optional[float] = ..., ms: _Optional[float] = ..., cycles: _Optional[int] = ..., volume_change: _Optional[float] = ..., flipped_triangles: _Optional[int] = ..., max_stretch: _Optional[float] = ..., edge_rms: _Optional[float] = ..., digest: _Optional[str] = ..., root_translation: _Optional[_Iterable[float]] = ..., root_rotation: _Optional[_Iterable[float]] = ..., self_intersections: _Optional[int] = ..., new_self_intersections: _Optional[int] = ...) -> None: ...
    class HeldNodes(_message.Message):
        __slots__ = ("name", "nodes", "widened")
        NAME_FIELD_NUMBER: _ClassVar[int]
        NODES_FIELD_NUMBER: _ClassVar[int]
        WIDENED_FIELD_NUMBER: _ClassVar[int]
        name: str
        nodes: int
        widened: float
        def __init__(self, name: _Optional[str] = ..., nodes: _Optional[int] = ..., widened: _Optional[float] = ...) -> None: ...
    class Totals(_message.Message):
        __slots__ = ("frames", "ms", "frames_per_second", "volume_change_mean", "volume_change_worst", "flipped_triangles_mean", "flipped_triangles_worst", "max_stretch", "edge_rms_mean", "new_self_intersections_mean", "new_self_intersections_worst", "crossing_frames", "worst_crossing_frame")
        FRAMES_FIELD_NUMBER: _ClassVar[int]
        MS_FIELD_NUMBER: _ClassVar[int]
        FRAMES_PER_SECOND_FIELD_NUMBER: _ClassVar[int]
        VOLUME_CHANGE_MEAN_FIELD_NUMBER: _ClassVar[int]
        VOLUME_CHANGE_WORST_FIELD_NUMBER: _ClassVar[int]
        FLIPPED_TRIANGLES_MEAN_FIELD_NUMBER: _ClassVar[int]
        FLIPPED_TRIANGLES_WORST_FIELD_NUMBER: _ClassVar[int]
        MAX_STRETCH_FIELD_NUMBER: _ClassVar[int]
        EDGE_RMS_MEAN_FIELD_NUMBER: _ClassVar[int]
        NEW_SELF_INTERSECTIONS_MEAN_FIELD_NUMBER: _ClassVar[int]
        NEW_SELF_INTERSECTIONS_WORST_FIELD_NUMBER: _ClassVar[int]
        CROSSING_FRAMES_FIELD_NUMBER: _ClassVar[int]
        WORST_CROSSING_FRAME_FIELD_NUMBER: _ClassVar[int]
        frames: int
        ms: float
        frames_per_second: float
        volume_change_mean: float
        volume_change_worst: float
        flipped_triangles_mean: float
        flipped_triangles_worst: int
        max_stretch: float
        edge_rms_mean: float
        new_self_intersections_mean: float
        new_self_intersections_worst: int
        crossing_frames: int
        worst_crossing_frame: int
        def __init__(self, frames: _Optional[int] = ..., ms: _Optional[float] = ..., frames_per_second: _Optional[float] = ..., volume_change_mean: _Optional[float] = ..., volume_change_worst: _Optional[float] = ..., flipped_triangles_mean: _Optional[float] = ..., flipped_triangles_worst: _Optional[int] = ..., max_stretch: _Optional[float] = ..., edge_rms_mean: _Optional[float] = ..., new_self_intersections_mean: _Optional[float] = ..., new_self_intersections_worst: _Optional[int] = ..., crossing_frames: _Optional[int] = ..., worst_crossing_frame: _Optional[int] = ...) -> None: ...
    class WrittenError(_message.Message):
        __slots__ = ("rms_percent", "max_percent", "parts")
        RMS_PERCENT_FIELD_NUMBER: _ClassVar[int]
        MAX_PERCENT_FIELD_NUMBER: _ClassVar[int]
        PARTS_FIELD_NUMBER: _ClassVar[int]
        rms_percent: float
        max_percent: float
        parts: int
        def __init__(self, rms_percent: _Optional[float] = ..., max_percent: _Optional[float] = ..., parts: _Optional[int] = ...) -> None: ...
    class Foot(_message.Message):
        __slots__ = ("bone", "contacts", "planted_frames", "drift_before", "drift_after")
        class Contact(_message.Message):
            __slots__ = ("to",)
            FROM_FIELD_NUMBER: _ClassVar[int]
            TO_FIELD_NUMBER: _ClassVar[int]
            to: float
            def __init__(self, to: _Optional[float] = ..., **kwargs) -> None: ...
        BONE_FIELD_NUMBER: _ClassVar[int]
        CONTACTS_FIELD_NUMBER: _ClassVar[int]
        PLANTED_FRAMES_FIELD_NUMBER: _ClassVar[int]
        DRIFT_BEFORE_FIELD_NUMBER: _ClassVar[int]
        DRIFT_AFTER_FIELD_NUMBER: _ClassVar[int]
        bone: str
        contacts: _containers.RepeatedCompositeFieldContainer[AnimationReport.Foot.Contact]
        planted_frames: int
        drift_before: float
        drift_after: float
        def __init__(self, bone: _Optional[str] = ..., contacts: _Optional[_Iterable[_Union[AnimationReport.Foot.Contact, _Mapping]]] = ..., planted_frames: _Optional[int] = ..., drift_before: _Optional[float] = ..., drift_after: _Optional[float] = ...) -> None: ...
    class BuildMsEntry(_message.Message):
        __slots__ = ("key", "value")
        KEY_FIELD_NUMBER: _ClassVar[int]
        VALUE_FIELD_NUMBER: _ClassVar[int]
        key: str
        value: float
        def __init__(self, key: _Optional[str] = ..., value: _Optional[float] = ...) -> None: ...
    FRAMES_FIELD_NUMBER: _ClassVar[int]
    TOTALS_FIELD_NUMBER: _ClassVar[int]
    HANDLES_FIELD_NUMBER: _ClassVar[int]
    WARNINGS_FIELD_NUMBER: _ClassVar[int]
    SCALE_FIELD_NUMBER: _ClassVar[int]
    BUILD_MS_FIELD_NUMBER: _ClassVar[int]
    OUTPUT_FIELD_NUMBER: _ClassVar[int]
    WRITTEN_ERROR_FIELD_NUMBER: _ClassVar[int]
    FEET_FIELD_NUMBER: _ClassVar[int]
    frames: _containers.RepeatedCompositeFieldContainer[AnimationReport.FrameReport]
    totals: AnimationReport.Totals
    handles: _containers.RepeatedCompositeFieldContainer[AnimationReport.HeldNodes]
    warnings: _containers.RepeatedScalarFieldContainer[str]
    scale: float
    build_ms: _containers.ScalarMap[str, float]
    output: _containers.RepeatedScalarFieldContainer[str]
    written_error: AnimationReport.WrittenError
    feet: _containers.RepeatedCompositeFieldContainer[AnimationReport.Foot]
    def __init__(self, frames: _Optional[_Iterable[_Union[AnimationReport.FrameReport, _Mapping]]] = ..., totals: _Optional[_Union[AnimationReport.Totals, _Mapping]] = ..., handles: _Optional[_Iterable[_Union[AnimationReport.HeldNodes, _Mapping]]] = ..., warnings: _Optional[_Iterable[str]] = ..., scale: _Optional[float] = ..., build_ms: _Optional[_Mapping[str, float]] = ..., output: _Optional[_Iterable[str]] = ..., written_error: _Optional[_Union[AnimationReport.WrittenError, _Mapping]] = ..., feet: _Optional[_Iterable[_Union[AnimationReport.Foot, _Mapping]]] = ...) -> None: ...
