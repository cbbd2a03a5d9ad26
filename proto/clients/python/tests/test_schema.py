"""The stubs say what the schema says."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from google.protobuf import descriptor_pb2

from conftest import ROOT
from pliant.v1 import pliant_pb2 as pb


def _fields(message: Any) -> Iterator[Any]:
    """All fields of a file or of a message with what is nested in it."""
    yield from getattr(message, "field", ())
    for inner in getattr(message, "message_type", ()) or getattr(message, "nested_type", ()):
        yield from _fields(inner)


def test_the_stubs_were_made_from_the_schema(tmp_path: Path) -> None:
    if not (ROOT / "proto/pliant/v1/pliant.proto").is_file():
        pytest.skip("this is not a checkout")
    out = tmp_path / "set.bin"
    command = [
        sys.executable,
        "-m",
        "grpc_tools.protoc",
        "-I",
        str(ROOT / "proto"),
        "-o",
        str(out),
        "pliant/v1/pliant.proto",
    ]
    subprocess.run(command, check=True)
    [wanted] = descriptor_pb2.FileDescriptorSet.FromString(out.read_bytes()).file
    for field in _fields(wanted):
        # protoc writes the usual name down, the generated file only one that the schema gives.
        first, *words = field.name.split("_")
        if field.json_name == first + "".join(word[:1].upper() + word[1:] for word in words):
            field.ClearField("json_name")
    made = descriptor_pb2.FileDescriptorProto()
    pb.DESCRIPTOR.CopyToProto(made)
    assert made == wanted, "the schema has changed: run proto/clients/python/generate"
