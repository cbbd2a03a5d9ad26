"""A mesh of trimesh goes in, a mesh of trimesh comes out. Writes twisted.obj."""

# %%
import numpy as np
import trimesh

import pliant

# process=False keeps trimesh from merging or moving vertices, so that rows stay rows.
# Faces as long as the cylinder could not follow the twist.
mesh = trimesh.creation.cylinder(radius=0.4, height=3.0, sections=24).subdivide_to_size(0.15)
mesh = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)

# %% Hold the cylinder at one end and twist it at the other.
low, high = mesh.bounds[:, 2]
with pliant.open(mesh) as session:
    session.handle("base", half_space=((0, 0, -1), -(low + 0.1)))
    session.handle("top", half_space=((0, 0, 1), high - 0.1))
    frame = session.solve_frame({"top": {"rotation_vector": (0, 0, 1.5)}}, tolerance=1e-6, normals=True)

# %%
twisted = trimesh.Trimesh(frame.positions, mesh.faces, process=False)
twisted.export("twisted.obj")
print(f"volume {mesh.volume:.3f} before, {twisted.volume:.3f} after; closed: {twisted.is_watertight}")
assert abs(twisted.volume / mesh.volume - 1) < 0.03, "a twist keeps the volume"
assert twisted.is_watertight and len(twisted.vertices) == len(mesh.vertices)
assert frame.normals is not None
agree = np.einsum("ij,ij->i", frame.normals, twisted.vertex_normals)
assert np.median(agree) > 0.99
