"""The same as :mod:`pliant`, for asyncio.

    import pliant.aio

    async with pliant.aio.open("creature.glb") as s:
        s.handle("feet", half_space=((0, -1, 0), -0.14))
        s.handle("head", sphere=((0.76, 1.22, 0), 0.36))
        async for frame in s.drag(poses):
            ...
        await s.export("turned.glb")

What only notes something down (``handle``, ``remove_handle``, ``clear_handles``, ``symmetry_plane``,
``region_of_interest``, and ``send`` of a stream) is a plain method; what asks the server is a coroutine.
"""

from .client import Client, connect, open
from .player import Animation
from .session import Session
from .stream import Stream

__all__ = ["Animation", "Client", "Session", "Stream", "connect", "open"]
