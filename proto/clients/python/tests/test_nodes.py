"""Several servers with one store: a call that comes to the wrong one goes to the right one, and nobody is sent around for ever."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from concurrent import futures
from pathlib import Path
from typing import Any

import grpc
import numpy as np
import pytest

import pliant
import pliant.aio
from pliant import errors
from pliant.channel import Attempts, Settings
from pliant.route import Route

TURN = {"head": {"rotation_vector": (0, 0.8, 0)}}


class WrongNode(grpc.GenericRpcHandler):
    """A node that has no session at all, and knows who has: it says so to every call."""

    def __init__(self, owner: str, limits: str | None = None) -> None:
        self.owner, self.limits = owner, limits
        self.seen: list[dict[str, Any]] = []
        self._server = grpc.server(futures.ThreadPoolExecutor(8), handlers=(self,))
        self.url = f"http://127.0.0.1:{self._server.add_insecure_port('127.0.0.1:0')}"
        self._server.start()

    def service(self, details: Any) -> Any:
        def answer(_requests: Any, context: Any) -> Any:
            self.seen.append({"call": details.method, **dict(context.invocation_metadata())})
            context.set_trailing_metadata((("x-pliant-owner", self.owner), ("x-pliant-node", "b")))
            context.abort(grpc.StatusCode.UNAVAILABLE, "the session is at another node")

        return grpc.stream_stream_rpc_method_handler(answer)

    def end(self) -> None:
        self._server.stop(None)


@pytest.fixture
def wrong(server: pliant.LocalServer) -> Iterator[WrongNode]:
    node = WrongNode(server.url)
    yield node
    node.end()


def hold(session: Any) -> None:
    session.handle("feet", half_space=((0, -1, 0), -0.14))
    session.handle("head", sphere=((0.76, 1.22, 0), 0.36))


def test_every_call_goes_to_the_node_that_has_the_session(
    wrong: WrongNode, server: pliant.LocalServer, creature: Path
) -> None:
    with pliant.connect(wrong.url) as client, client.open(creature) as session:
        hold(session)
        shape = session.solve(TURN)
        dragged = list(session.drag([{"head": {"rotation_vector": (0, 0.1 * k, 0)}} for k in range(3)]))
        assert len(dragged) == 3
        assert np.array_equal(session.positions(), shape), "also what has no call in gRPC"
        assert session.export_bytes("obj")[""].startswith(b"#") or session.export_bytes("obj")[""]
        asked = len(wrong.seen)
        session.undo()
        assert len(wrong.seen) == asked, "who knows where it is does not ask again"
        other = client.attach(session.id)
        assert np.array_equal(other.positions(), session.positions())
        attached = [seen for seen in wrong.seen if seen["call"].endswith("GetSession")]
        assert attached[-1]["x-pliant-session"] == session.id, "proxies choose by it"


def test_every_call_of_the_event_loop_too(wrong: WrongNode, creature: Path) -> None:
    async def run() -> None:
        async with await pliant.aio.connect(wrong.url) as client:
            session = await client.open(creature)
            async with session:
                hold(session)
                shape = await session.solve(TURN)
                assert np.array_equal(await session.positions(), shape)
                async with await session.stream() as stream:
                    stream.send(TURN)
                    assert (await stream.wait()).final

    asyncio.run(run())
    assert wrong.seen


def test_who_is_sent_around_in_circles_gives_up() -> None:
    one = WrongNode("http://127.0.0.1:1")
    other = WrongNode(one.url)
    one.owner = other.url
    begun = time.monotonic()
    with pliant.connect(one.url, patience=1.0) as client, pytest.raises(errors.Unavailable):
        client.attach("00000000000000000000000000000000")
    assert time.monotonic() - begun < 10
    assert len(one.seen) + len(other.seen) < 40, "with pauses"
    assert any(seen.get("x-pliant-node") == "b" for seen in other.seen), "a proxy learns the node's name"
    one.end()
    other.end()


def test_a_node_that_went_away_is_asked_for_at_home(server: pliant.LocalServer, creature: Path) -> None:
    # The node that was named is nobody; meanwhile the session has gone to where it really is.
    home = WrongNode("http://127.0.0.1:1")
    with pliant.connect(server.url) as real:
        session = real.open(creature, keep=True)
        asking = futures.ThreadPoolExecutor(1).submit(pliant.connect(home.url).attach, session.id)
        while not home.seen:
            time.sleep(0.01)
        home.owner = server.url
        assert asking.result(30).id == session.id
        assert len(home.seen) >= 2
    home.end()


def test_a_second_address_is_asked_where_the_first_one_is_away(server: pliant.LocalServer, creature: Path) -> None:
    with pliant.connect("http://127.0.0.1:1", others=(server.url,)) as client, client.open(creature) as session:
        assert session.refresh().id == session.id
    with pytest.raises(ValueError, match="others: 'ftp://x'"):
        Settings("http://a:1", others=("ftp://x",))


def test_a_token_that_was_to_be_encrypted_is_shown_to_nobody_in_the_open() -> None:
    route = Route(Settings("https://mesh.example:443", token="secret"))
    sent = errors.Unavailable("elsewhere")
    sent.owner, sent.node = "http://10.0.0.5:7411", "b"
    route.learn(sent)
    assert route.url == "https://mesh.example:443"
    sent.owner = "https://10.0.0.5:7411"
    route.learn(sent)
    assert route.url == "https://10.0.0.5:7411"
    assert route.headers("s") == (("x-pliant-session", "s"), ("x-pliant-node", "b"))


def test_hops_are_made_at_once_and_then_with_pauses() -> None:
    attempts = Attempts(60.0)
    sent = errors.Unavailable("elsewhere")
    sent.owner = "http://10.0.0.5:7411"
    pauses = [attempts.again(sent) for _ in range(8)]
    assert pauses[:4] == [0.0] * 4
    assert all(pause is not None and pause > 0 for pause in pauses[4:])
