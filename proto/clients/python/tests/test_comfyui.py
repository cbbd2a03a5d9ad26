"""The nodes for ComfyUI, run as its executor runs them: inputs checked by INPUT_TYPES, outputs handed on, results kept while nothing changes."""

from __future__ import annotations

import gc
import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

import pliant
from conftest import ROOT, bar

PACK = ROOT / "proto/clients/comfyui"
if not PACK.is_dir():
    pytest.skip("this is not a checkout", allow_module_level=True)
pytest.importorskip("PIL", reason="Pillow is not installed, which ComfyUI brings")


class PreviewImage:
    """The node of ComfyUI that shows pictures."""

    RETURN_TYPES = ()
    FUNCTION = "show"
    OUTPUT_NODE = True

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {"required": {"images": ("IMAGE",)}}

    def show(self, images: Any) -> dict[str, Any]:
        return {"ui": {"images": [images]}}


class MakeMesh:
    """A node that makes a mesh, as those of ComfyUI do: a batch of vertices, and one of faces."""

    RETURN_TYPES = ("MESH",)
    FUNCTION = "make"

    @classmethod
    def INPUT_TYPES(cls) -> dict[str, Any]:
        return {"required": {}}

    def make(self) -> tuple[Any]:
        vertices, faces = bar()
        return (SimpleNamespace(vertices=vertices[None], faces=faces[None]),)


class Executor:
    """Runs prompts in ComfyUI's API format."""

    def __init__(self, nodes: dict[str, Any]) -> None:
        self.nodes = nodes
        self.kept: dict[str, tuple[Any, Any]] = {}
        #: The nodes that ran for the last prompt.
        self.ran: list[str] = []

    def run(self, prompt: dict[str, Any]) -> dict[str, Any]:
        for id, entry in prompt.items():
            self.validate(prompt, id, entry)
        self.ran = []
        for id, entry in prompt.items():
            if getattr(self.nodes[entry["class_type"]], "OUTPUT_NODE", False):
                self.outputs(prompt, id)
        return {id: kept for id, (_, kept) in self.kept.items()}

    def validate(self, prompt: dict[str, Any], id: str, entry: dict[str, Any]) -> None:
        node = self.nodes[entry["class_type"]]
        types = node.INPUT_TYPES()
        assert set(types) <= {"required", "optional", "hidden"} and callable(getattr(node, node.FUNCTION))
        known = {**types["required"], **types.get("optional", {})}
        assert set(types["required"]) <= set(entry["inputs"]) <= set(known), f"node {id}: inputs"
        for name, value in entry["inputs"].items():
            kind, *settings = known[name]
            limits = settings[0] if settings else {}
            if isinstance(value, list):
                made = self.nodes[prompt[value[0]]["class_type"]].RETURN_TYPES[value[1]]
                assert made == kind, f"node {id}: {name} takes {kind}, it gets {made}"
            elif isinstance(kind, list):
                assert value in kind, f"node {id}: {name}"
            else:
                assert isinstance(value, {"FLOAT": float, "INT": int, "STRING": str, "BOOLEAN": bool}[kind]), f"node {id}: {name}"
                assert kind not in ("FLOAT", "INT") or limits["min"] <= value <= limits["max"], f"node {id}: {name}"
                assert "default" in limits

    def signature(self, prompt: dict[str, Any], id: str) -> Any:
        """What a node's result depends on."""
        node, inputs = self.nodes[prompt[id]["class_type"]], prompt[id]["inputs"]
        own = {name: None if isinstance(value, list) else value for name, value in inputs.items()}
        changed = node.IS_CHANGED(**own) if hasattr(node, "IS_CHANGED") else None
        before = {name: (self.signature(prompt, value[0]), value[1]) for name, value in inputs.items() if isinstance(value, list)}
        return (prompt[id]["class_type"], json.dumps(own, sort_keys=True), changed, tuple(before.items()))

    def outputs(self, prompt: dict[str, Any], id: str) -> Any:
        signature = self.signature(prompt, id)
        if id in self.kept and self.kept[id][0] == signature:
            return self.kept[id][1]
        inputs = {
            name: self.outputs(prompt, value[0])[value[1]] if isinstance(value, list) else value
            for name, value in prompt[id]["inputs"].items()
        }
        node = self.nodes[prompt[id]["class_type"]]
        made = getattr(node(), node.FUNCTION)(**inputs)
        result = made.get("result", ()) if isinstance(made, dict) else made
        assert isinstance(result, tuple) and len(result) == len(node.RETURN_TYPES)
        self.ran.append(id)
        self.kept[id] = (signature, result)
        return result


@pytest.fixture
def executor(server: pliant.LocalServer, creature: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Executor:
    """ComfyUI with the pack, the creature among its inputs."""
    for name in ("input", "output"):
        (tmp_path / name).mkdir()
    (tmp_path / "input/creature.glb").write_bytes(creature.read_bytes())
    paths = ModuleType("folder_paths")
    paths.get_input_directory = lambda: str(tmp_path / "input")  # type: ignore[attr-defined]
    paths.get_output_directory = lambda: str(tmp_path / "output")  # type: ignore[attr-defined]
    torch = ModuleType("torch")
    torch.from_numpy = lambda array: array  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "folder_paths", paths)
    monkeypatch.setitem(sys.modules, "torch", torch)
    monkeypatch.setenv("PLIANT_SERVER", server.url)
    # As ComfyUI loads a folder of custom_nodes.
    spec = importlib.util.spec_from_file_location("pack", PACK / "__init__.py")
    assert spec is not None and spec.loader is not None
    pack = importlib.util.module_from_spec(spec)
    monkeypatch.setitem(sys.modules, "pack", pack)
    spec.loader.exec_module(pack)
    assert set(pack.NODE_DISPLAY_NAME_MAPPINGS) == set(pack.NODE_CLASS_MAPPINGS)
    assert all(node.CATEGORY == "pliant" and node.DESCRIPTION for node in pack.NODE_CLASS_MAPPINGS.values())
    return Executor({**pack.NODE_CLASS_MAPPINGS, "PreviewImage": PreviewImage, "MakeMesh": MakeMesh})


@pytest.fixture
def nod() -> dict[str, Any]:
    """The prompt that comes with the pack."""
    prompt: dict[str, Any] = json.loads((PACK / "workflows/nod.json").read_text())
    return prompt


def positions(path: Path, server: pliant.LocalServer) -> np.ndarray:
    with pliant.open(path, server=server) as written:
        return written.positions()


def test_the_prompt_of_the_pack_poses_draws_and_exports(
    executor: Executor, nod: dict[str, Any], server: pliant.LocalServer, creature: Path, tmp_path: Path
) -> None:
    made = executor.run(nod)
    [path] = made["7"]
    assert Path(path) == tmp_path / "output/pliant/nod.glb"
    rest, posed = positions(creature, server), positions(Path(path), server)
    feet = rest[:, 1] <= rest[:, 1].min() + 0.1 * np.ptp(rest[:, 1]) - 1e-6
    assert feet.any() and np.array_equal(posed[feet], rest[feet])
    head = np.linalg.norm(rest - [0.76, 1.22, 0], axis=1) < 0.2
    assert np.abs(posed[head] - rest[head]).max() > 0.2
    [image] = made["5"]
    assert image.shape == (1, 512, 512, 3) and image.dtype == np.float32 and 0 <= image.min() < image.max() == 1
    assert 0.1 < np.mean(image < 0.99) < 0.7, "the creature on white"
    # The same with the client of Python.
    with pliant.open(creature, server=server) as session:
        low, size = rest.min(axis=0).astype(float), np.ptp(rest, axis=0).astype(float)
        session.handle("feet", half_space=((0, -1, 0), -(low[1] + 0.1 * size[1])))
        session.handle("head", sphere=(low + (0.82, 0.8, 0.5) * size, 0.2 * size.max()))
        session.solve({"head": {"translation": (0, 0.1 * size.max(), 0), "rotation_degrees": (0, 40, 0)}})
        assert np.array_equal(session.positions(), posed)


def test_only_what_changed_runs_and_what_ran_before_does_not_show(
    executor: Executor, nod: dict[str, Any], server: pliant.LocalServer, tmp_path: Path
) -> None:
    first = positions(Path(executor.run(nod)["7"][0]), server)
    assert executor.ran == ["1", "2", "3", "4", "5", "6", "7"]
    executor.run(nod)
    assert executor.ran == []
    nod["4"]["inputs"]["turn_y"] = -60.0
    other = positions(Path(executor.run(nod)["7"][0]), server)
    assert executor.ran == ["4", "5", "6", "7"] and not np.array_equal(other, first)
    nod["4"]["inputs"]["turn_y"] = 40.0
    assert np.array_equal(positions(Path(executor.run(nod)["7"][0]), server), first)
    # A handle more changes where others turn about; taken away again, all is as it was.
    more = json.loads(json.dumps(nod))
    more["3"]["inputs"]["model"] = ["8", 0]
    more["8"] = {"class_type": "PliantNameHandle", "inputs": {**nod["3"]["inputs"], "name": "tail", "x": 0.1, "y": 0.7}}
    executor.run(more)
    assert np.array_equal(positions(Path(executor.run(nod)["7"][0]), server), first)
    # A server that has lost the session gets the model again.
    with pliant.connect(server) as client:
        for info in list(client.sessions()):
            client.attach(info.id, keep=False).close()
    nod["4"]["inputs"]["move_y"] = 0.0
    executor.run(nod)
    nod["4"]["inputs"]["move_y"] = 0.1
    assert np.array_equal(positions(Path(executor.run(nod)["7"][0]), server), first)
    # Another file of that name is opened.
    vertices, faces = bar()
    with pliant.open((vertices, faces), server=server) as session:
        (tmp_path / "input/creature.glb").write_bytes(session.export_bytes("glb")[""])
    executor.run(nod)
    assert executor.ran[0] == "1"


def test_every_kind_of_region_and_a_mesh_of_another_node(executor: Executor, server: pliant.LocalServer) -> None:
    vertices, _ = bar()
    place = {"x": 0.5, "y": 0.5, "z": 0.1, "radius": 0.1}
    capsule = json.dumps({"capsule": {"from": [0, 0, 3.9], "to": [0, 0, 4.1], "radius": 0.5}})
    prompt: dict[str, Any] = {
        "mesh": {"class_type": "MakeMesh", "inputs": {}},
        "open": {"class_type": "PliantOpenMesh", "inputs": {"path": "", "mesh": ["mesh", 0]}},
        "low": {"class_type": "PliantNameHandle", "inputs": {"model": ["open", 0], "name": "low", "kind": "z below", **place}},
        "high": {"class_type": "PliantNameHandle", "inputs": {"model": ["low", 0], "name": "high", "kind": "json", "region": capsule, **place}},
        "out": {"class_type": "PliantExportMesh", "inputs": {"model": ["high", 0], "name": "bar", "format": "ply"}},
    }
    moves = {f"{kind}_{axis}": 0.0 for kind in ("move", "turn") for axis in "xyz"}
    prompt["pose"] = {"class_type": "PliantPoseHandle", "inputs": {"model": ["high", 0], "name": "high", "scale": 1.0, **moves, "move_x": 0.25}}
    prompt["out"]["inputs"]["model"] = ["pose", 0]
    posed = positions(Path(executor.run(prompt)["out"][0]), server)
    assert np.array_equal(posed[vertices[:, 2] <= 0.4], vertices[vertices[:, 2] <= 0.4].astype(np.float32))
    top = vertices[:, 2] > 3.9
    assert np.allclose(posed[top], vertices[top] + [1, 0, 0], atol=1e-5), "a quarter of the longest side, which is 4"
    for kind, more in [("sphere", {}), ("x above", {}), ("part", {"part": 0}), ("z above", {"stiffness": 2.0})]:
        other = json.loads(json.dumps(prompt))
        other["high"]["inputs"] = {"model": ["low", 0], "name": "high", "kind": kind, **place, "z": 0.9, **more}
        if kind == "part":
            other["low"]["inputs"]["kind"] = "part"
        assert np.isfinite(positions(Path(executor.run(other)["out"][0]), server)).all()


def test_models_that_are_let_go_free_their_sessions(executor: Executor, nod: dict[str, Any], server: pliant.LocalServer) -> None:
    with pliant.connect(server) as client:
        before = {info.id for info in client.sessions()}
        executor.run(nod)
        assert len({info.id for info in client.sessions()} - before) == 1
        executor.kept.clear()
        gc.collect()
        assert {info.id for info in client.sessions()} <= before


def test_mistakes_are_told(executor: Executor, nod: dict[str, Any]) -> None:
    def fails(id: str, words: str, **inputs: Any) -> None:
        wrong = json.loads(json.dumps(nod))
        wrong[id]["inputs"].update(inputs)
        with pytest.raises(Exception, match=words):
            executor.run(wrong)

    fails("1", "a path or a mesh is needed", path="")
    fails("1", "none.glb", path="none.glb")
    fails("4", "no handle 'hed' before this node; there are feet, head", name="hed")
    fails("3", "handle 'head'", x=5.0)
    fails("7", "is outside of", name="../../posed")
    assert executor.run(nod)["7"], "the model is as it was"
