"""Drag the creature's head over gRPC and keep the result: tour.py [HOST:PORT]. Reads creature.glb, writes nodding.glb."""
import math
import sys
import time

import grpc
from pliant.v1 import pliant_pb2 as pb, pliant_pb2_grpc

deformer = pliant_pb2_grpc.DeformerStub(grpc.insecure_channel((sys.argv[1:] or ["127.0.0.1:7411"])[0]))
POSES = 30
taken = 0  # the newest frame that we have


def upload(path):
    """The options first, then the model in pieces."""
    yield pb.CreateSessionRequest(options=pb.CreateOptions(label="tour.py"))
    with open(path, "rb") as model:
        while piece := model.read(1 << 20):
            yield pb.CreateSessionRequest(chunk=piece)


def drag(session_id):
    """Poses at 60 a second, whether or not the solver keeps up: the newest wins. The last one is committed."""
    yield pb.DeformRequest(session_id=session_id, options=pb.Options(tolerance=1e-4, window=4))
    for seq in range(1, POSES + 1):
        nod = pb.HandlePose(rotation_vector=[0, 0, -0.6 * math.sin(math.pi / 2 * seq / POSES)])
        entry = pb.Pose.Entry(id="head", pose=nod)
        yield pb.DeformRequest(ack=pb.Ack(seq=taken))
        yield pb.DeformRequest(pose=pb.Pose(seq=seq, handles=[entry], commit=seq == POSES))
        time.sleep(1 / 60)


session = deformer.CreateSession(upload("creature.glb"))
feet = pb.Region(half_space=pb.Region.HalfSpace(normal=[0, -1, 0], offset=-0.14))
head = pb.Region(sphere=pb.Region.Sphere(center=[0.76, 1.22, 0], radius=0.36))
handles = [pb.Handle(id="feet", region=feet), pb.Handle(id="head", region=head)]
deformer.SetHandles(pb.SetHandlesRequest(session_id=session.id, handles=handles))

for response in deformer.Deform(drag(session.id)):
    if response.HasField("error"):
        sys.exit(f"pose {response.error.seq}: {response.error.message}")
    frame = response.frame  # frame.data holds the positions: little-endian float32 x, y, z per render vertex
    if frame.final and frame.part + 1 == frame.parts:
        taken = frame.seq
        print(f"pose {frame.seq}: solved in {frame.solve_ms:.1f} ms, {frame.superseded} skipped before it")

with open("nodding.glb", "wb") as out:
    for piece in deformer.Export(pb.ExportRequest(session_id=session.id)):
        out.write(piece.data)
deformer.DeleteSession(pb.SessionRequest(session_id=session.id))
