"""A hundred poses of a model, each in a file of its own, with a progress bar: batch.py [MODEL].

Without a model the server's creature nods. Writes poses/nod_000.glb to poses/nod_099.glb.
"""

# %%
import math
import sys
from pathlib import Path

from tqdm import tqdm

import pliant

POSES = 100
folder = Path("poses")
folder.mkdir(exist_ok=True)

# %%
with pliant.connect() as client:
    model = Path(sys.argv[1]) if len(sys.argv) > 1 else client.sample()
    with client.open(model, progress=True) as session:
        session.handle("feet", half_space=((0, -1, 0), -0.14))
        session.handle("head", sphere=((0.76, 1.22, 0), 0.36))
        nods = [{"head": {"rotation_vector": (0, 0, 0.5 * math.sin(2 * math.pi * k / POSES))}} for k in range(POSES)]
        # Recorded poses depend on nothing but the pose: run this again and every file has the same bytes.
        for k, frame in enumerate(tqdm(session.drag(nods, commit=True), total=POSES, unit="pose")):
            session.export(folder / f"nod_{k:03}.glb")
        worst = frame.max_error
print(f"{len(list(folder.glob('nod_*.glb')))} files; at most {worst:.1e} of the size is missing in the last one")
