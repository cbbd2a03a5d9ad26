"""Poses: where handles are.

A pose scales, then turns about the pivot, then moves. Wherever this package takes a pose it takes a :class:`Pose`, a
dict of its fields, or a 4 by 4 matrix; wherever it takes the poses of several handles it takes a mapping from handle
ids. A handle with targets takes :class:`Targets` instead, one with a guide :class:`pliant.GuidePose`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias, Union

import numpy as np
import numpy.typing as npt
from typing_extensions import TypedDict

from .guides import GuidePose
from .values import about, array, float_points, mapping, seen, snake_case, text
from .v1 import pliant_pb2 as pb

Vector: TypeAlias = Union[Sequence[float], "npt.NDArray[Any]"]


class PoseFields(TypedDict, total=False):
    """The fields of a pose, all optional."""

    translation: Vector
    rotation: Vector
    rotation_vector: Vector
    rotation_degrees: Vector
    scale: float | Vector
    pivot: Vector
    free_rotation: bool


@dataclass(frozen=True)
class Pose:
    """Where a handle is; absent fields leave it as in the rest pose."""

    #: x, y, z in model units.
    translation: Vector | None = None
    #: Unit quaternion x, y, z, w; of ``rotation``, ``rotation_vector`` and ``rotation_degrees`` a pose has one at most.
    rotation: Vector | None = None
    #: Axis times angle in radians; any number of turns counts.
    rotation_vector: Vector | None = None
    #: One number or three, each above 0.
    scale: float | Vector | None = None
    #: x, y, z; default: the joint between the region and what is free (``HandleFacts.pivot``).
    pivot: Vector | None = None
    #: The rotation is found: the region turns about the pivot until what it hangs on is bent least.
    free_rotation: bool = False
    #: Axis times angle in degrees: ``(0, 45, 0)`` turns about y. It is a ``rotation_vector`` in another unit, not three angles one after
    #: the other.
    rotation_degrees: Vector | None = None

    @staticmethod
    def from_matrix(model_from_rest: npt.ArrayLike) -> Pose:
        """The pose that a 4 by 4 matrix (column vectors, translation in the last column) describes.

        Scales within 1e-6 of 1 are 1, as the products of 32-bit matrices of mere turns are: a handle that is scaled, however little,
        has the server not keep the volume. Raises ValueError when the matrix shears, mirrors or projects: a pose cannot do that.
        """
        matrix = array("a pose's matrix", model_from_rest).astype(np.float64)
        if matrix.shape != (4, 4):
            raise ValueError(f"a pose's matrix has shape {matrix.shape}, (4, 4) is allowed")
        if not np.allclose(matrix[3], [0, 0, 0, 1]):
            raise ValueError(f"the matrix's last row is {matrix[3].tolist()}, only [0, 0, 0, 1] is allowed")
        linear = matrix[:3, :3]
        scale = np.linalg.norm(linear, axis=0)
        if not np.all(scale > 0):
            raise ValueError("the matrix flattens an axis; scales above 0 are allowed")
        turn = linear / scale
        if not np.allclose(turn.T @ turn, np.eye(3), atol=1e-6):
            raise ValueError("the matrix shears; a pose scales along x, y and z, then turns, then moves")
        if np.linalg.det(turn) < 0:
            raise ValueError("the matrix mirrors; scales above 0 are allowed")
        scale = np.where(np.abs(scale - 1) <= 1e-6, 1.0, scale)
        return Pose(translation=matrix[:3, 3], rotation=quaternion_of(turn), scale=scale, pivot=(0.0, 0.0, 0.0))


@dataclass(frozen=True)
class Targets:
    """Where the vertices of a handle with targets are wanted; it stands where a pose does. What is None stays as before."""

    #: n by 3, in model space, in the order of the model's vertices; 64-bit numbers far from the origin.
    positions: npt.ArrayLike | None = None
    #: n factors of the stiffness, 0 or more; one number is for all.
    weights: npt.ArrayLike | None = None
    #: The first vertex of the handle that these are of; None: they are of all.
    first: int | None = None
    #: n by 3, across the planes that vertices of a ``tangential`` handle are wanted in; 0, 0, 0 where one is wanted at its position.
    normals: npt.ArrayLike | None = None

    def to_message(self, origin: Sequence[float] = ()) -> pb.HandlePose:
        """The targets as the schema carries them, for a session with such an origin."""
        message = pb.HandlePose()
        message.targets.SetInParent()
        count = None
        if self.positions is not None:
            message.targets.positions = float_points("positions", self.positions, origin)
            count = len(message.targets.positions) // 12
        if self.weights is not None:
            weights = array("weights", self.weights).astype("<f4")
            if weights.ndim == 0:
                if self.first is not None and count is None:
                    raise ValueError("weights: one number beside first, which is allowed with positions or with a list of weights")
                # Of all vertices of a handle one number is for each.
                weights = np.full(1 if self.first is None or count is None else count, weights, "<f4")
                count = None
            if weights.ndim != 1 or count not in (None, len(weights)):
                allowed = "(n,)" if count is None else f"({count},)"
                raise ValueError(f"weights: an array of shape {weights.shape}, {allowed} is allowed")
            message.targets.weights = weights.tobytes()
        if self.normals is not None:
            message.targets.normals = float_points("normals", self.normals, ())
            if count not in (None, len(message.targets.normals) // 12):
                raise ValueError(f"normals: {len(message.targets.normals) // 12} of them, {count} are allowed, as there are positions")
        if self.first is not None:
            message.targets.first = self.first
        return message


PoseLike: TypeAlias = Union[Pose, Targets, GuidePose, PoseFields, "npt.NDArray[Any]", None]
Poses: TypeAlias = Mapping[str, PoseLike]


def matrix_of(rotation: Sequence[float] = (), rotation_vector: Sequence[float] = ()) -> npt.NDArray[np.float64]:
    """The rotation matrix of a unit quaternion x, y, z, w, or else of an axis times an angle in radians; without both it turns nothing."""
    if len(rotation) == 0:
        angle = float(np.linalg.norm(rotation_vector)) if len(rotation_vector) else 0.0
        axis = np.array(rotation_vector) / angle if angle > 0 else np.zeros(3)
        rotation = [*(axis * np.sin(angle / 2)), np.cos(angle / 2)]
    x, y, z, w = np.array(rotation) / np.linalg.norm(rotation)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return np.array(rows)


def quaternion_of(turn: npt.NDArray[np.float64]) -> list[float]:
    """x, y, z, w of a rotation matrix, by way of its largest component."""
    xx, yy, zz = (float(turn[k, k]) for k in range(3))
    squares = [1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz, 1 + xx + yy + zz]
    largest = int(np.argmax(squares))
    twice = float(np.sqrt(squares[largest])) * 2
    off = {k: float(turn[(k + 2) % 3, (k + 1) % 3] - turn[(k + 1) % 3, (k + 2) % 3]) for k in range(3)}
    if largest == 3:
        return [off[0] / twice, off[1] / twice, off[2] / twice, twice / 4]
    found = [0.0, 0.0, 0.0, off[largest] / twice]
    for k in range(3):
        sum_ = float(turn[k, largest] + turn[largest, k])
        found[k] = twice / 4 if k == largest else sum_ / twice
    return found


def numbers(what: str, value: Any, allowed: tuple[int, ...]) -> list[float]:
    """A vector as the schema carries it; its values are the server's to judge."""
    found = array(what, value).ravel()
    if found.size not in allowed:
        sizes = " or ".join(map(str, allowed))
        raise ValueError(f"{what}: {found.size} numbers, {sizes} are allowed")
    return [float(number) for number in found]


def to_message(pose: PoseLike, origin: Sequence[float] = ()) -> pb.HandlePose:
    """A pose as the schema carries it, for a session with such an origin; None is rest."""
    if pose is None:
        return pb.HandlePose()
    if isinstance(pose, Targets):
        return pose.to_message(origin)
    if isinstance(pose, GuidePose):
        return pose.to_message()
    if isinstance(pose, np.ndarray):
        pose = Pose.from_matrix(pose)
    if not isinstance(pose, Pose):
        fields = mapping("pose", pose, "a pliant.Pose, a dict of its fields, or an array of shape (4, 4)")
        fields = {snake_case(name): value for name, value in fields.items()}
        for name in fields:
            if name not in _FIELDS:
                raise TypeError(f"{seen(name)}: no such field of a pose; allowed are {', '.join(_FIELDS)}")
        pose = Pose(**fields)
    message = pb.HandlePose()
    if not isinstance(pose.free_rotation, bool):
        raise TypeError(f"free_rotation: {seen(pose.free_rotation)}, True or False is allowed")
    message.free_rotation = pose.free_rotation
    for name, allowed in _LENGTHS.items():
        value = getattr(pose, name)
        if name == "rotation" and value is not None and array(name, value).size == 3:
            hint = "an axis times an angle is rotation_degrees, such as (0, 45, 0), or rotation_vector in radians"
            raise ValueError(f"rotation: 3 numbers, a quaternion of 4, (x, y, z, w), is allowed; {hint}")
        if value is not None:
            getattr(message, name).extend(numbers(name, value, allowed))
    if pose.rotation_degrees is not None:
        if pose.rotation is not None or pose.rotation_vector is not None:
            raise ValueError("rotation_degrees: a pose has one rotation; leave out rotation and rotation_vector")
        message.rotation_vector.extend(np.radians(numbers("rotation_degrees", pose.rotation_degrees, (3,))).tolist())
    return message


_LENGTHS = {"translation": (3,), "rotation": (4,), "rotation_vector": (3,), "scale": (1, 3), "pivot": (3,)}
_FIELDS = (*_LENGTHS, "rotation_degrees", "free_rotation")


def entries(poses: Poses | Mapping[str, pb.HandlePose], origin: Sequence[float] = ()) -> dict[str, pb.HandlePose]:
    """The poses of several handles as messages."""
    found = {}
    for handle, pose in mapping("poses", poses, "a dict from handle ids to poses").items():
        text("poses", handle, "a handle's id, which is text,")
        with about(f"pose of {handle!r}"):
            found[handle] = pose if isinstance(pose, pb.HandlePose) else to_message(pose, origin)
    return found


def lay_on(poses: dict[str, pb.HandlePose], newer: Mapping[str, pb.HandlePose]) -> None:
    """Puts newer poses in their places; what their targets leave out stays."""
    for handle, pose in newer.items():
        before = poses.get(handle)
        if before is None or not pose.HasField("targets") or not before.HasField("targets"):
            poses[handle] = pose
            continue
        whole = pb.HandlePose()
        whole.CopyFrom(pose)
        if pose.targets.HasField("first") and not _joined(before.targets, pose.targets, whole.targets):
            poses[handle] = whole
            continue
        is_part = pose.targets.HasField("first") and not before.targets.HasField("first")
        for name, size in LISTS:
            old, new = getattr(before.targets, name), getattr(pose.targets, name)
            at = size * pose.targets.first
            if is_part and name == "weights" and len(old) <= 4:
                one = old or np.ones(1, "<f4").tobytes()
                old = one * (len(before.targets.positions) // 12)
            if not new:
                setattr(whole.targets, name, old)
            elif is_part and old:
                setattr(whole.targets, name, old[:at] + new + old[at + len(new) :])
        if is_part:
            whole.targets.ClearField("first")
        poses[handle] = whole


def _joined(before: pb.VertexTargets, part: pb.VertexTargets, into: pb.VertexTargets) -> bool:
    """Joins a part to the part before it; whether there is more to do, because that is a whole set."""
    if not before.HasField("first") and before.positions:
        return True
    skipped = part.first - before.first
    for name, size in LISTS:
        old, new = getattr(before, name), getattr(part, name)
        if not old and not new:
            continue
        if bool(old) != bool(new) or not 0 <= size * skipped <= len(old):
            raise ValueError("targets sent in parts have to follow each other, with the same lists; send the whole set")
        setattr(into, name, old[: size * skipped] + new + old[size * skipped + len(new) :])
    into.first = before.first
    return False


def pose_message(by_handle: Mapping[str, pb.HandlePose], seq: int = 0) -> pb.Pose:
    """One pose of a session."""
    listed = [pb.Pose.Entry(id=handle, pose=pose) for handle, pose in by_handle.items()]
    return pb.Pose(seq=seq, handles=listed)


#: The lists of targets, and the bytes of a vertex in each.
LISTS = (("positions", 12), ("weights", 4), ("normals", 12))
#: Vertices whose targets travel in one message at most: 1 MiB of places.
PART = (1 << 20) // 12


def commit_in_parts(request: pb.SolveRequest, key: str) -> list[pb.DeformRequest]:
    """A pose to commit as messages of a stream, for targets that are larger than a message may be."""
    messages = [pb.DeformRequest(session_id=request.session_id, options=request.options)]
    last = pb.Pose(commit=True, idempotency_key=key)

    def part(handle: str, targets: pb.VertexTargets) -> None:
        entry = pb.Pose.Entry(id=handle, pose=pb.HandlePose(targets=targets))
        messages.append(pb.DeformRequest(pose=pb.Pose(seq=len(messages), handles=[entry], more=True)))

    for entry in request.pose.handles:
        targets = entry.pose.targets
        positions, weights, normals = targets.positions, targets.weights, targets.normals
        count = max(len(getattr(targets, name)) // size for name, size in LISTS)
        if count <= PART:
            last.handles.append(entry)
            continue
        if len(weights) == 4:
            part(entry.id, pb.VertexTargets(weights=weights))
            weights = b""
        for at in range(0, count, PART):
            end = at + PART
            places, factors, across = positions[12 * at : 12 * end], weights[4 * at : 4 * end], normals[12 * at : 12 * end]
            part(entry.id, pb.VertexTargets(positions=places, weights=factors, normals=across, first=targets.first + at))
    last.seq = len(messages)
    return [*messages, pb.DeformRequest(pose=last)]
