"""Animations: a clip drives the model, and its frames come in order.

What the synchronous and the asyncio half have in common: the order in the schema's words, and frames put together.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Literal, Union

import numpy as np
import numpy.typing as npt
from google.protobuf import json_format
from typing_extensions import TypedDict

from .frames import Assembler, Frame, Positions
from .options import SolveFields, options
from .regions import enum
from .values import about, mapping, put, seen
from .v1 import pliant_pb2 as pb

#: A rig: a JSON file, what such a file holds, or the schema's message.
Rig = Union[str, Path, Mapping[str, Any], pb.Rig]

#: Bytes of a clip that travel in one message.
_CHUNK = 1 << 20


class AnimateFields(TypedDict, total=False):
    """How a clip drives a model, all optional; the server's defaults hold for what is absent."""

    #: Frames a second; absent, the clip's own.
    fps: float
    #: The first frame that is wanted, from 0.
    first: int
    #: How many are wanted; absent, all that follow.
    count: int
    #: Whether the first frame, often a T-pose, is left out; "auto" where it is far from the second.
    skip_first: Union[bool, Literal["auto"]]
    #: Model units for one unit of the clip; absent, by the lengths of the legs, without legs by those of all bones.
    scale: float
    #: How often rotations are fitted in a frame, 0 to 32; absent, carried on from frame to frame.
    refine: int
    #: Relative residual to reach.
    tolerance: float
    #: Where the motion of the root bone goes: beside the positions, into them, or nowhere.
    root: Literal["node", "baked", "none"]
    #: Frames also carry normals.
    normals: bool
    #: Frames also carry tangents.
    tangents: bool
    #: Only vertices that moved by more than this fraction of the diagonal travel. Frames are whole all the same.
    changed_only: float
    #: How numbers travel: as they are, as 16 bits between the corners of the frame's box, these compressed, or of these only what
    #: differs from the frame before (not with ``changed_only``).
    encoding: Literal["f32", "u16", "meshopt", "delta"]
    #: Unacknowledged frames in flight.
    window: int
    #: Whether feet stay where they stand; absent, of a BVH file whose legs drive the rig.
    plant_feet: bool
    #: What frames do about surfaces that the clip pushes through each other: "avoid" moves them apart, and counts pairs that still cross.
    contact: Literal["ignore", "avoid"]


_PLAIN = ("fps", "first", "count", "scale", "refine", "tolerance", "window", "plant_feet")
_OUTPUT = ("normals", "tangents", "changed_only", "encoding")


@dataclass(frozen=True, eq=False)
class AnimatedFrame(Frame):
    """A frame of an animation."""

    #: Its number in the animation, from 0.
    index: int
    #: Frames of the whole animation, wanted or not.
    count: int
    #: When it is, in seconds of the clip.
    time: float
    #: Where the root bone has carried the model, x, y, z, unless that is in the positions.
    root_translation: npt.NDArray[np.float64]
    #: How it has turned it, a unit quaternion x, y, z, w.
    root_rotation: npt.NDArray[np.float64]
    #: Digest of the positions as the root bone sees them, the same as in ``pliant animate --json``.
    digest: str

    def placed(self) -> Positions:
        """The positions where the root bone has carried them, (render vertices, 3), of the same type."""
        x, y, z, w = self.root_rotation
        axis = np.array([x, y, z])
        points = self.positions.astype(np.float64)
        across = 2 * np.cross(axis, points)
        moved = points + w * across + np.cross(axis, across) + self.root_translation
        placed: Positions = moved.astype(self.positions.dtype)
        return placed


class Playing:
    """The books of one animation: what is asked for, what has come, where it continues after a lost connection."""

    def __init__(self, session: str, vertices: int, order: pb.AnimateOptions, clip: bytes | None) -> None:
        self._order = pb.AnimateOptions()
        self._order.CopyFrom(order)
        self._order.session_id = session
        self._clip = clip
        self._next: int | None = None
        self._assembler = Assembler(vertices, changed_only=order.output.HasField("changed_only"))
        #: What is under way before the first frame, and how much of it is done.
        self.stage: tuple[str, float] = ("", 0.0)
        #: Totals, warnings and what the handles of the rig hold, once all frames have come.
        self.report: pb.AnimationReport | None = None

    def opening(self, message_bytes: int) -> Iterator[pb.AnimateRequest]:
        """The requests that begin it, at the frame after the last one that came."""
        order = pb.AnimateOptions()
        order.CopyFrom(self._order)
        self._assembler.restart()
        if self._next is not None:
            if order.count:
                order.count = order.first + order.count - self._next
            order.first = self._next
        clip = self._clip
        if clip is None or len(clip) + _CHUNK // 8 <= min(message_bytes, _CHUNK):
            if clip is not None:
                order.bvh = clip
            yield pb.AnimateRequest(options=order)
            return
        order.bvh_size = len(clip)
        yield pb.AnimateRequest(options=order)
        step = min(_CHUNK, message_bytes // 2)
        for start in range(0, len(clip), step):
            yield pb.AnimateRequest(chunk=clip[start : start + step])

    def take(self, part: pb.Frame) -> AnimatedFrame | None:
        """Takes the next message; answers the frame when it was the last part of one."""
        told = part.animated
        if part.parts == 0:
            if told.HasField("report"):
                self.report = told.report
            else:
                self.stage = (told.stage, told.fraction)
            return None
        frame = self._assembler.take(part)
        if frame is None:
            return None
        self._next = told.index + 1
        return AnimatedFrame(
            **{field.name: getattr(frame, field.name) for field in fields(Frame)},
            index=told.index,
            count=told.count,
            time=told.time,
            root_translation=np.array(told.root_translation),
            root_rotation=np.array(told.root_rotation),
            digest=told.digest,
        )

    @property
    def under_way(self) -> str:
        """What is under way: a stage before the first frame, then frames."""
        return "frames" if self._next is not None else self.stage[0] or "frames"

    def complete(self) -> bool:
        """Whether all frames have come, and only the report may be missing."""
        return self.report is not None

    @property
    def total(self) -> int:
        """How many frames are wanted, where that is known."""
        return self._order.count


def order(clip: str | int | None, rig: Rig | None, how: AnimateFields) -> pb.AnimateOptions:
    """The order as the schema carries it."""
    message = pb.AnimateOptions()
    if clip is not None:
        put(message, "clip", str(clip) if isinstance(clip, int) and not isinstance(clip, bool) else clip)
    if rig is not None:
        message.rig.CopyFrom(_rig(rig))
    output: SolveFields = {}
    for name, value in how.items():
        if name in _PLAIN:
            put(message, name, value)
        elif name in _OUTPUT:
            output[name] = value  # type: ignore[literal-required]
        elif name == "root":
            message.root = enum(name, pb.AnimateOptions.Root, value)
        elif name == "contact":
            message.contact = enum(name, pb.Options.Contact, value)
        elif name == "skip_first":
            word = {True: "yes", False: "no"}.get(value, value) if isinstance(value, bool) else value
            message.skip_first = enum(name, pb.AnimateOptions.SkipFirst, word)
        else:
            allowed = ", ".join(AnimateFields.__annotations__)
            raise TypeError(f"{name}: no such option; allowed are {allowed}")
    if output:
        message.output.CopyFrom(options(output).output)
    return message


def recording(bvh: str | Path | bytes | None) -> bytes | None:
    """The bytes of a BVH file."""
    if bvh is None or isinstance(bvh, bytes):
        return bvh
    if not isinstance(bvh, (str, os.PathLike)):
        raise TypeError(f"bvh: {seen(bvh)}, a path or the bytes of a BVH file are allowed")
    return Path(bvh).read_bytes()


def _rig(rig: Rig) -> pb.Rig:
    if isinstance(rig, pb.Rig):
        return rig
    if isinstance(rig, (str, Path)):
        with about(str(rig)):
            rig = json.loads(Path(rig).read_text())
    fields = dict(mapping("rig", rig, "a path, a dict or a pb.Rig"))
    # The short forms of files written by hand.
    joints = fields.get("joints")
    if isinstance(joints, Mapping):
        places = {name: at if isinstance(at, Mapping) else {"at": list(at)} for name, at in joints.items()}
        fields["joints"] = places
    reference = fields.get("reference")
    if isinstance(reference, Mapping) and ("frame" in reference) != ("rest" in reference):
        del fields["reference"]
        if "frame" in reference:
            fields["referenceFrame"] = reference["frame"]
    with about("rig"):
        try:
            return json_format.ParseDict(fields, pb.Rig())
        except json_format.ParseError as wrong:
            raise ValueError(str(wrong)) from None
