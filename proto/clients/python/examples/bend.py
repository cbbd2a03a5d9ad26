"""Bends a bar by a right angle: arrays in, arrays out. Writes bent.ply."""

# %% A bar along z, from 0 to 4: rings of eight vertices, and the quads between them.
import numpy as np

import pliant

around = np.linspace(0, 2 * np.pi, 8, endpoint=False)
heights = np.linspace(0, 4, 41)
vertices = np.array([[0.3 * np.cos(a), 0.3 * np.sin(a), z] for z in heights for a in around])
faces = np.array(
    [[8 * k + i, 8 * k + (i + 1) % 8, 8 * k + 8 + (i + 1) % 8, 8 * k + 8 + i] for k in range(40) for i in range(8)]
)

# %% Hold one end, turn the other by 90 degrees about y while carrying it along the arc that keeps the length.
radius = 4 / (np.pi / 2)
with pliant.open((vertices, faces)) as session:
    session.handle("base", vertices=vertices[:, 2] < 0.05)
    session.handle("top", vertices=vertices[:, 2] > 3.95, pivot=(0, 0, 4))
    turned = {"rotation_vector": (0, np.pi / 2, 0), "translation": (radius, 0, radius - 4), "pivot": (0, 0, 4)}
    bent = session.solve({"top": turned}, tolerance=1e-6)
    session.export("bent.ply")

# %% The middle of the bar lies on the arc.
middle = bent.reshape(41, 8, 3).mean(axis=1)[20]
on_arc = np.array([radius - radius * np.cos(np.pi / 4), 0, radius * np.sin(np.pi / 4)])
print(f"the middle is at {middle.round(3)}, on the arc it would be at {on_arc.round(3)}")
assert np.linalg.norm(middle - on_arc) < 0.1
assert np.array_equal(bent[vertices[:, 2] < 0.05], vertices[vertices[:, 2] < 0.05].astype(np.float32))
