"""A GLB goes in with everything that is in it and comes out with other positions: checked with pygltflib."""

# %%
import numpy as np
import pygltflib

import pliant


def positions(asset: pygltflib.GLTF2) -> np.ndarray:
    """The positions of the first primitive, whose floats lie side by side."""
    accessor = asset.accessors[asset.meshes[0].primitives[0].attributes.POSITION]
    view = asset.bufferViews[accessor.bufferView]
    first = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    blob = asset.binary_blob()
    return np.frombuffer(blob, "<f4", 3 * accessor.count, first).reshape(-1, 3)


# %% The creature, with notes of our own that no deformer knows of.
with pliant.connect() as client:
    asset = pygltflib.GLTF2.load_from_bytes(client.sample())
    asset.extras = {"reviewed by": "the art department"}
    asset.materials = asset.materials or []
    uploaded = b"".join(asset.save_to_bytes())
    with client.open(uploaded) as session:
        session.handle("feet", half_space=((0, -1, 0), -0.14))
        session.handle("head", sphere=((0.76, 1.22, 0), 0.36))
        bent = session.solve({"head": {"rotation_vector": (0, 0.8, 0)}})
        exported = session.export_bytes("glb")[""]

# %%
before, after = asset, pygltflib.GLTF2.load_from_bytes(exported)
assert after.extras == {"reviewed by": "the art department"}
assert len(after.materials) == len(before.materials) and len(after.meshes) == len(before.meshes)
assert np.array_equal(positions(after), bent), "the file holds what the solve answered"
assert not np.array_equal(positions(before), bent)
print(f"{len(exported)} bytes, {len(bent)} vertices, extras and materials kept")
