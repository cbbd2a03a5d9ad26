"""The Python samples of /docs, one below each operation's id; together they are one program."""

# createSession
import pliant

client = pliant.connect("http://127.0.0.1:7411")
session = client.open(client.sample(), ttl="1h")  # or client.open("model.glb")

# listSessions
for info in client.sessions():
    print(info.id, info.label)

# getSession
info = session.refresh()  # or session = client.attach(id)

# setHandles
session.handle("feet", half_space=((0, -1, 0), -0.14))
session.handle("head", sphere=((0.76, 1.22, 0), 0.36))
session.apply()

# patchSessionsIdHandlesHandleId
session.handle("head", sphere=((0.76, 1.22, 0), 0.36), stiffness=0.5)
session.apply()

# solve
pose = {"head": {"rotation_vector": (0, 0.8, 0), "translation": (0, 0.1, 0)}}
positions = session.solve(pose, refine=4)

# deform
with session.stream() as stream:
    stream.send({"head": {"translation": (0, 0.1, 0)}})
    frame = stream.wait(timeout=60)

# carry
carried = session.carry([(0.76, 1.22, 0)])
print(carried.positions)

# crossings
crossing = session.crossings()
print(crossing.total)

# makeRig
made = session.make_rig(preset="mixamo")
print([joint.name for joint in made.joints if joint.doubtful])

# transfer
came = session.transfer(session=session.id, shape=session.export_bytes("glb")[""])
print(came.report.shapes[0].largest_move)

# deleteSessionsIdHandlesHandleId
session.remove_handle("head")
session.apply()

# edit
region = {"sphere": ((0.76, 1.22, 0), 0.36)}
result = session.edit(subdivide={"region": region, "scheme": "midpoint"})

# undo
session.undo()

# redo
session.redo()

# history
for commit in session.history():
    print(commit.revision, commit.kind)

# export
session.export("bent.glb")

# getSessionsIdPositions
positions = session.positions()

# animate
figure = client.open(client.sample("figure"))
for frame in figure.animate("walk", fps=30, count=10):
    print(frame.time, frame.positions.shape)

# getLimits
limits = client.limits()

# getSampleGlb
model = client.sample("creature")

# deleteSession
session.close()
