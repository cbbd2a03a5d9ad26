"""The way to a server: addresses, channel settings, credentials, and when to try again."""

from __future__ import annotations

import os
import random
import re
import ssl
import time
import urllib.error
import urllib.request
import uuid
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

import grpc

from . import errors

LOOPBACK = ("127.0.0.1", "::1", "localhost")

#: Silence of a connection on which a call is under way, after which a sign of life is asked for.
SILENCE_MS = 3_000
#: How long that sign may take; then the connection counts as lost.
SIGN_OF_LIFE_MS = 6_000


@dataclass(frozen=True)
class Settings:
    """How to reach a server, and how to behave on the way."""

    #: ``http://HOST:PORT`` (plain), ``https://HOST:PORT`` (TLS), or ``HOST:PORT`` (plain).
    url: str
    #: Sent with every call as ``authorization: Bearer TOKEN``.
    token: str | None = None
    #: PEM file of the authorities that may sign an https server's certificate; default: those of gRPC.
    ca: str | os.PathLike[str] | None = None
    #: Seconds that a call may take, uploads and solves included.
    timeout: float = 600.0
    #: Seconds for which a lost connection, or a server that restarts, is looked for again. 0 = give up at once.
    patience: float = 15.0
    #: Largest message taken. The server's parts are 1 MiB unless it was configured otherwise.
    message_bytes: int = 16 << 20
    #: Bytes of one stream that may be under way before they are read: HTTP/2's flow-control window.
    window_bytes: int = 8 << 20
    #: Further addresses of the same service, asked where the first one does not answer: other nodes with the same store.
    others: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "url", _address("server", self.url))
        object.__setattr__(self, "others", tuple(_address("others", url) for url in self.others))

    @property
    def secure(self) -> bool:
        """Whether it is TLS."""
        return self.url.startswith("https:")

    @property
    def target(self) -> str:
        """HOST:PORT."""
        return self.url.split("://", 1)[1]

    @property
    def loopback(self) -> bool:
        """Whether it is this machine."""
        return urlsplit(self.url).hostname in LOOPBACK

    def options(self) -> list[tuple[str, int]]:
        """gRPC's settings of the channel."""
        return [
            ("grpc.max_receive_message_length", self.message_bytes),
            # What may be sent is the server's to say; it names its limit.
            ("grpc.max_send_message_length", -1),
            # One megabyte a frame instead of 16 KiB makes large frames about twice as fast.
            ("grpc.http2.max_frame_size", 1 << 20),
            ("grpc.http2.lookahead_bytes", self.window_bytes),
            # While a call is under way: a peer that is gone without a word, or stopped where it is, is noticed within ten seconds. What
            # only computes for long answers pings all the time.
            ("grpc.keepalive_time_ms", SILENCE_MS),
            ("grpc.keepalive_timeout_ms", SIGN_OF_LIFE_MS),
            # A sign that was asked for to measure the connection stands for one of these, and would have a minute.
            ("grpc.http2.ping_timeout_ms", SIGN_OF_LIFE_MS),
            # Of a call that waits for its answer there may be many; otherwise the third would be held back for a minute.
            ("grpc.http2.max_pings_without_data", 0),
            # A restarted server is found within the second, not after gRPC's growing pauses of up to two minutes.
            ("grpc.initial_reconnect_backoff_ms", 100),
            ("grpc.min_reconnect_backoff_ms", 5_000),
            ("grpc.max_reconnect_backoff_ms", 1_000),
            # A connection of its own: one upload does not hold up another client's frames.
            ("grpc.use_local_subchannel_pool", 1),
            ("grpc.enable_http_proxy", 0 if self.loopback else 1),
            # Calls are repeated here, with an idempotency key.
            ("grpc.enable_retries", 0),
        ]

    def credentials(self) -> grpc.ChannelCredentials:
        """TLS with the authorities of `ca`."""
        return grpc.ssl_channel_credentials(Path(self.ca).read_bytes() if self.ca is not None else None)

    def metadata(self, key: str | None = None) -> tuple[tuple[str, str], ...]:
        """The headers of a call; `key` makes its repetition harmless."""
        token = (("authorization", f"Bearer {self.token}"),) if self.token else ()
        return token + ((("idempotency-key", key),) if key else ())

    def get(self, path: str, more: tuple[tuple[str, str], ...] = ()) -> bytes:
        """The body of an HTTP GET, for what has no call in gRPC; `more` headers go with it."""
        # Where another node has what is asked for, its address is told, and not followed without us.
        headers = dict(self.metadata() + more + (("x-pliant-hops", "0"),))
        request = urllib.request.Request(self.url + path, headers=headers)
        handlers: list[urllib.request.BaseHandler] = []
        if self.loopback:
            handlers.append(urllib.request.ProxyHandler({}))
        if self.secure:
            context = ssl.create_default_context(cafile=None if self.ca is None else os.fspath(self.ca))
            handlers.append(urllib.request.HTTPSHandler(context=context))
        try:
            with urllib.request.build_opener(*handlers).open(request, timeout=self.timeout) as answer:
                body = answer.read()
        except urllib.error.HTTPError as refused:
            error = errors.of_problem(refused.code, refused.read(), refused.headers.get("retry-after"))
            error.owner, error.node = refused.headers.get("x-pliant-owner"), refused.headers.get("x-pliant-node")
            raise error from None
        except OSError as lost:
            reason = getattr(lost, "reason", lost)
            raise errors.Unavailable(f"{self.url} cannot be reached: {reason}") from None
        assert isinstance(body, bytes)
        return body


def _address(field: str, url: str) -> str:
    parts = urlsplit(url if "://" in url else f"http://{url}")
    named = parts.hostname is not None and re.fullmatch(r"[\w.:-]+", parts.hostname)
    if parts.scheme not in ("http", "https") or not named or parts.path not in ("", "/"):
        raise ValueError(f"{field}: {url!r}; http://HOST:PORT, https://HOST:PORT or HOST:PORT is allowed")
    host = f"[{parts.hostname}]" if ":" in str(parts.hostname) else parts.hostname
    port = parts.port or (443 if parts.scheme == "https" else 7411)
    return f"{parts.scheme}://{host}:{port}"


def key() -> str:
    """A new idempotency key."""
    return uuid.uuid4().hex


#: What gRPC says, beside UNAVAILABLE, when a connection goes in the middle of a call.
_LOST = ("RST_STREAM", "Stream removed", "Internal error from Core")

#: What is said of a call on a connection that its owner closed.
CLOSED = "the connection is closed: close() was called on its client, or on the session that pliant.open() made"


def is_lost(error: errors.PliantError) -> bool:
    """Whether the server went away, or is about to."""
    return isinstance(error, errors.Unavailable) or any(words in error.message for words in _LOST)


class Attempts:
    """When a call that failed is worth another try: soon at first, then after longer and longer pauses, for as long as
    the patience lasts, which is counted from the first failure."""

    _FIRST, _LONGEST = 0.05, 1.0
    # So often a call goes at once where it is sent; who is sent around goes on slowly.
    _HOPS = 4

    def __init__(self, patience: float, *, resuming: bool = False) -> None:
        self._patience = patience
        self._end: float | None = None
        self._pause = self._FIRST
        self._hops = 0
        # Whether this client had its place already: then a place that is still taken is its own, and comes free.
        self._resuming = resuming

    @property
    def left(self) -> float:
        """Seconds of patience."""
        return self._patience if self._end is None else max(0.0, self._end - time.monotonic())

    def again(self, error: errors.PliantError) -> float | None:
        """Seconds to wait before the next try, or None when the error stands."""
        if not self._may_pass(error):
            return None
        if self._end is None:
            self._end = time.monotonic() + self._patience
        left, wanted = self.left, error.retry_after or 0.0
        if error.owner is not None and self._hops < self._HOPS:
            self._hops += 1
            return 0.0
        if left == 0 or wanted > left:
            return None
        # Not all clients of a server that was restarted come at the same moment.
        pause, self._pause = self._pause * random.uniform(0.5, 1.0), min(self._pause * 2, self._LONGEST)
        return max(wanted, min(pause, left))

    def last_word(self, error: errors.PliantError) -> errors.PliantError:
        """The error that stands, with how long it was tried."""
        if self._end is None or not self._may_pass(error):
            return error
        text = f"{error.message} (tried again for {self._patience:g} s)"
        return type(error)(text, code=error.code, field=error.field, retry_after=error.retry_after, seq=error.seq)

    def _may_pass(self, error: errors.PliantError) -> bool:
        if isinstance(error, (errors.LocalServerError, errors.TooLarge)):
            return False
        lost = is_lost(error) or (isinstance(error, errors.Unreadable) and error.is_first)
        running = isinstance(error, errors.Aborted) and "still running" in error.message
        taken = isinstance(error, errors.ResourceExhausted) and error.retry_after is not None and self._resuming
        return lost or running or taken


def of_session(error: errors.PliantError) -> errors.PliantError:
    """The same error, as what it means to somebody who holds a session."""
    if isinstance(error, errors.NotFound) and error.message.startswith("no session"):
        hint = "a server without data_dir loses its sessions when it restarts. Open the model again"
        return errors.SessionLost(f"{error.message}; {hint}", code=error.code)
    return error
