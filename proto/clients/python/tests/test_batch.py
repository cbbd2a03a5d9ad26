"""Batches: many jobs on executors whose workers die, jobs that fail, batches that go on."""

from __future__ import annotations

import importlib.util
import json
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

import pliant
import pliant.batch
from conftest import ROOT, bar, binary, deform
from pliant.batch import BatchReport, Job
from test_companions import bar_gltf

MODEL = pliant.model.ply(*bar())


@pytest.fixture(autouse=True)
def own_servers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PLIANT_BIN", binary())
    monkeypatch.delenv("PLIANT_SERVER", raising=False)


def bend(k: int, **more: Any) -> dict[str, Any]:
    """A job of the bar: no two numbers make the same shape."""
    turn = {"rotationVector": [0, 0.02 * (k + 1), 0], "translation": [0.01 * k, 0, 0]}
    return {
        "handles": [
            {"id": "base", "region": {"halfSpace": {"normal": [0, 0, -1], "offset": -0.2}}},
            {"id": "top", "region": {"halfSpace": {"normal": [0, 0, 1], "offset": 3.8}}},
        ],
        "steps": [{"pose": {"handles": [{"id": "top", "pose": turn}]}}],
        **more,
    }


def glb_of_two() -> bytes:
    """The bar, and the same beside it as a second primitive."""
    vertices, faces = bar()
    points = [part.astype("<f4") for part in (vertices, vertices + [0.9, 0, 0])]
    indices = faces.astype("<u4")
    chunk = b"".join(part.tobytes() for part in (*points, indices))
    size = points[0].nbytes
    document = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": k}, "indices": 2} for k in range(2)]}],
        "buffers": [{"byteLength": len(chunk)}],
        "bufferViews": [
            {"buffer": 0, "byteLength": size},
            {"buffer": 0, "byteOffset": size, "byteLength": size},
            {"buffer": 0, "byteOffset": 2 * size, "byteLength": indices.nbytes},
        ],
        "accessors": [
            {
                "bufferView": k,
                "componentType": 5126,
                "count": len(part),
                "type": "VEC3",
                "min": part.min(0).tolist(),
                "max": part.max(0).tolist(),
            }
            for k, part in enumerate(points)
        ]
        + [{"bufferView": 2, "componentType": 5125, "count": indices.size, "type": "SCALAR"}],
    }
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    parts = [(b"JSON", text), (b"BIN\0", chunk)]
    body = b"".join(len(data).to_bytes(4, "little") + kind + data for kind, data in parts)
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(body)).to_bytes(4, "little") + body


def jobs(count: int) -> list[Job]:
    return [Job(f"bend_{k:03}", MODEL, bend(k)) for k in range(count)]


def in_one_process(count: int) -> BatchReport:
    """What every other way to run them must come to."""
    with ThreadPoolExecutor(1) as pool:
        return pliant.batch.run(jobs(count), executor=pool, keys={"threads": 1}).report().check()


def never() -> Executor:
    raise AssertionError("there is nothing to run")


def kill(worker: str) -> None:
    os.kill(int(worker.rpartition(":")[2]), signal.SIGKILL)


def with_a_worker_killed(batch: pliant.batch.Batch, after: int) -> BatchReport:
    """The report, after the worker that made the `after`th result was killed; every result comes once."""
    names = []
    for result in batch:
        names.append(result.name)
        if len(names) == after:
            kill(result.worker)
    report = batch.report()
    assert sorted(names) == sorted(result.name for result in report), "all results, once each"
    return report


@pytest.mark.parametrize(
    "count", [24, pytest.param(200, marks=pytest.mark.skipif("not os.environ.get('PLIANT_LONG')"))]
)
def test_a_killed_worker_costs_no_result(count: int, tmp_path: Path) -> None:
    told: list[tuple[int, int]] = []
    tell: Callable[[int, int], None] = lambda done, total: told.append((done, total))
    batch = pliant.batch.run(jobs(count), workers=2, results=tmp_path, progress=tell)
    report = with_a_worker_killed(batch, count // 3).check()
    assert report.lost >= 1 and report.resumed == 0
    assert any(result.tries > 1 for result in report), "jobs that were under way were run again"
    assert report.digests == in_one_process(count).digests
    assert len(set(report.digests.values())) == count
    assert told == [(k, count) for k in range(count + 1)]
    assert len(list(tmp_path.glob("*/model.ply"))) == count
    assert not list(tmp_path.glob("**/*.part"))


def test_results_are_those_of_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "bar.ply").write_bytes(MODEL)
    (tmp_path / "lid.ply").write_bytes(MODEL)
    twice = bend(3)
    placed = [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 3, 0, 0, 1]
    twice["steps"] += [
        {"edit": {"subdivide": {}}},
        {"edit": {"merge": {"file": "lid.ply", "how": "LOOSE", "transform": placed}}},
    ]
    posed = bend(5, expect={"flippedTriangles": 0, "maxDistance": 1})
    posed["handles"][1]["pose"] = posed.pop("steps")[0]["pose"]["handles"][0]["pose"]
    wrapped = {"steps": [{"edit": {"wrap": {"file": "lid.ply"}}}]}
    for name, job in {"edited": twice, "wrapped": wrapped, "posed": posed}.items():
        said = deform(tmp_path / "bar.ply", job, tmp_path)
        # Some as a file, which may name others; one as a dict.
        given = job if name == "posed" else tmp_path / "job.json"
        with ThreadPoolExecutor(1) as pool:
            made = pliant.batch.run([Job(name, tmp_path / "bar.ply", given)], executor=pool).report().check()[name]
        assert made.digest == said["digest"]
        assert made.files["model.ply"] == (tmp_path / "out.ply").read_bytes()
    assert made.quality is not None and made.quality.flipped_triangles == 0
    assert made.unchecked == ("maxDistance needs a stored result",)


def test_what_rides_along_is_where_the_command_line_has_it(tmp_path: Path) -> None:
    vertices, faces = bar()
    (tmp_path / "bar.ply").write_bytes(MODEL)
    (tmp_path / "hull.ply").write_bytes(pliant.model.ply(1.1 * vertices, faces))
    along = bend(40)
    along["create"] = {
        "passengers": [
            {"name": "hat", "points": {"positions": [0, 0, 4.2, 0.4, 0, 2], "rotations": [0, 0, 0, 1, 0, 0.6, 0, 0.8]}},
            {"name": "hull", "file": {"file": "hull.ply", "output": "parts/hull.ply"}},
        ]
    }
    # An edit makes the bent shape the rest pose, of what rides along too.
    along["steps"] = [*along["steps"], {"edit": {"subdivide": {}}}, *along["steps"]]
    said = deform(tmp_path / "bar.ply", along, tmp_path)
    job = Job("along", tmp_path / "bar.ply", tmp_path / "job.json")
    with ThreadPoolExecutor(1) as pool:
        made = pliant.batch.run([job], executor=pool, results=tmp_path / "out").report().check()["along"]
        again = pliant.batch.run([job], executor=pool, results=tmp_path / "out").report().check()["along"]
    assert made.digest == said["digest"]
    hat, hull = made.passengers
    told = said["passengers"][0]
    assert (hat.name, list(hat.positions)) == ("hat", told["positions"])
    assert list(hat.rotations) == told["rotations"] and list(hat.scales) == told["scales"]
    assert abs(hat.positions[0]) > 0.1, "it moved"
    assert (hull.name, hull.output) == ("hull", said["passengers"][1]["output"])
    assert [str(path.relative_to(tmp_path / "out" / "along")) for path in made.paths] == ["model.ply", "parts/hull.ply"]
    carried, expected = (
        pliant.model.read(path).main for path in (made.paths[1], tmp_path / "parts" / "hull.ply")
    )
    assert len(carried) == len(expected) and carried != (tmp_path / "hull.ply").read_bytes()
    assert again.resumed and again.passengers == made.passengers and again.paths == made.paths
    # Without an edit between, to the bit.
    along["steps"] = along["steps"][:1]
    deform(tmp_path / "bar.ply", along, tmp_path)
    with ThreadPoolExecutor(1) as pool:
        made = pliant.batch.run([job], executor=pool).report().check()["along"]
    assert made.files["parts/hull.ply"] == (tmp_path / "parts" / "hull.ply").read_bytes()


def test_files_beside_a_model_travel_with_it(tmp_path: Path) -> None:
    path = bar_gltf(tmp_path / "in")
    said = deform(path, bend(4), tmp_path, "out/bar.gltf")
    beside = {str(p.relative_to(path.parent)): p.read_bytes() for p in path.parent.rglob("*.*") if p != path}
    given = [
        Job("path", path, bend(4)),
        Job("bytes", path.read_bytes(), bend(4), companions=beside, format="gltf"),
    ]
    with ThreadPoolExecutor(1) as pool:
        report = pliant.batch.run(given, executor=pool, results=tmp_path / "made").report().check()
    assert set(report.digests.values()) == {said["digest"]}
    written = {str(p.relative_to(tmp_path / "out")): p.read_bytes() for p in (tmp_path / "out").rglob("*.*")}
    assert len(written) == 1 + len(beside)
    for name in ("path", "bytes"):
        folder = tmp_path / "made" / name
        made = {str(p.relative_to(folder)): p.read_bytes() for p in report[name].paths}
        made["bar.gltf"] = made.pop("model.gltf")
        pictures = [uri for uri in beside if not uri.endswith(".bin")]
        assert len(pictures) == 2 and all(made[uri] == beside[uri] for uri in pictures)
        assert len(made) == len(written)


def test_passengers_of_the_model_ride_in_a_batch(tmp_path: Path) -> None:
    (tmp_path / "bar.glb").write_bytes(glb_of_two())
    riding = bend(40, create={"passengers": [{"primitive": 1}]})
    said = deform(tmp_path / "bar.glb", riding, tmp_path, "out.glb")
    with ThreadPoolExecutor(1) as pool:
        made = pliant.batch.run([Job("riding", tmp_path / "bar.glb", riding)], executor=pool).report().check()["riding"]
        loose = pliant.batch.run([Job("loose", tmp_path / "bar.glb", bend(40))], executor=pool).report()["loose"]
    assert made.digest == said["digest"] and made.digest != loose.digest
    assert made.files["model.glb"] == (tmp_path / "out.glb").read_bytes()
    assert made.passengers == ()


@pytest.mark.parametrize(
    ("file", "words"),
    [
        ({"model": "b2Zm", "format": "off", "output": "hull.obj"}, "its own format, off"),
        ({"model": "b2Zm", "output": "hull.off"}, "the format that `format` names"),
        ({"model": "b2Zm", "format": "off", "output": "../hull.off"}, "a path of plain names"),
        ({"model": "b2Zm", "format": "off"}, "a path of plain names"),
        ({"model": "cGx5Cg==", "output": "model.ply"}, "which another file of the result has"),
    ],
)
def test_what_cannot_ride_in_a_batch_is_told(file: dict[str, str], words: str) -> None:
    job = bend(0, create={"passengers": [{"primitive": 0}, {"file": file}]})
    with ThreadPoolExecutor(1) as pool:
        error = pliant.batch.run([Job("along", MODEL, job)], executor=pool).report()["along"].error
    assert error is not None and error.where == "job: create.passengers[1].file.output"
    assert words in str(error)


def test_a_job_that_fails_is_told_and_the_others_finish(tmp_path: Path) -> None:
    wrong = bend(0)
    wrong["steps"][0]["pose"]["handles"][0]["id"] = "tpo"
    (tmp_path / "outside.json").write_text(json.dumps({"steps": [{"edit": {"merge": {"file": "../x.ply"}}}]}))
    bad = [
        Job("pose", MODEL, wrong),
        Job("schema", MODEL, {"handels": []}),
        Job("missing", tmp_path / "none.glb", bend(0)),
        Job("model", b"ply and nothing more", bend(0)),
        Job("outside", MODEL, tmp_path / "outside.json"),
        Job("unmet", MODEL, bend(0, expect={"digest": "xxh3:0000000000000000"})),
    ]
    report = pliant.batch.run(bad[:3] + jobs(4) + bad[3:], workers=1, results=tmp_path / "out").report()
    assert {result.name for result in report.failed} == {job.name for job in bad}
    assert [result.name for result in report if result.ok] == [job.name for job in jobs(4)]
    errors = {result.name: result.error for result in report.failed if result.error is not None}
    assert errors["pose"].where == "steps[0]" and errors["pose"].field == "pose.handles[0].id"
    assert str(errors["pose"]).startswith("pose: steps[0]: pose.handles[0].id: ")
    assert errors["schema"].where == "job" and "handels" in str(errors["schema"]) and "handles" in str(errors["schema"])
    assert errors["missing"].code == "NOT_FOUND" and "none.glb" in str(errors["missing"])
    assert errors["model"].where == "model" and errors["model"].code == "INVALID_ARGUMENT"
    assert errors["outside"].where.endswith("steps[0].edit.merge.file") and "below the job's folder" in str(
        errors["outside"]
    )
    assert "expected xxh3:0000000000000000" in report["unmet"].unmet[0]
    assert report.lost == 0, "what the job is to blame for is not tried again"
    with pytest.raises(pliant.batch.BatchFailed, match=r"6 of 10 jobs failed: pose: steps\[0\]"):
        report.check()


def test_a_batch_goes_on_where_it_was(tmp_path: Path) -> None:
    with pliant.batch.run(jobs(8), workers=1, results=tmp_path) as broken_off:
        first = [next(broken_off).name for _ in range(3)]
    done = {path.parent.name for path in tmp_path.glob("*/result.json")}
    assert set(first) <= done and len(done) < 8
    whole = pliant.batch.run(jobs(8), workers=1, results=tmp_path).report().check()
    assert {result.name for result in whole if result.resumed} == done
    assert all(result.tries == (0 if result.resumed else 1) for result in whole)
    assert whole.digests == in_one_process(8).digests

    again = pliant.batch.run(jobs(8), executor=never, results=tmp_path).report().check()
    assert again.resumed == 8 and again.digests == whole.digests
    assert [result.paths for result in again] == [result.paths for result in whole]
    assert [result.quality for result in again] == [result.quality for result in whole]

    # Another job by the same name is another job, and `resume=False` believes nothing.
    other = [Job("bend_000", MODEL, bend(77)), *jobs(8)[1:]]
    changed = pliant.batch.run(other, workers=1, results=tmp_path).report().check()
    assert [result.name for result in changed if not result.resumed] == ["bend_000"]
    assert changed["bend_000"].digest != whole["bend_000"].digest
    assert pliant.batch.run(jobs(2), workers=1, results=tmp_path, resume=False).report().check().resumed == 0


@pytest.mark.parametrize("harm", ["model", "gone", "record", "list", "other version"])
def test_a_broken_result_is_made_anew(harm: str, tmp_path: Path) -> None:
    with ThreadPoolExecutor(1) as pool:
        before = pliant.batch.run(jobs(2), executor=pool, results=tmp_path).report().check()
        model, record = tmp_path / "bend_001/model.ply", tmp_path / "bend_001/result.json"
        whole = model.read_bytes()
        if harm == "model":
            model.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]))
        elif harm == "gone":
            model.unlink()
        elif harm == "list":
            record.write_text("[]")
        elif harm == "record":
            record.write_bytes(record.read_bytes()[:40])
        else:
            record.write_text(record.read_text().replace('"key": "sha256:', '"key": "sha256:0'))
        after = pliant.batch.run(jobs(2), executor=pool, results=tmp_path).report().check()
    assert [result.resumed for result in after] == [True, False]
    assert after.digests == before.digests and model.read_bytes() == whole


class Poison(ThreadPoolExecutor):
    """Loses the worker of one job, always."""

    asked: list[str] = []

    def submit(self, fn: Any, /, *args: Any, **named: Any) -> Any:
        if args and getattr(args[0], "name", "") == "bend_001":
            Poison.asked.append("bend_001")
            return super().submit(self._die)
        return super().submit(fn, *args, **named)

    @staticmethod
    def _die() -> None:
        raise OSError("the worker is gone")


def test_a_job_that_ends_its_workers_is_given_up() -> None:
    Poison.asked = []
    with Poison(1) as pool:
        report = pliant.batch.run(jobs(4), executor=pool, retries=3).report()
    assert [result.name for result in report.failed] == ["bend_001"] and len(Poison.asked) == 4 == report.lost
    error = report["bend_001"].error
    assert (
        error is not None
        and error.code == "UNAVAILABLE"
        and "the worker is gone (4 tries, the last one alone)" in str(error)
    )


class Counting(ThreadPoolExecutor):
    """Notes how many calls it holds at once."""

    held, most = 0, 0

    def submit(self, fn: Any, /, *args: Any, **named: Any) -> Any:
        self.held += 1
        self.most = max(self.most, self.held)
        future = super().submit(fn, *args, **named)
        future.add_done_callback(lambda _: setattr(self, "held", self.held - 1))
        return future


def test_so_many_jobs_are_in_flight(server: pliant.LocalServer) -> None:
    with Counting(2) as pool:
        report = pliant.batch.run(jobs(12), executor=pool, server=server, in_flight=3).report().check()
        assert pool.most == 3
    assert report.digests == in_one_process(12).digests, "a server that is named gives the same bits"


def test_what_makes_no_sense_is_refused_before_anything_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    one = jobs(1)
    for wrong, words in [
        (lambda: pliant.batch.run(one * 2), r"jobs\[1\].name: 'bend_000' is as jobs\[0\]"),
        (lambda: pliant.batch.run([Job("../a", MODEL, {})]), r"jobs\[0\].name: '../a'.*are allowed"),
        (lambda: pliant.batch.run([Job("a", MODEL, {}, format="fbx")]), r"jobs\[0\].format: 'fbx', one of glb"),
        (lambda: pliant.batch.run(one, workers=0), "workers: 0, 1 to 1000 is allowed"),
        (lambda: pliant.batch.run(one, in_flight=0), "in_flight: 0, 1 to 10000 is allowed"),
        (lambda: pliant.batch.run(one, retries=0), "retries: 0, 1 to 100 is allowed"),
        (lambda: pliant.batch.run(one, server="http://h:1", keys={"threads": 1}), "keys: "),
    ]:
        with pytest.raises(ValueError, match=words):
            wrong()
    with pytest.raises(TypeError, match=r"jobs\[0\]: 'a.glb', a pliant.batch.Job is allowed"):
        pliant.batch.run(["a.glb"])  # type: ignore[list-item]
    forks = ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("fork"))
    with pytest.raises(ValueError, match="gRPC does not survive"):
        pliant.batch.run(one, executor=forks)
    monkeypatch.setenv("PLIANT_BIN", "/nowhere/pliant")
    with pytest.raises(pliant.batch.WorkersLost, match="no worker can work: .*'/nowhere/pliant'"):
        pliant.batch.run(one, workers=1).report()


#: How the recipes of the page begin, and what they need.
RECIPES = {
    "processes": ("import pliant.batch from", "pliant"),
    "dask": ("from distributed import", "distributed"),
    "ray": ("import ray import", "ray"),
}


@pytest.mark.parametrize("recipe", RECIPES)
def test_a_recipe_of_the_page_works(recipe: str, creature: Path, tmp_path: Path) -> None:
    begins, needed = RECIPES[recipe]
    if importlib.util.find_spec(needed) is None:
        pytest.skip(f"{needed} is not installed: pip install {needed}")
    page = ROOT / "deploy/docs/batches.md"
    if not page.is_file():
        pytest.skip("the pages are not here: this is not a checkout")
    blocks = re.findall(r"^```python[^\n]*\n(.*?)^```$", page.read_text(), re.MULTILINE | re.DOTALL)
    (block,) = [text for text in blocks if " ".join(text.split()[:3]) == begins]
    (tmp_path / "batch_jobs.py").write_text(blocks[0])
    (tmp_path / "recipe.py").write_text(block)
    shutil.copy(creature, tmp_path / "creature.glb")
    for before in (0, 24):
        command = [sys.executable, "recipe.py"]
        # Workers of clusters find what their caller's folder holds.
        environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]),
        }
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert f"24 jobs, {before} finished before, 0 failed, 0 tries lost" in done.stdout
    assert len(list(tmp_path.glob("turned/*/model.glb"))) == 24


@contextmanager
def on_dask() -> Iterator[Executor]:
    if importlib.util.find_spec("distributed") is None:
        pytest.skip("distributed is not installed: pip install distributed")
    import distributed

    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        with distributed.Client(cluster) as client:
            yield client.get_executor()


@contextmanager
def on_ray() -> Iterator[Executor]:
    if importlib.util.find_spec("ray") is None:
        pytest.skip("ray is not installed: pip install ray")
    import ray

    ray.init(num_cpus=2, include_dashboard=False, log_to_driver=False)
    try:
        with pliant.batch.RayExecutor() as executor:
            yield executor
    finally:
        ray.shutdown()


@pytest.mark.parametrize("cluster", [on_dask, on_ray], ids=["dask", "ray"])
@pytest.mark.parametrize(
    "count", [24, pytest.param(200, marks=pytest.mark.skipif("not os.environ.get('PLIANT_LONG')"))]
)
def test_a_cluster_loses_a_worker(cluster: Any, count: int, tmp_path: Path) -> None:
    with cluster() as executor:
        batch = pliant.batch.run(jobs(count), executor=executor, keys={"threads": 1}, results=tmp_path)
        report = with_a_worker_killed(batch, count // 3).check()
    assert len({result.worker for result in report}) >= 2
    assert report.digests == in_one_process(count).digests
