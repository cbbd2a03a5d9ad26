"""Limits: what is refused, with which numbers, and whether waiting helps."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest

import pliant
from conftest import bar, binary


def send_when_free(session: pliant.Session, window: int) -> None:
    """Opens a stream and sends a pose; tries again while the place of a stream just closed is not free yet."""
    for attempt in range(100):
        try:
            with session.stream(window=window) as stream:
                stream.send({})
                stream.wait(timeout=30)
            return
        except pliant.ResourceExhausted:
            assert attempt < 99, "the place of a closed stream is never free"
            time.sleep(0.05)


def test_limits_are_told_and_enforced(creature: Path) -> None:
    keys = {"sessions": 1, "vertices": 10_000, "upload_bytes": "1MiB", "handles": 2, "window": 4, "streams": 1}
    with pliant.LocalServer(binary(), **keys) as server, pliant.connect(server) as client:
        limits = client.limits()
        assert (limits.sessions, limits.vertices, limits.upload_bytes, limits.handles) == (1, 10_000, 1 << 20, 2)

        with pytest.raises(pliant.TooLarge, match="1048576") as large:
            client.open(b"x" * (2 << 20), format="off")
        assert large.value.retry_after is None, "waiting does not make it smaller"
        with pytest.raises(pliant.TooLarge, match="10000|10,000"):
            client.open(bar(cells=2000))

        with client.open(creature) as session:
            with pytest.raises(pliant.ResourceExhausted) as full:
                client.open(creature)
            assert full.value.retry_after is not None and full.value.retry_after >= 1
            assert not isinstance(full.value, pliant.TooLarge)

            for k in range(3):
                session.handle(f"h{k}", sphere=((0.76, 1.22, 0), 0.3 - 0.05 * k))
            with pytest.raises(pliant.PliantError, match="2") as many:
                session.apply()
            assert many.value.code in ("INVALID_ARGUMENT", "RESOURCE_EXHAUSTED")
            session.remove_handle("h2")

            with session.stream() as one, pytest.raises(pliant.ResourceExhausted):
                one.send({})
                one.wait(timeout=30)
                with session.stream() as two:
                    two.send({})
                    two.wait(timeout=30)
            with pytest.raises(pliant.InvalidArgument, match="window"):
                send_when_free(session, window=9)


def test_a_message_that_is_too_large_is_refused_with_the_limit() -> None:
    vertices, faces = bar(cells=2500)
    with pliant.LocalServer(binary(), message_bytes="64KiB") as server:
        with pliant.open((vertices, faces), server=server) as session:
            session.handle("all", weights=np.ones(len(vertices)))
            with pytest.raises(pliant.TooLarge, match="65536"):
                session.apply()
            session.clear_handles()
            session.handle("all", vertices=np.arange(len(vertices)))
            assert session.apply().handles[0].vertices == len(vertices), "runs of vertices are short"


def test_a_client_can_be_narrower_than_the_server(server: pliant.LocalServer, creature: Path) -> None:
    with pytest.raises(pliant.ResourceExhausted, match="larger than max"):
        with pliant.open(creature, server=server, way={"message_bytes": 10_000, "patience": 0.5}) as session:
            session.handle("head", sphere=((0.76, 1.22, 0), 0.36))
            session.solve()


def test_a_call_that_takes_too_long_is_given_up(server: pliant.LocalServer) -> None:
    with pytest.raises(pliant.DeadlineExceeded):
        pliant.open(bar(cells=20_000), server=server, way={"timeout": 0.05})


def test_a_token_and_tls_go_with_the_address(server: pliant.LocalServer) -> None:
    with pliant.connect(server.url, token="secret") as client:
        assert client.limits().sessions > 0
    with pytest.raises(pliant.Unavailable):
        pliant.connect(server.url.replace("http:", "https:"), patience=0).limits()
