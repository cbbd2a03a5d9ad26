"""What a pipeline script does, checked step by step: pipeline.py HTTP_URL.

Fetches the sample over HTTP, then over gRPC: opens a session from the file on disk, sets handles, drags fifty poses on one
stream, commits, undoes, redoes, exports, compares every answer with the others, lists and deletes. Ends with a summary and
exit code 0, or with the first thing that does not hold and exit code 1.
"""
import array
import json
import math
import os
import struct
import sys
import tempfile
import threading
import time
import urllib.request

import grpc
from pliant.v1 import pliant_pb2 as pb
from pliant.v1 import pliant_pb2_grpc

POSES = 50
WINDOW = 4
SECONDS = 120  # the deadline of every call; nothing here depends on being faster


def check(holds, what):
    """Stops the script at the first thing that is not as it should be."""
    if not holds:
        sys.exit(f"pipeline: {what}")


def upload(path, options):
    """CreateSession's stream: the options, then the file in pieces smaller than any message limit."""
    yield pb.CreateSessionRequest(options=options)
    with open(path, "rb") as model:
        while piece := model.read(64 << 10):
            yield pb.CreateSessionRequest(chunk=piece)


def floats(data):
    """Little-endian 32-bit floats."""
    numbers = array.array("f")
    numbers.frombytes(data)
    if sys.byteorder == "big":
        numbers.byteswap()
    return numbers


def glb_positions(data):
    """The positions of a GLB with one primitive under an identity node, from its accessor; also its JSON."""
    magic, version, length = struct.unpack_from("<4sII", data)
    check((magic, version, length) == (b"glTF", 2, len(data)), "the export is not a GLB of the length that its header says")
    json_length, kind = struct.unpack_from("<I4s", data, 12)
    check(kind == b"JSON", "the first chunk of the export is not JSON")
    asset = json.loads(data[20:20 + json_length])
    binary = 20 + json_length + 8
    accessor = asset["accessors"][asset["meshes"][0]["primitives"][0]["attributes"]["POSITION"]]
    view = asset["bufferViews"][accessor["bufferView"]]
    check(accessor["componentType"] == 5126 and accessor["type"] == "VEC3", "positions are not three floats")
    check(view.get("byteStride", 12) == 12, "positions are interleaved, which the sample's are not")
    first = binary + view.get("byteOffset", 0) + accessor.get("byteOffset", 0)
    return floats(data[first:first + 12 * accessor["count"]]), asset


class Frames:
    """Puts the parts of frames together and keeps the books of a stream."""

    def __init__(self, vertices):
        self.vertices = vertices
        self.data = bytearray()
        self.parts = 0  # of the frame under way
        self.last = None  # header of the newest whole frame
        self.positions = None
        self.finals = 0
        self.superseded = 0
        self.bytes = 0
        self.solve_ms = []
        self.taken = 0  # seq of the newest final frame; the sending side acknowledges it
        self.news = threading.Event()

    def take(self, frame):
        """One part."""
        check(frame.part == self.parts, f"part {frame.part} of frame {frame.seq} came where part {self.parts} was due")
        check(frame.first_vertex * 12 == len(self.data), f"frame {frame.seq} has a gap before vertex {frame.first_vertex}")
        check(len(frame.data) == 12 * frame.vertex_count, f"frame {frame.seq} has other bytes than its vertices need")
        self.data += frame.data
        self.parts += 1
        if self.parts < frame.parts:
            return
        check(len(self.data) == 12 * self.vertices, f"frame {frame.seq} does not hold every vertex")
        if self.last is not None:
            newer = frame.seq > self.last.seq or (frame.seq == self.last.seq and not self.last.final)
            check(newer, f"frame {frame.seq} came after frame {self.last.seq}")
        self.bytes += len(self.data)
        self.positions, self.data, self.parts, self.last = bytes(self.data), bytearray(), 0, frame
        self.superseded += frame.superseded
        if frame.final:
            self.finals += 1
            self.solve_ms.append(frame.solve_ms)
            self.taken = frame.seq
            self.news.set()


def drag(session_id, frames):
    """Fifty poses at 60 a second, frames acknowledged as they come; the last pose is committed."""
    yield pb.DeformRequest(session_id=session_id, options=pb.Options(tolerance=1e-6, window=WINDOW))
    acknowledged = 0
    for seq in range(1, POSES + 1):
        angle = 0.8 * math.sin(math.pi / 2 * seq / POSES)
        pose = pb.HandlePose(rotation_vector=[0, angle, 0], translation=[0, 0.05 * angle, 0])
        if frames.taken > acknowledged:
            acknowledged = frames.taken
            yield pb.DeformRequest(ack=pb.Ack(seq=acknowledged))
        entries = [pb.Pose.Entry(id="head", pose=pose)]
        yield pb.DeformRequest(pose=pb.Pose(seq=seq, handles=entries, commit=seq == POSES))
        time.sleep(1 / 60)
    # The stream stays open until the commit is answered, acknowledging what comes in between.
    while frames.taken < POSES:
        check(frames.news.wait(SECONDS), "the committed pose was not answered")
        frames.news.clear()
        if frames.taken > acknowledged:
            acknowledged = frames.taken
            yield pb.DeformRequest(ack=pb.Ack(seq=acknowledged))


def refused(call, code):
    """Whether a call ends with that status."""
    try:
        call()
    except grpc.RpcError as error:
        return error.code() == code
    return False


def main(base):
    deformer = pliant_pb2_grpc.DeformerStub(grpc.insecure_channel(base.removeprefix("http://")))
    named = lambda session: pb.SessionRequest(session_id=session.id)
    export = lambda session: b"".join(
        piece.data for piece in deformer.Export(pb.ExportRequest(session_id=session.id), timeout=SECONDS))

    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "creature.glb")
        urllib.request.urlretrieve(f"{base}/v1/sample.glb", path)
        with open(path, "rb") as model:
            uploaded = model.read()
        session = deformer.CreateSession(upload(path, pb.CreateOptions(label="pipeline")), timeout=SECONDS)
    vertices = session.model.vertices
    check(session.model.bytes == len(uploaded), "the session holds another number of bytes than was sent")
    check(sum(p.vertex_count for p in session.primitives) == vertices, "the primitive table does not add up")
    check(export(session) == uploaded, "an untouched session gives back other bytes than were uploaded")
    rest, asset = glb_positions(uploaded)

    check(refused(lambda: list(deformer.Solve(pb.SolveRequest(session_id=session.id, pose=pb.Pose()), timeout=SECONDS)),
                  grpc.StatusCode.FAILED_PRECONDITION), "a pose without handles was not refused as FAILED_PRECONDITION")
    feet = pb.Region(half_space=pb.Region.HalfSpace(normal=[0, -1, 0], offset=-0.14))
    head = pb.Region(sphere=pb.Region.Sphere(center=[0.76, 1.22, 0], radius=0.36))
    handles = [pb.Handle(id="feet", region=feet), pb.Handle(id="head", region=head)]
    held = deformer.SetHandles(pb.SetHandlesRequest(session_id=session.id, handles=handles), timeout=SECONDS)
    check([h.id for h in held.handles] == ["feet", "head"], "the handles in force are not those that were set")
    check(all(h.vertices > 0 for h in held.handles), "a handle holds nothing")
    check(held.revision > session.revision, "setting handles did not raise the revision")

    frames = Frames(vertices)
    errors = 0
    for response in deformer.Deform(drag(session.id, frames), timeout=SECONDS):
        kind = response.WhichOneof("message")
        check(kind in ("frame", "notice", "error"), f"an answer of kind {kind} came unasked")
        if kind == "error":
            errors += 1
            check(response.error.seq != 0, f"the stream failed: {response.error.message}")
        if kind == "frame":
            frames.take(response.frame)
    check(frames.last is not None and frames.last.final and frames.last.seq == POSES,
          "the last pose was not answered by a final frame")
    check(errors == 0, f"{errors} poses were refused")
    check(frames.finals + errors + frames.superseded == POSES,
          f"{frames.finals} frames, {errors} errors and {frames.superseded} skipped poses are not {POSES}")
    check(frames.last.residual <= 1e-6, f"the committed pose has residual {frames.last.residual}")
    committed = deformer.GetSession(named(session), timeout=SECONDS)
    check(committed.revision == frames.last.revision, "the committed frame names another revision than the session")

    bent = floats(frames.positions)
    moved = max(abs(a - b) for a, b in zip(rest, bent))
    check(moved > 0.05, f"no vertex moved by more than {moved}")
    after = export(session)
    exported, described = glb_positions(after)
    check(exported == bent, "the exported GLB has other positions than the last frame")
    check(described.keys() == asset.keys(), "the exported GLB has other top-level members than the uploaded one")

    undone = deformer.Undo(named(session), timeout=SECONDS)
    check(undone.revision > committed.revision, "undoing did not raise the revision")
    check(export(session) == uploaded, "undoing the only pose does not give back the uploaded bytes")
    deformer.Redo(named(session), timeout=SECONDS)
    check(export(session) == after, "redoing does not give back the exported bytes")
    check(refused(lambda: deformer.Redo(named(session), timeout=SECONDS), grpc.StatusCode.FAILED_PRECONDITION),
          "a redo with nothing to redo was not refused as FAILED_PRECONDITION")
    history = deformer.History(named(session), timeout=SECONDS)
    kinds = [commit.kind for commit in history.commits]
    check(kinds == ["create", "handles", "pose"], f"the history is {kinds}")
    check(history.current == history.commits[-1].revision, "the session is not in its newest commit")

    listed = deformer.ListSessions(pb.ListSessionsRequest(), timeout=SECONDS)
    check(session.id in [s.id for s in listed.sessions], "the session is not listed")
    deformer.DeleteSession(named(session), timeout=SECONDS)
    check(refused(lambda: deformer.GetSession(named(session), timeout=SECONDS), grpc.StatusCode.NOT_FOUND),
          "a deleted session is still there")

    slowest = max(frames.solve_ms)
    print(f"pipeline: {vertices} render vertices, {session.solver.graph_vertices} graph vertices, "
          f"{len(session.solver.levels)} levels")
    print(f"pipeline: {POSES} poses sent, {frames.finals} frames of {12 * vertices} bytes, {frames.superseded} superseded, "
          f"slowest solve {slowest:.1f} ms, last residual {frames.last.residual:.1e}")
    print("pipeline: undo and redo return to the byte; the session is deleted")


if __name__ == "__main__":
    main(sys.argv[1].rstrip("/"))
