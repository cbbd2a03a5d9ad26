"""What is said before anything is sent: poses, regions, options, models, addresses."""

from __future__ import annotations

import inspect
import io
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import pliant
from pliant import channel, edits, model, regions
from pliant.books import Books, as_entries
from pliant.declared import to_drag
from pliant.options import create_options, options
from pliant.poses import entries, lay_on, to_message
from pliant.v1 import pliant_pb2 as pb


def rotation(axis: list[float], angle: float) -> np.ndarray:
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + math.sin(angle) * cross + (1 - math.cos(angle)) * cross @ cross


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 2, 2.5, math.pi, 3.5, 6.0])
@pytest.mark.parametrize("axis", [[1, 0, 0], [0, 1, 0], [0, 0, 1], [1, 2, 3], [-3, 1, 0.1]])
def test_a_matrix_becomes_the_pose_that_moves_points_alike(axis: list[float], angle: float) -> None:
    scale = np.array([0.5, 1.0, 2.0])
    matrix = np.eye(4)
    matrix[:3, :3] = rotation(axis, angle) * scale
    matrix[:3, 3] = [1, -2, 3]
    pose = to_message(matrix)
    x, y, z, w = pose.rotation
    unit = np.array([w, x, y, z])
    assert np.linalg.norm(unit) == pytest.approx(1)
    half = 2 * math.atan2(np.linalg.norm([x, y, z]), w)
    turn = rotation([x, y, z], half) if half else np.eye(3)
    assert np.allclose(turn, rotation(axis, angle), atol=1e-9)
    assert np.allclose(pose.scale, scale) and list(pose.translation) == [1, -2, 3] and list(pose.pivot) == [0, 0, 0]


@pytest.mark.parametrize("seed", range(20))
def test_products_of_turns_in_single_precision_scale_nothing(seed: int) -> None:
    random = np.random.default_rng(seed)
    turns = [rotation(random.normal(size=3), random.uniform(-3, 3)).astype(np.float32) for _ in range(4)]
    matrix = np.eye(4)
    matrix[:3, :3] = turns[0] @ turns[1] @ turns[2] @ turns[3]
    rounded = np.linalg.norm(matrix[:3, :3], axis=0)
    assert np.any(rounded != 1) and list(to_message(matrix).scale) == [1, 1, 1]
    matrix[:3, 1] *= 1.00001
    assert list(to_message(matrix).scale) == [1, pytest.approx(1.00001, abs=1e-6), 1]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (np.eye(3), "shape"),
        (np.diag([1, 1, -1, 1]), "mirrors"),
        (np.diag([1, 0, 1, 1]), "flattens"),
        (np.array([[1, 0.5, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]), "shears"),
        (np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 1, 1]]), "last row"),
    ],
)
def test_a_matrix_that_no_pose_can_follow_is_refused(damage: np.ndarray, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        to_message(damage)


def test_vertices_travel_as_runs_and_single_numbers() -> None:
    listed = regions.vertices([9, 3, 4, 5, 6, 7, 20, 21, 9])
    assert [(r.first, r.count) for r in listed.ranges] == [(3, 5)]
    assert list(listed.indices) == [9, 20, 21]
    mask = np.zeros(1000, bool)
    mask[100:900] = True
    listed = regions.vertices(mask)
    assert [(r.first, r.count) for r in listed.ranges] == [(100, 800)] and not listed.indices
    assert not regions.vertices([]).indices


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ({}, "nothing is given"),
        ({"sphere": ((0, 0, 0), 1), "component": 0}, "exactly one"),
        ({"ball": ((0, 0, 0), 1)}, "exactly one"),
        ({"sphere": 1.0}, "center, radius"),
        ({"sphere": ((0, 0), 1)}, "2 numbers, 3 are allowed"),
        ({"vertices": [0.5]}, "indices or a boolean mask"),
        ({"vertices": [-1]}, "indices from 0"),
        ({"vertices": [1 << 40]}, "indices from 0"),
        ({"vertices": [[1, 2], [3, 4]]}, r"shape \(2, 2\), one dimension"),
        ({"vertices": np.ones(5, bool)}, "a mask of 5 values, the model's 9 are allowed"),
        ({"vertices": np.ones((3, 3), bool)}, r"shape \(3, 3\), one dimension"),
        ({"component": 0.5}, "component: 0.5, a whole number from 0"),
        ({"primitive": -1}, "primitive: -1, a whole number from 0"),
        ({"weights": np.ones((3, 3))}, "one dimension"),
        ({"sphere": (("0", "0", "0"), 1)}, "real numbers"),
        ({"tube": ([0, 0, 0], 1)}, "shape"),
    ],
)
def test_a_region_that_makes_no_sense_is_refused_before_it_is_sent(fields: dict[str, object], words: str) -> None:
    with pytest.raises(ValueError, match=words):
        regions.region(fields, 9)
    assert not list(regions.region({"vertices": np.zeros(9, bool)}, 9).vertices.indices)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        (5, "region: 5, a dict"),
        ({"component": True}, "component: True, a number"),
        ({"component": "0"}, "component: '0', a number"),
        ({"sphere": ((0, 0, 0), "1")}, "radius: '1', a number"),
    ],
)
def test_a_region_of_another_type_is_refused_before_it_is_sent(fields: object, words: str) -> None:
    with pytest.raises(TypeError, match=words):
        regions.region(fields)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("poses", "words"),
    [
        ([1], r"poses: \[1\], a dict from handle ids"),
        ([], "a dict from handle ids"),
        ({5: {}}, "poses: 5, a handle's id"),
        ({"head": {"turn": 1}}, "pose of 'head': 'turn': no such field of a pose; allowed are translation"),
        ({"head": [0, 1, 0]}, "pose of 'head': .*shape"),
        ({"head": {"translation": (1, 2)}}, "pose of 'head': translation: 2 numbers, 3"),
        ({"head": {"translation": (1j, 0, 0)}}, "pose of 'head': translation: .*complex128"),
        ({"head": {"pivot": (None, 0, 0)}}, "pose of 'head': pivot: .*object"),
        ({"head": np.eye(4) * 1j}, "pose of 'head': .*complex128"),
    ],
)
def test_poses_that_make_no_sense_name_their_handle(poses: object, words: str) -> None:
    with pytest.raises((TypeError, ValueError), match=words):
        as_entries(poses)  # type: ignore[arg-type]


@pytest.mark.parametrize("commit", ["first", "", 2, None])
def test_a_drag_records_all_poses_the_last_or_none(commit: object) -> None:
    with pytest.raises(ValueError, match=f'commit: {commit!r}, True, False or "last"'):
        to_drag([], commit)


@pytest.mark.parametrize("poses", [{"head": {}}, "head", 5])
def test_a_drag_takes_several_poses(poses: object) -> None:
    with pytest.raises(TypeError, match="poses: .* a list or an iterator"):
        to_drag(poses, False)


@pytest.mark.parametrize("what", [None, 5, [[0, 0, 0]], io.StringIO("OFF")])
def test_what_is_no_model_is_refused_before_it_is_sent(what: object) -> None:
    with pytest.raises(TypeError, match="^model: "):
        model.read(what)  # type: ignore[arg-type]


def test_every_shape_of_a_region_is_carried() -> None:
    capsule = regions.region({"capsule": ((0, 0, 0), (0, 0, 1), 0.5)}).capsule
    assert list(getattr(capsule, "from")) == [0, 0, 0] and list(capsule.to) == [0, 0, 1] and capsule.radius == 0.5
    assert list(regions.region({"tube": ([[0, 0, 0], [1, 2, 3]], 0.5)}).tube.points) == [0, 0, 0, 1, 2, 3]
    assert list(regions.region({"box": ((0, 0, 0), (1, 1, 1))}).box.max) == [1, 1, 1]
    assert regions.region({"half_space": ((0, 1, 0), 2)}).half_space.offset == 2
    assert regions.region({"component": 3}).component.index == 3
    assert list(regions.region({"weights": [0, 0.5, 1]}).weights.values) == [0, 0.5, 1]


def test_options_know_their_names_and_values() -> None:
    made = options({"tolerance": 1e-6, "refine": 0, "first_pass": "diffusion", "normals": True, "changed_only": 0.0})
    assert made.HasField("refine") and made.first_pass == pb.Options.DIFFUSION
    assert made.output.normals and made.output.HasField("changed_only")
    with pytest.raises(ValueError, match="harmonic"):
        options({"first_pass": "magic"})  # type: ignore[typeddict-item]
    with pytest.raises(TypeError, match="tolerance"):
        options({"tolerence": 1e-6})  # type: ignore[typeddict-unknown-key]
    for fields, words in [
        ({"refine": 0.5}, "refine: 0.5, a whole number"),
        ({"tolerance": "1"}, "tolerance: '1', a number"),
        ({"normals": "no"}, "normals: 'no', True or False"),
        ({"method": 5}, "method: 5, one of"),
    ]:
        with pytest.raises((TypeError, ValueError), match=words):
            options(fields)  # type: ignore[arg-type]
    for fields, words in [({"ttl": 0}, "ttl: 0, text is"), ({"label": b"x"}, "label: "), ({"volume_graph": 5}, "auto")]:
        with pytest.raises(TypeError, match=words):
            create_options(fields)  # type: ignore[arg-type]
    created = create_options({"volume_graph": "off", "weld": 1e-3, "ttl": "1h", "components": "hold"})
    assert created.volume_graph.mode == pb.CreateOptions.VolumeGraph.OFF and created.weld.tolerance == 1e-3
    assert create_options({"volume_graph": {"valence": 8}}).volume_graph.valence == 8
    tied = create_options({"tie_distance": 0.5, "keep_apart": {"primitives": [1], "components": np.array([2, 3])}})
    assert tied.tie_distance == 0.5 and list(tied.keep_apart.components) == [2, 3]
    rigid = create_options({"bone_lengths": "keep", "rigid_chains": ["hips"]})
    assert rigid.bone_lengths == pb.CreateOptions.BoneLengths.KEEP and list(rigid.rigid_chains) == ["hips"]
    with pytest.raises(TypeError, match="a list of names of joints"):
        create_options({"rigid_chains": "hips"})
    assert create_options({"parts": "separate"}).parts == pb.CreateOptions.SEPARATE
    with pytest.raises(TypeError, match="allowed are primitives and components"):
        create_options({"keep_apart": {"parts": [1]}})  # type: ignore[typeddict-unknown-key]


def test_edits_are_carried_by_name() -> None:
    cut = edits.request("id", "rest", {"cut": {"normal": (0, 1, 0), "offset": 0.5, "keep": "above", "fill": True}})
    assert cut.on == pb.EditRequest.REST and cut.cut.keep == pb.EditRequest.Cut.ABOVE and cut.cut.fill
    assert list(cut.cut.plane.normal) == [0, 1, 0] and cut.cut.plane.offset == 0.5
    drawn = edits.request("id", "current", {"cut": {"polyline": [[0, 0, 0], [1, 0, 0], [0, 1, 0]], "closed": True}})
    assert len(drawn.cut.polyline) == 9 and drawn.cut.closed and not drawn.cut.HasField("plane")
    assert list(edits.request("id", "current", {"cut": {"path": np.array([3, 1, 2])}}).cut.path) == [3, 1, 2]
    merge = edits.request("id", "current", {"merge": {"session": "other", "transform": np.arange(16.0).reshape(4, 4)}})
    far = edits.request("id", "current", {"adopt": {"positions": [[1e6, 2, 3.5]]}}, 1, (1e6, 0, 0))
    assert np.frombuffer(far.adopt.positions, "<f4").tolist() == [0, 2, 3.5]
    assert merge.merge.session == "other" and list(merge.merge.transform[:4]) == [0, 4, 8, 12]
    ball = {"region": {"sphere": ((0, 0, 0), 1)}}
    for name in ("subdivide", "decimate", "delete", "fill", "remesh"):
        assert edits.request("id", "current", {name: dict(ball)}).WhichOneof("operation") == name
    assert edits.request("id", "current", {"weld": {}}).WhichOneof("operation") == "weld"
    curve = edits.request("id", "current", {"insert_curve": {"points": [[0, 0, 0], [1, 1, 1]]}})
    assert len(curve.insert_curve.points) == 6
    for wrong in ({}, {"cut": {}, "weld": {}}, {"carve": {}}):
        with pytest.raises(ValueError, match="exactly one"):
            edits.request("id", "current", wrong)
    told = edits.result(
        pb.EditResult(
            before=pb.EditResult.Counts(vertices=6),
            kept=[{"was": 0, "now": 0, "count": 2}, {"was": 4, "now": 2, "count": 2}],
        )
    )
    assert told.now_from_before.tolist() == [0, 1, -1, -1, 2, 3]
    with pytest.raises(TypeError, match="no such setting as distance; allowed are tolerance"):
        edits.request("id", "current", {"weld": {"distance": 1}})
    with pytest.raises(TypeError, match="no such setting as side; allowed are plane, keep, .*, normal, offset"):
        edits.request("id", "current", {"cut": {"normal": (0, 1, 0), "side": "above"}})
    for fields, words in [
        ({"cut": 5}, "cut: 5, a dict"),
        ({"cut": {"path": [0.5, 1]}}, "cut: path: values of type float64, indices"),
        ({"delete": {"region": {"vertices": [True]}}}, "delete: vertices: a mask of 1 values"),
        ({"delete": {"region": ball["region"], "fill": "no"}}, "delete: fill: 'no', True or False"),
        ({"weld": {"tolerance": "1"}}, "weld: tolerance: '1', a number"),
    ]:
        with pytest.raises((TypeError, ValueError), match=words):
            edits.request("id", "current", fields, 9)


REGIONS = [
    ({"vertices": [1, 5, 6, 7, 8]}, {"vertices": {"indices": [1], "ranges": [{"first": 5, "count": 4}]}}),
    ({"half_space": ((0, 1, 0), 0.5)}, {"halfSpace": {"normal": [0, 1, 0], "offset": 0.5}}),
    ({"sphere": ((0, 1, 0), 0.5)}, {"sphere": {"center": [0, 1, 0], "radius": 0.5}}),
    ({"box": ((0, 1, 0), (1, 2, 3))}, {"box": {"min": [0, 1, 0], "max": [1, 2, 3]}}),
    ({"capsule": ((0, 1, 0), (1, 2, 3), 2)}, {"capsule": {"from": [0, 1, 0], "to": [1, 2, 3], "radius": 2}}),
    ({"tube": ([(0, 1, 0), (1, 2, 3)], 2)}, {"tube": {"points": [0, 1, 0, 1, 2, 3], "radius": 2}}),
    ({"component": 3}, {"component": {"index": 3}}),
    ({"primitive": 0}, {"primitive": {"index": 0}}),
    ({"weights": [0, 0.5, 1]}, {"weights": {"values": [0, 0.5, 1]}}),
    ({"anchors": ([7], [(0.5, 0.25, 0.25)])}, {"anchors": {"faces": [7], "weights": [0.5, 0.25, 0.25]}}),
]
SIZE = np.diag([1, 2, 3, 1])
EDITS = [
    ({"cut": {"normal": (0, 1, 0), "offset": 0.5}}, {"cut": {"plane": {"normal": [0, 1, 0], "offset": 0.5}}}),
    ({"cut": {"normal": (0, 1, 0), "keep": "above"}}, {"cut": {"plane": ((0, 1, 0), 0), "keep": "ABOVE"}}),
    ({"cut": {"polyline": [(0, 0, 0), (1, 2, 3)]}}, {"cut": {"polyline": [0, 0, 0, 1, 2, 3]}}),
    ({"cut": {"path": [3, 1], "closed": True}}, {"cut": {"path": [3, 1], "closed": True}}),
    ({"subdivide": {"scheme": "loop"}}, {"subdivide": {"scheme": "LOOP"}}),
    ({"decimate": {"ratio": 0.5}}, {"decimate": {"ratio": 0.5}}),
    ({"delete": {"fill": True}}, {"delete": {"fill": True}}),
    ({"fill": {}}, {"fill": {}}),
    ({"remesh": {"edge_length": 0.1}}, {"remesh": {"edgeLength": 0.1}}),
    ({"smooth": {"kind": "relax"}}, {"smooth": {"kind": "RELAX"}}),
    ({"merge": {"session": "x", "transform": SIZE}}, {"merge": {"session": "x", "transform": SIZE.ravel()}}),
    (
        {"wrap": {"session": "x", "landmarks": [(3, (0, 1, 2))], "in_place": True}},
        {"wrap": {"session": "x", "landmarks": [{"ownVertex": 3, "targetPoint": [0, 1, 2]}], "inPlace": True}},
    ),
    ({"insert_curve": {"points": [(0, 0, 0), (1, 2, 3)]}}, {"insertCurve": {"points": [0, 0, 0, 1, 2, 3]}}),
    ({"weld": {"tolerance": 0.1}}, {"weld": {"tolerance": 0.1}}),
    (
        {"unintersect": {"fixed": {"sphere": ((0, 0, 0), 1)}, "clearance": 0.5}},
        {"unintersect": {"fixed": {"sphere": {"center": [0, 0, 0], "radius": 1}}, "clearance": 0.5}},
    ),
    ({"clean": {"keep_largest": 1}}, {"clean": {"keepLargest": 1}}),
    ({"adopt": {"positions": [(0, 1, 2)]}}, {"adopt": {"positions": "AAAAAAAAgD8AAABA"}}),
]


def test_regions_and_edits_may_be_spelled_as_jobs_spell_them() -> None:
    kinds = {next(iter(here)) for here, _ in REGIONS}
    assert kinds == set(regions.REGIONS) == {field.name for field in pb.Region.DESCRIPTOR.oneofs[0].fields}
    assert {next(iter(here)) for here, _ in EDITS} == set(edits.OPERATIONS)
    for here, job in REGIONS:
        assert regions.region(here) == regions.region(job)
    for here, job in EDITS:
        assert edits.request("id", "rest", here) == edits.request("id", "rest", job)
        (name, settings), (named, spelled) = next(iter(here.items())), next(iter(job.items()))
        if name in ("subdivide", "decimate", "delete", "fill", "remesh"):
            area, area_of_job = REGIONS[1]
            inside = edits.request("id", "rest", {name: {**settings, "region": area}})
            assert inside == edits.request("id", "rest", {named: {**spelled, "region": area_of_job}})
    for wrong, words in [
        ({"cut": {"plane": {"ofset": 1}}}, "cut: plane: no such setting as ofset; allowed are normal, offset"),
        ({"cut": {"plane": 5}}, r"cut: plane: \(normal, offset\) is allowed, or a dict"),
        ({"cut": {"plane": ((0, 1, 0), 0), "normal": (0, 1, 0)}}, "cut: plane is given beside normal"),
        ({"fill": {"region": {"sphere": {"centre": []}}}}, "fill: sphere: no such .* centre; allowed are center, radius"),
        ({"fill": {"region": {"sphere": 5}}}, r"\(center, radius\) is allowed, or a dict of center, radius"),
        ({"fill": {"region": {"halfSpac": ()}}}, "exactly one of vertices, half_space"),
    ]:
        with pytest.raises((TypeError, ValueError), match=words):
            edits.request("id", "rest", wrong)


def test_a_pose_of_three_angles_is_told_what_it_wants() -> None:
    assert to_message({"rotationVector": (0, 1, 0)}) == to_message({"rotation_vector": (0, 1, 0)})
    with pytest.raises(ValueError, match=r"quaternion of 4.*rotation_degrees, such as \(0, 45, 0\).*rotation_vector in radians"):
        to_message(pliant.Pose(rotation=(0, 45, 0)))


def test_degrees_are_radians_in_another_unit() -> None:
    quarter = to_message(pliant.Pose(rotation_vector=(0, np.pi / 2, 0), scale=2))
    assert to_message({"rotation_degrees": (0, 90, 0), "scale": 2}) == quarter
    assert to_message(pliant.Pose(rotation_degrees=np.array([0, 90, 0]), scale=2)) == quarter
    assert list(to_message({"rotation_degrees": (0, 0, 720)}).rotation_vector) == [0, 0, 4 * np.pi], "full turns count"
    for beside in ({"rotation": (0, 0, 0, 1)}, {"rotation_vector": (0, 0, 0)}):
        with pytest.raises(ValueError, match="a pose has one rotation"):
            to_message({"rotation_degrees": (0, 90, 0), **beside})
    with pytest.raises(ValueError, match="rotation_degrees: 4 numbers, 3 are allowed"):
        to_message({"rotation_degrees": (0, 0, 0, 1)})
    with pytest.raises(TypeError, match="allowed are translation.*rotation_degrees, free_rotation"):
        to_message({"rotation_degree": (0, 90, 0)})
    line = [(0, 0, 0), (0, 1, 0)]
    twisted = pliant.GuidePose(line, twists=[0, np.pi])
    assert pliant.GuidePose(line, twist_degrees=[0, 180]).to_message() == twisted.to_message()
    with pytest.raises(ValueError, match="twist_degrees: twists are given"):
        pliant.GuidePose(line, twists=[0, 0], twist_degrees=[0, 0]).to_message()


def test_completion_shows_what_is_for_people() -> None:
    code = "import pliant; print(*dir(pliant))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    shown = done.stdout.split()
    assert set(shown) == {*pliant.__all__, "aio", "errors"}, "no module of the inside; batch and notebook once they are imported"
    assert shown == sorted(shown) and all(hasattr(pliant, name) for name in shown)


def test_arrays_become_a_ply_that_keeps_their_precision() -> None:
    points = np.array([[0, 0, 0], [1 / 3, 0, 0], [0, 1, 0]])
    data = model.ply(points, [[0, 1, 2]])
    assert b"property double x" in data and np.float64(1 / 3).tobytes() in data
    assert b"property float x" in model.ply(points.astype(np.float32), [[0, 1, 2]])
    for vertices, faces, words in [
        (points[:, :2], [[0, 1, 2]], "vertices have shape"),
        (points, [[0.0, 1, 2]], "whole numbers"),
        (points, [[0, 1, 3]], "name vertices 0 to 3 of 3"),
        (points, [0, 1, 2], "shape"),
        (points.astype(str), [[0, 1, 2]], "vertices: values of type .*, real numbers"),
        (points + 0j, [[0, 1, 2]], "vertices: values of type complex128, real numbers"),
    ]:
        with pytest.raises(ValueError, match=words):
            model.ply(vertices, faces)


def test_a_gltf_brings_its_buffers_but_nothing_from_outside_its_folder(tmp_path: Path) -> None:
    inside = tmp_path / "model"
    inside.mkdir()
    (tmp_path / "secret.bin").write_bytes(b"secret")
    (inside / "a b.bin").write_bytes(b"buffer")
    path = inside / "m.gltf"
    (inside / "textures").mkdir()
    (inside / "textures" / "c.png").write_bytes(b"picture")
    buffers = '[{"uri": "a%20b.bin"}, {"uri": "../secret.bin"}, {"uri": "data:,x"}, {}]'
    images = '[{"uri": "./textures/c.png"}, {"uri": "gone.png"}, {"bufferView": 0}]'
    path.write_text(f'{{"buffers": {buffers}, "images": {images}}}')
    upload = model.read(path)
    assert upload.companions == {"a b.bin": b"buffer", "textures/c.png": b"picture"} and upload.format == "gltf"
    requests = list(upload.requests(pb.CreateOptions(), 1 << 20, lambda done, total: None))
    assert [r.WhichOneof("message") for r in requests] == ["options", "chunk"] + 2 * ["companion", "chunk"]
    assert model.read(io.BytesIO(b"OFF")).main == b"OFF"


def test_what_a_gltf_holds_itself_is_no_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # Files of these names exist, so that asking for them would be seen.
    for name in ("data:,x", "DATA:,y"):
        (tmp_path / name).write_bytes(b"a file")
    path = tmp_path / "m.gltf"
    embedded = "data:application/octet-stream;base64," + "AAAA" * 1_000_000
    uris = ["data:,x", "DATA:,y", embedded, "long" * 2000, "nul\\u0000.bin"]
    path.write_text('{"buffers": [' + ", ".join(f'{{"uri": "{uri}"}}' for uri in uris) + "]}")
    asked: list[str] = []
    resolve = Path.resolve
    monkeypatch.setattr(Path, "resolve", lambda self, *rest: (asked.append(str(self)), resolve(self, *rest))[1])
    upload = model.read(path)
    assert upload.companions == {} and upload.label == "m.gltf"
    # Looking for a file whose name is a whole buffer took seconds.
    assert asked == [str(tmp_path)]


def test_an_obj_brings_its_material_libraries_and_their_pictures(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "red paint.png").write_bytes(b"red")
    (tmp_path / "bump.png").write_bytes(b"bump")
    (tmp_path / "secret.png").write_bytes(b"secret")
    library = "newmtl a\nmap_Kd -s 1 1 1 -clamp on maps\\red paint.png\nmap_Bump -bm 0.5 ./bump.png\nmap_d ../secret.png\n"
    (tmp_path / "my things.mtl").write_text(library)
    path = tmp_path / "m.obj"
    path.write_text("mtllib my things.mtl\nv 0 0 0\nusemtl a\n")
    assert sorted(model.read(path).companions) == ["bump.png", "maps/red paint.png", "my things.mtl"]


def test_a_companion_is_never_written_outside_the_folder(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="outside"):
        model.write(tmp_path / "m.gltf", {"": b"{}", "../evil.bin": b""})
    assert [p.name for p in model.write(tmp_path / "m.gltf", {"": b"{}", "x/m.bin": b"1"})] == ["m.gltf", "m.bin"]


def test_paths_of_an_export_are_of_the_kind_that_was_asked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    files = {"": b"{}", "x/m.bin": b"1"}
    assert model.write(Path("out/m.gltf"), files) == [Path("out/m.gltf"), Path("out/x/m.bin")]
    assert model.write(tmp_path / "m.gltf", files) == [tmp_path / "m.gltf", tmp_path / "x/m.bin"]


def test_a_companion_replaces_no_other_bytes_unasked(tmp_path: Path) -> None:
    (tmp_path / "m.bin").write_bytes(b"precious")
    files = {"": b"{}", "m.bin": b"new"}
    with pytest.raises(FileExistsError, match=r"m\.bin"):
        model.write(tmp_path / "m.gltf", files)
    assert not (tmp_path / "m.gltf").exists() and (tmp_path / "m.bin").read_bytes() == b"precious"
    model.write(tmp_path / "m.gltf", files, force=True)
    # The same bytes are no change.
    model.write(tmp_path / "m.gltf", files)
    assert (tmp_path / "m.bin").read_bytes() == b"new"


def test_an_address_says_whether_it_is_tls() -> None:
    assert channel.Settings("localhost:9000").url == "http://localhost:9000"
    assert channel.Settings("https://meshes.example.org").target == "meshes.example.org:443"
    assert channel.Settings("https://meshes.example.org").secure
    assert channel.Settings("http://[::1]:7411").target == "[::1]:7411"
    assert not channel.Settings("http://10.0.0.1:7411").secure
    assert channel.Settings("h:1", token="t").metadata() == (("authorization", "Bearer t"),)
    for wrong in ("ftp://x:1", "http://", "http://host:1/path", "", "two words"):
        with pytest.raises(ValueError, match="HOST:PORT"):
            channel.Settings(wrong)


def test_trying_again_stops_when_patience_ends_and_never_starts_for_what_waiting_cannot_cure() -> None:
    lost = pliant.Unavailable("gone")
    assert channel.Attempts(10).again(lost) is not None
    assert channel.Attempts(0).again(lost) is None
    assert channel.Attempts(10).again(pliant.InvalidArgument("wrong")) is None
    assert channel.Attempts(10).again(pliant.ResourceExhausted("full", retry_after=1)) is None


def test_what_iterates_says_so() -> None:
    for method, items in ((pliant.Client.sessions, "pb.Session"), (pliant.Stream.__iter__, "Frame")):
        assert inspect.signature(method).return_annotation == f"Iterator[{items}]"


def test_an_answer_that_comes_late_does_not_open_a_closed_session() -> None:
    books = Books(pb.Session(id="a"))
    books.closed = True
    books.sent(pb.Session(id="a"))
    books.travelled(pb.Session(id="a"), 0)
    books.edited(pb.Session(id="a"))
    assert books.closed


def test_what_an_export_does_not_hold_is_a_warning_of_python() -> None:
    told = pb.Warning(code="left-out", message="the obj file has not: 1 skin", where="skins/0")
    with pytest.warns(UserWarning, match=r"left-out: the obj file has not: 1 skin \(skins/0\)"):
        model.warn_of([pb.Chunk(data=b"a", warnings=[told]), pb.Chunk(data=b"b")])


def test_targets_are_laid_on_those_that_a_handle_has() -> None:
    held = entries({"scan": pliant.Targets(np.arange(12).reshape(4, 3), [1, 2, 3, 4])})
    lay_on(held, entries({"scan": pliant.Targets(np.zeros((1, 3)), first=2)}))
    whole = held["scan"].targets
    assert np.frombuffer(whole.positions, "<f4").tolist() == [0, 1, 2, 3, 4, 5, 0, 0, 0, 9, 10, 11]
    assert np.frombuffer(whole.weights, "<f4").tolist() == [1, 2, 3, 4]
    assert not whole.HasField("first")
    # Parts that follow each other are one, the way a stream takes them.
    held = entries({"scan": pliant.Targets(np.zeros((2, 3)), first=0)})
    lay_on(held, entries({"scan": pliant.Targets(np.ones((1, 3)), first=2)}))
    whole = held["scan"].targets
    assert (whole.first, np.frombuffer(whole.positions, "<f4").tolist()) == (0, [0] * 6 + [1] * 3)
    with pytest.raises(ValueError, match="follow each other"):
        lay_on(held, entries({"scan": pliant.Targets(np.ones((1, 3)), first=7)}))
    with pytest.raises(ValueError, match="positions"):
        entries({"scan": pliant.Targets([[1, 2]])})
    with pytest.raises(ValueError, match="weights"):
        entries({"scan": pliant.Targets(np.zeros((3, 3)), [1, 2])})


def test_one_weight_is_for_all_and_targets_are_relative_to_the_origin() -> None:
    held = entries({"scan": pliant.Targets(np.zeros((3, 3)), 0.5)})
    lay_on(held, entries({"scan": pliant.Targets(np.ones((1, 3)), [2.0], first=1)}))
    assert np.frombuffer(held["scan"].targets.weights, "<f4").tolist() == [0.5, 2.0, 0.5]
    alone = entries({"scan": pliant.Targets(weights=0.5)})["scan"].targets
    assert (np.frombuffer(alone.weights, "<f4").tolist(), alone.positions) == ([0.5], b"")
    with pytest.raises(ValueError, match="beside first"):
        entries({"scan": pliant.Targets(weights=0.5, first=1)})
    far = entries({"scan": pliant.Targets([[5e6 + 0.123, 1.0, 2.0]])}, [5e6, 0.0, 0.0])["scan"].targets
    assert np.allclose(np.frombuffer(far.positions, "<f4"), [0.123, 1.0, 2.0], atol=1e-6)
