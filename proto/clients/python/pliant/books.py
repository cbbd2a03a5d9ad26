"""The client's books of one session and of one stream: what was said, and what is to be said next.

Nothing here talks to a server, so that the synchronous and the asyncio session keep the same books.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from . import errors
from .frames import Assembler, Frame
from .poses import Poses, entries, lay_on, pose_message
from .v1 import pliant_pb2 as pb


@dataclass(frozen=True)
class Commit:
    """A recorded change of a session."""

    #: The revision that it made.
    revision: int
    #: "create", "handles", "pose" or "edit".
    kind: str
    #: Digest of the positions after it, as ``pliant deform --json`` prints it.
    digest: str
    #: Whether the session is in the state that this commit left.
    current: bool


def commits(response: pb.HistoryResponse) -> list[Commit]:
    """A session's commits, oldest first; those after the current one can be redone."""
    return [Commit(c.revision, c.kind, c.digest, c.revision == response.current) for c in response.commits]


@dataclass(frozen=True)
class _State:
    """What a commit left in force."""

    handles: dict[str, pb.Handle] = field(default_factory=dict)
    poses: dict[str, pb.HandlePose] = field(default_factory=dict)
    symmetry_plane: pb.Plane | None = None
    region_of_interest: pb.Region | None = None
    stiff: pb.Stiff | None = None


class Books:
    """Handles and poses of one session as this client knows them, by commit."""

    def __init__(self, info: pb.Session) -> None:
        self.info = info
        #: Whether close() deleted the session.
        self.closed = False
        self._now = _State()
        # What the server has.
        self._there = self._now
        self._unsent = False
        # Handles that somebody else set, or that an edit carried over: their regions are known to the server alone.
        self._foreign = len(info.handles) > 0
        self._states: dict[int, _State] = {} if self._foreign else {info.revision: self._now}

    @property
    def handle_ids(self) -> list[str]:
        """The handles that this client has set or will set."""
        return list(self._now.handles)

    @property
    def shown_ids(self) -> list[str]:
        """The handles in force: those of this client, or those that only the server knows, as after an edit."""
        return self.handle_ids or ([handle.id for handle in self.info.handles] if self._foreign else [])

    def put(self, handle: pb.Handle) -> None:
        """Adds a handle, or replaces the one of the same id in its place."""
        self._own()
        poses = {id: pose for id, pose in self._now.poses.items() if id != handle.id}
        if handle.HasField("pose"):
            poses[handle.id] = handle.pose
        self._change(handles={**self._now.handles, handle.id: handle}, poses=poses)

    def remove(self, id: str) -> None:
        """Takes a handle away."""
        self._own()
        if id not in self._now.handles:
            raise errors.NotFound(f"no handle {id!r}; there are {', '.join(self._now.handles) or 'none'}")
        handles, poses = dict(self._now.handles), dict(self._now.poses)
        handles.pop(id)
        poses.pop(id, None)
        self._change(handles=handles, poses=poses)

    def clear(self) -> None:
        """Forgets all handles, also those that somebody else set."""
        self._foreign = False
        self._now = _State()
        self._unsent = True

    def limit(self, **parts: Any) -> None:
        """Sets the symmetry plane, the region of interest or what is stiff."""
        self._own()
        self._change(**parts)

    def _own(self) -> None:
        if self._foreign:
            raise errors.FailedPrecondition(
                "the session holds handles whose regions this client does not know, and setting handles replaces all: "
                "call clear_handles() first, then name every handle"
            )

    def _change(self, **parts: Any) -> None:
        self._now = _State(**{**self._now.__dict__, **parts})
        self._unsent = True

    def to_send(self) -> pb.SetHandlesRequest | None:
        """All handles with their poses, where the server does not have them yet."""
        if not self._unsent:
            return None
        request = pb.SetHandlesRequest(session_id=self.info.id)
        for id, handle in self._now.handles.items():
            sent = request.handles.add()
            sent.CopyFrom(handle)
            sent.ClearField("pose")
            if id in self._now.poses:
                sent.pose.CopyFrom(self._now.poses[id])
        if self._now.symmetry_plane is not None:
            request.symmetry_plane.CopyFrom(self._now.symmetry_plane)
        if self._now.region_of_interest is not None:
            request.region_of_interest.CopyFrom(self._now.region_of_interest)
        if self._now.stiff is not None:
            request.stiff.CopyFrom(self._now.stiff)
        return request

    def sent(self, info: pb.Session) -> None:
        """The server has the handles."""
        self._unsent = False
        self.info = info
        self._there = self._now
        self._states[info.revision] = self._now

    def refused(self, error: errors.InvalidArgument) -> errors.InvalidArgument:
        """The server did not take the handles. Takes back what was to blame, so that calls that follow do not meet it again, and
        answers the error with the handle's name: where a handle was to blame, that one is as it was before; else everything is.
        """
        found = re.match(r"handles\[(\d+)\]", error.field or "")
        ids = list(self._now.handles)
        if found is None or int(found[1]) >= len(ids):
            self._now = self._there
            self._unsent = False
            return error
        blamed = ids[int(found[1])]
        handles, poses = dict(self._now.handles), dict(self._now.poses)
        poses.pop(blamed, None)
        if blamed in self._there.handles:
            handles[blamed] = self._there.handles[blamed]
            if blamed in self._there.poses:
                poses[blamed] = self._there.poses[blamed]
        else:
            handles.pop(blamed)
        self._now = _State(**{**self._now.__dict__, "handles": handles, "poses": poses})
        self._unsent = self._now != self._there
        text = f"handle {blamed!r}: {error.message}"
        return errors.InvalidArgument(text, code=error.code, field=error.field, retry_after=error.retry_after)

    def solve_request(self, poses: Poses | Mapping[str, pb.HandlePose] | None, options: pb.Options) -> pb.SolveRequest:
        """One pose to solve and commit."""
        return pb.SolveRequest(session_id=self.info.id, pose=pose_message(as_entries(poses, self.info.origin)), options=options)

    def committed(self, frame: Frame, request: pb.SolveRequest) -> None:
        """A pose is recorded."""
        moved = {entry.id: entry.pose for entry in request.pose.handles}
        self._now = self._there = _State(**{**self._now.__dict__, "poses": {**self._now.poses, **moved}})
        self._states[frame.revision] = self._now
        self.info.revision = frame.revision

    def travelled(self, info: pb.Session, current: int) -> None:
        """The session went back or forth to the state that commit `current` left."""
        self.info = info
        self._unsent = False
        known = self._states.get(current)
        self._foreign = known is None and len(info.handles) > 0
        self._now = self._there = known or _State()

    def edited(self, info: pb.Session) -> None:
        """The topology changed: handles are held by vertices that only the server knows."""
        self.info = info
        self._foreign = len(info.handles) > 0
        self._now = self._there = _State()


def as_entries(
    poses: Poses | Mapping[str, pb.HandlePose] | None, origin: Sequence[float] = ()
) -> dict[str, pb.HandlePose]:
    """Poses as messages, whichever form they have, for a session with such an origin."""
    return {} if poses is None else entries(poses, origin)


class Traffic:
    """What goes over one stream, and what has to be sent again when it is opened again.

    Poses on a stream are never commits: those go by Solve with an idempotency key, so that a lost connection cannot
    commit anything twice. Opening the stream again therefore repeats the newest unanswered pose and nothing else.
    """

    def __init__(self, session: pb.Session, vertices: int, options: pb.Options) -> None:
        self._session_id = session.id
        self._origin = tuple(session.origin)
        self._options = options
        self._assembler = Assembler(vertices, changed_only=options.output.HasField("changed_only"))
        self._repeat = False
        self._opened = False
        # Frames of this connection, and connections in a row that brought what cannot be read.
        self._frames = 0
        self._unreadable = 0
        self._settled: dict[str, pb.HandlePose] = {}
        # Poses that are neither solved nor refused yet, by number. A refused one moves nothing.
        self._pending: dict[int, dict[str, pb.HandlePose]] = {}
        #: The newest pose.
        self.seq = 0
        #: The newest pose that has its final frame, or was refused.
        self.answered = 0

    @property
    def poses(self) -> dict[str, pb.HandlePose]:
        """Where the stream has moved handles to."""
        merged = dict(self._settled)
        for named in self._pending.values():
            lay_on(merged, named)
        return merged

    def _settle(self, seq: int) -> None:
        for number in [number for number in self._pending if number <= seq]:
            lay_on(self._settled, self._pending.pop(number))

    def opening(self) -> list[pb.DeformRequest]:
        """The first messages of a connection."""
        self._assembler.restart()
        self._frames = 0
        first = [pb.DeformRequest(session_id=self._session_id, options=self._options)]
        if self._opened:
            # Its answer tells that the stream is there again, also where no pose waits for one.
            first.append(pb.DeformRequest(ping=pb.Ping()))
        self._opened = True
        if self.seq > self.answered:
            return [*first, pb.DeformRequest(pose=pose_message(self.poses, self.seq))]
        self._repeat = bool(self.poses)
        return first

    def pose(self, poses: Poses, more: bool = False) -> pb.DeformRequest:
        """The next pose, or a part of it."""
        named = as_entries(poses, self._origin)
        self.seq += 1
        self._pending[self.seq] = named
        said, self._repeat = (self.poses if self._repeat else named), False
        message = pose_message(said, self.seq)
        message.more = more
        return pb.DeformRequest(pose=message)

    def absorb(self, poses: Poses | None) -> dict[str, pb.HandlePose]:
        """Where handles are with `poses`, which travel another way. The next pose on the stream repeats them."""
        self._settle(self.seq)
        lay_on(self._settled, as_entries(poses, self._origin))
        self._repeat = True
        return self.poses

    def take(self, response: pb.DeformResponse) -> Frame | errors.PliantError | None:
        """A whole frame, or why a pose was refused; an error without a number ends the connection."""
        kind = response.WhichOneof("message")
        if kind == "error":
            error = response.error
            self._pending.pop(error.seq, None)
            self.answered = max(self.answered, error.seq)
            return errors.of_stream(error.code, error.message, error.seq)
        if kind == "notice" and response.notice.code == "going-away":
            # What was not answered is asked of the server that comes after this one.
            self._session_id = response.notice.resume_token or self._session_id
            return errors.Unavailable(response.notice.message)
        if kind != "frame":
            return None
        frame = self._read(response.frame)
        if frame is not None and frame.final:
            self._settle(frame.seq)
            self.answered = max(self.answered, frame.seq)
        return frame

    def _read(self, part: pb.Frame) -> Frame | None:
        try:
            frame = self._assembler.take(part)
        except errors.Internal as broken:
            # What another connection brings as well will not be read by a third.
            self._unreadable += 1
            error = errors.Unreadable(broken.message)
            error.is_first = self._unreadable == 1
            raise error from broken
        if frame is not None:
            self._frames += 1
            # The first frame of a connection is told as a whole, so the second must be read as well.
            if self._frames > 1:
                self._unreadable = 0
        return frame
