"""What can go wrong, as exceptions.

Every exception carries the server's own words: ``code`` (such as ``INVALID_ARGUMENT``), ``message`` (what was seen and
what is allowed), ``field`` (the path of the value that is wrong, where one is to blame) and ``retry_after`` (seconds,
where waiting helps). A call that raised has changed nothing on the server.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from typing import Any

import grpc
from google.rpc import error_details_pb2, status_pb2


class PliantError(Exception):
    """A failure that the server reported, or of the connection to it."""

    code = "UNKNOWN"

    def __init__(
        self,
        message: str,
        *,
        code: str | None = None,
        field: str | None = None,
        retry_after: float | None = None,
        seq: int | None = None,
        owner: str | None = None,
        node: str | None = None,
    ) -> None:
        super().__init__(message)
        self.message = message
        if code is not None:
            self.code = code
        self.field = field
        self.retry_after = retry_after
        #: The pose of a stream that was refused, where it is about one.
        self.seq = seq
        #: The address of the node that has the session, and its name, where another one was asked.
        self.owner = owner
        self.node = node


class InvalidArgument(PliantError, ValueError):
    """A value that is not allowed, or a request that cannot be read."""

    code = "INVALID_ARGUMENT"


class NotFound(PliantError, LookupError):
    """No such session, handle or page."""

    code = "NOT_FOUND"


class SessionLost(NotFound):
    """The session that this object stands for is no more: it expired, was deleted, closed, or its server restarted."""


class AlreadyExists(PliantError):
    """It exists already."""

    code = "ALREADY_EXISTS"


class Aborted(PliantError):
    """It collides with a call that is under way."""

    code = "ABORTED"


class Unauthenticated(PliantError):
    """The server does not know who asks; give a token."""

    code = "UNAUTHENTICATED"


class PermissionDenied(PliantError):
    """The caller may not."""

    code = "PERMISSION_DENIED"


class ResourceExhausted(PliantError):
    """A quota or the server's capacity is used up; ``retry_after`` says when to come back."""

    code = "RESOURCE_EXHAUSTED"


class TooLarge(ResourceExhausted):
    """One request is larger than the limits allow; waiting does not help."""


class FailedPrecondition(PliantError):
    """The session's state does not fit, such as a pose without handles or an undo with nothing to undo."""

    code = "FAILED_PRECONDITION"


class Unimplemented(PliantError, NotImplementedError):
    """Part of the contract that this server does not do."""

    code = "UNIMPLEMENTED"


class DeadlineExceeded(PliantError, TimeoutError):
    """It took longer than allowed."""

    code = "DEADLINE_EXCEEDED"


class Unavailable(PliantError, ConnectionError):
    """The server cannot be reached, or is going away."""

    code = "UNAVAILABLE"


class Cancelled(PliantError):
    """The call was given up."""

    code = "CANCELLED"


class Internal(PliantError):
    """A defect, of the server or of this package."""

    code = "INTERNAL"


class Unreadable(Internal):
    """A frame of a stream that cannot be read."""

    #: Whether another connection is worth a try: it begins with a frame that stands for itself.
    is_first = True


class LocalServerError(PliantError):
    """A local server cannot be started, or ended unexpectedly."""

    code = "UNAVAILABLE"


_KINDS: dict[str, type[PliantError]] = {
    kind.code: kind
    for kind in (
        InvalidArgument,
        NotFound,
        AlreadyExists,
        Aborted,
        Unauthenticated,
        PermissionDenied,
        ResourceExhausted,
        FailedPrecondition,
        Unimplemented,
        DeadlineExceeded,
        Unavailable,
        Cancelled,
        Internal,
    )
}
_NAMES: dict[int, str] = {status.value[0]: status.name for status in grpc.StatusCode}


def make(
    code: str,
    message: str,
    *,
    field: str | None = None,
    retry_after: float | None = None,
    reason: str = "",
    seq: int | None = None,
) -> PliantError:
    """The exception for a code's name."""
    # What the server's transport says of a message above its limit has a code, and no reason.
    above = code in ("OUT_OF_RANGE", "RESOURCE_EXHAUSTED") and "message length too large" in message
    large = reason == "TOO_LARGE" or code == "OUT_OF_RANGE" or above
    kind = TooLarge if large else _KINDS.get(code, PliantError)
    return kind(message, code=code, field=field, retry_after=retry_after, seq=seq)


def of_stream(code: int, message: str, seq: int) -> PliantError:
    """The exception for an ``Error`` message of a stream."""
    return make(_NAMES.get(code, "UNKNOWN"), message, seq=seq or None)


def of_rpc(error: grpc.RpcError) -> PliantError:
    """The exception for a failed call, with what ``google.rpc`` details say about it."""
    # A failed call is at the same time a grpc.Call, which the types of grpc do not say.
    call: Any = error
    field, retry_after, reason = None, None, ""
    for detail in _details(call.trailing_metadata() or ()):
        if detail.Is(error_details_pb2.BadRequest.DESCRIPTOR):
            bad = error_details_pb2.BadRequest()
            detail.Unpack(bad)
            field = bad.field_violations[0].field if bad.field_violations else None
        elif detail.Is(error_details_pb2.RetryInfo.DESCRIPTOR):
            again = error_details_pb2.RetryInfo()
            detail.Unpack(again)
            retry_after = again.retry_delay.seconds + again.retry_delay.nanos * 1e-9
        elif detail.Is(error_details_pb2.ErrorInfo.DESCRIPTOR):
            info = error_details_pb2.ErrorInfo()
            detail.Unpack(info)
            reason = info.reason
    text = call.details() or "the call failed without a message"
    failed = make(call.code().name, text, field=field, retry_after=retry_after, reason=reason)
    told = {key: value for key, value in call.trailing_metadata() or () if isinstance(value, str)}
    failed.owner, failed.node = told.get("x-pliant-owner"), told.get("x-pliant-node")
    return failed


def _details(metadata: Iterable[tuple[str, str | bytes]]) -> list[Any]:
    for key, value in metadata:
        if key == "grpc-status-details-bin" and isinstance(value, bytes):
            return list(status_pb2.Status.FromString(value).details)
    return []


def of_problem(status: int, body: bytes, retry_after: str | None) -> PliantError:
    """The exception for an ``application/problem+json`` body."""
    try:
        problem = json.loads(body)
        code, message = str(problem["code"]), str(problem["detail"])
        field = problem["errors"][0]["field"] if problem.get("errors") else None
    except (ValueError, LookupError, TypeError, AttributeError):
        code, message, field = "UNKNOWN", f"the server answered {status} without saying why", None
    seconds = float(retry_after) if retry_after and retry_after.isdigit() else None
    return make(code, message, field=field, retry_after=seconds)
