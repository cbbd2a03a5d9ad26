"""Sessions against the real server: from a model to its export, handles, commits, and the errors in between."""

from __future__ import annotations

import base64
import io
import json
import sys
import zlib
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest

import pliant
from pliant import preview
from conftest import bar, deform

FEET = {"half_space": ((0, -1, 0), -0.14)}
HEAD = {"sphere": ((0.76, 1.22, 0), 0.36)}
TURN = {"head": {"rotation_vector": (0, 0.8, 0)}}


@pytest.fixture
def held(server: pliant.LocalServer, creature: Path):
    """The creature with feet and head held."""
    with pliant.open(creature, server=server) as session:
        session.handle("feet", **FEET)
        session.handle("head", **HEAD)
        yield session


def test_a_pose_is_solved_exported_and_undone(held: pliant.Session, creature: Path, tmp_path: Path) -> None:
    rest = held.positions()
    assert rest.shape == (held.vertices, 3) and rest.dtype == np.float32
    bent = held.solve(TURN, tolerance=1e-6)
    assert bent.shape == rest.shape and np.abs(bent - rest).max() > 0.1
    assert np.array_equal(held.positions(), bent)
    [written] = held.export(tmp_path / "bent.glb")
    assert written.read_bytes()[:4] == b"glTF" and written.read_bytes() != creature.read_bytes()
    held.undo()
    assert np.array_equal(held.positions(), rest)
    assert held.export_bytes() == {"": creature.read_bytes()}
    held.redo()
    assert np.array_equal(held.positions(), bent)
    history = held.history()
    assert [c.kind for c in history] == ["create", "handles", "pose"] and history[-1].current
    with pytest.raises(pliant.FailedPrecondition):
        held.redo()


def test_points_and_models_ride_along(held: pliant.Session) -> None:
    rest = held.positions()
    hat = np.array([0.8, 1.6, 0.0])
    still = held.carry([hat, (0.0, -0.3, 0.0)])
    assert np.array_equal(still.positions, [hat, (0.0, -0.3, 0.0)]) and np.all(still.scales == 1)
    bent = held.solve(TURN, tolerance=1e-6)
    on_head = held.carry(rest[np.linalg.norm(rest - [0.76, 1.22, 0], axis=1) < 0.3])
    assert np.allclose(
        on_head.positions, bent[np.linalg.norm(rest - [0.76, 1.22, 0], axis=1) < 0.3], atol=1e-5
    ), "what lies on the surface stays on it"
    half = np.sin(0.4)
    turned = held.carry(hat, rotations=[(half, 0, 0, np.cos(0.4))])
    assert turned.positions.shape == (1, 3) and turned.rotations.shape == (1, 4)
    # Turned about the vertical axis after the turn that it had.
    quarter = np.array([half * np.cos(0.4), half * np.cos(0.4), -half * half, np.cos(0.4) ** 2])
    assert abs(turned.rotations[0] @ quarter) > 0.999
    hull = b"OFF\n3 1 0\n0.7 1.5 0\n0.8 1.6 0\n0.9 1.5 0\n3 0 1 2\n"
    carried = held.carry_model(hull)
    assert carried.startswith(b"OFF") and carried != hull
    with pytest.raises(pliant.InvalidArgument, match="model"):
        held.carry_model(b"no model")
    # A splat without a rotation.
    splat = np.array([0.8, 1.6, 0, 0.1, 0.1, 0.1], "<f4").tobytes() + bytes([255] * 4 + [128] * 4)
    with pytest.warns(UserWarning, match="splats-unsound"):
        assert len(held.carry_model(splat, "splat")) == len(splat)
    for wrong in ([1, 2], [[0, 0, np.nan]], np.zeros((2, 2, 3))):
        with pytest.raises((ValueError, pliant.InvalidArgument), match="points"):
            held.carry(wrong)


def test_triangles_of_a_ply_of_any_form_are_found(server: pliant.LocalServer) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 5\nproperty double x\nproperty double y\nproperty double z\n"
    text = f"{head}element face 2\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n.5 .5 1\n4 0 1 2 3\n3 0 1 4\n"
    with pliant.open(text.encode(), server=server) as session:
        triangles, points = session.triangles(), session.positions()
        corners = points[triangles].astype(float)
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        assert triangles.shape == (3, 3) and np.isclose(areas[:2].sum(), 1.0)
        assert session.preview().startswith(b"\x89PNG")


def test_triangles_are_found_behind_points_that_no_file_of_triangles_has(server: pliant.LocalServer) -> None:
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4")
    faces = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]], "<u2")
    marks = np.array([[0.2, 0.2, 0], [0, 0.2, 0.2]], "<f4")
    data = marks.tobytes() + corners.tobytes() + faces.tobytes()
    views = [(0, 24), (24, 48), (72, 24)]
    document = {
        "asset": {"version": "2.0"},
        "buffers": [{"byteLength": len(data), "uri": "data:application/octet-stream;base64," + base64.b64encode(data).decode()}],
        "bufferViews": [{"buffer": 0, "byteOffset": first, "byteLength": size} for first, size in views],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 2, "type": "VEC3", "min": [0, 0.2, 0], "max": [0.2, 0.2, 0.2]},
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 1]},
            {"bufferView": 2, "componentType": 5123, "count": 12, "type": "SCALAR"},
        ],
        "meshes": [{"primitives": [{"mode": 0, "attributes": {"POSITION": 0}}, {"attributes": {"POSITION": 1}, "indices": 2}]}],
        "nodes": [{"mesh": 0}],
        "scenes": [{"nodes": [0]}],
        "scene": 0,
    }
    with pliant.open(json.dumps(document).encode(), server=server) as session:
        assert np.array_equal(session.positions()[session.triangles()], corners[faces])


def test_a_mesh_and_a_scene_of_trimesh_go_in_and_come_out(server: pliant.LocalServer) -> None:
    trimesh = pytest.importorskip("trimesh")
    ball = trimesh.creation.icosphere(subdivisions=2)
    with pliant.open(ball, server=server) as session:
        assert np.array_equal(session.triangles(), ball.faces)
        session.handle("all", half_space=((0, 0, 1), -9))
        session.solve({"all": {"translation": (1, 0, 0)}})
        moved = session.to_trimesh()
        assert np.abs(moved.vertices - ball.vertices - [1, 0, 0]).max() < 1e-6 and np.array_equal(moved.faces, ball.faces)
    scene = trimesh.Scene([ball, trimesh.creation.box().apply_translation([3, 0, 0])])
    with pliant.open(scene, server=server) as session:
        assert len(session.info.primitives) == 2
        both = session.to_trimesh()
        assert np.allclose(both.bounds, scene.bounds) and len(both.faces) == len(session.triangles()) == len(ball.faces) + 12
    with pliant.connect(server) as client:
        assert repr(client) == f"<pliant.Client of {client.url}>"


def test_degrees_turn_as_radians_do(held: pliant.Session) -> None:
    frame = held.solve_frame({"head": {"rotation_vector": (0, np.radians(40), 0)}})
    by_radians = frame.positions
    assert repr(frame).startswith(f"<pliant.SolvedFrame 0: {held.vertices} vertices, revision 3, final, residual "), repr(frame)
    held.undo()
    assert np.array_equal(held.solve({"head": {"rotation_degrees": (0, 40, 0)}}), by_radians)
    held.handle("head", **HEAD, rotation_degrees=(0, 40, 0))
    held.apply()
    [head] = [handle.pose for handle in held.info.handles if handle.id == "head"]
    assert list(head.rotation_vector) == [0, np.radians(40), 0]


def test_a_lattice_and_a_curve_lead_a_model(creature: Path, server: pliant.LocalServer) -> None:
    with pliant.open(creature, server=server) as session:
        rest = session.positions()
        everything = {"vertices": np.ones(len(rest), bool)}
        box = pliant.Lattice(origin=rest.min(0), edges=rest.max(0) - rest.min(0), counts=(3, 2, 2))
        session.handle("body", stiffness=1000, guide=box, **everything)
        affine = np.array([[1.2, 0.1, 0], [0, 0.9, 0], [0.1, 0, 1]])
        led = session.solve({"body": pliant.GuidePose(box.points @ affine + [0, 1, 0])})
        assert np.abs(led - (rest @ affine + [0, 1, 0])).max() < 0.01
        assert np.abs(session.solve({"body": pliant.GuidePose(box.points)}) - rest).max() < 1e-5

        line = np.array([[-1.0, 0, 0], [0, 0, 0], [1, 0, 0]])
        session.handle("body", stiffness=1000, guide=pliant.Curve(line, keep_length=True), **everything)
        rolled = session.solve({"body": pliant.GuidePose(line, twists=[np.pi / 2] * 3)})
        assert np.abs(rolled - rest @ [[1, 0, 0], [0, 0, 1], [0, -1, 0]]).max() < 0.01
        with pytest.raises(pliant.InvalidArgument, match="guide.scales"):
            session.solve({"body": pliant.GuidePose(line, scales=[1.0])})
        with pytest.raises(TypeError, match="pliant.Curve, Lattice or Cage"):
            session.handle("body", stiffness=1, guide=line, **everything)  # type: ignore[arg-type]


def test_passengers_are_shown_and_do_not_hold(server: pliant.LocalServer) -> None:
    ball = "o body\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 2 3 4\nf 1 4 3\n"
    with pytest.raises(pliant.InvalidArgument, match=r"passengers\[0\]"):
        pliant.open(ball.encode(), server=server, format="obj", passengers=[9])
    with pytest.raises(pliant.InvalidArgument, match="nothing is left"):
        pliant.open(ball.encode(), server=server, format="obj", passengers=[0])


def test_a_node_of_the_model_rides_along_into_its_export(server: pliant.LocalServer, tmp_path: Path) -> None:
    with pliant.connect(server) as client:
        figure = client.sample("figure")
    for wrong, error, said in [
        ({"node": "hips"}, pliant.InvalidArgument, "joint of a skin"),
        ({"node": 99}, pliant.InvalidArgument, "counted from 0"),
        ({"bone": 1}, TypeError, "the key node alone"),
    ]:
        with pytest.raises(error, match=said):
            pliant.open(figure, server=server, passengers=[wrong])
    with pliant.open(figure, server=server, passengers=["lod1", {"node": "hatSocket"}], rig="keep") as session:
        session.handle("feet", half_space=((0, -1, 0), -0.3))
        session.handle("head", half_space=((0, 1, 0), 1.54))
        session.solve({"head": {"rotation_vector": (0, 0.6, 0), "translation": (0.1, 0.1, 0)}})
        session.export(tmp_path / "turned.glb")

    def nodes(glb: bytes) -> list[dict[str, object]]:
        return json.loads(glb[20 : 20 + int.from_bytes(glb[12:16], "little")])["nodes"]

    before, after = nodes(figure), nodes((tmp_path / "turned.glb").read_bytes())
    changed = [node["name"] for node, now in zip(before, after) if node != now]
    assert changed == ["hatSocket"]


def test_handles_say_what_they_hold_and_keep_their_poses_when_another_is_added(held: pliant.Session) -> None:
    rest = held.positions()
    facts = held.apply()
    assert [h.id for h in facts.handles] == ["feet", "head"] and all(h.vertices > 0 for h in facts.handles)
    # Where joints are depends on all handles, so the pose says what it turns about.
    bent = held.solve({"head": {**TURN["head"], "pivot": (0.6, 1.0, 0)}}, refine=0)
    held.handle("tail", sphere=((-1.0, 1.06, 0), 0.16))
    again = held.solve(refine=0)
    head = np.linalg.norm(rest - [0.76, 1.22, 0], axis=1) < 0.36
    assert np.allclose(again[head], bent[head], atol=1e-6), "the head stays turned"
    held.undo()
    held.undo()
    assert held.handles == ["feet", "head"], "undoing takes the handle away here as well"
    held.remove_handle("head")
    assert held.handles == ["feet"]
    with pytest.raises(pliant.NotFound, match="feet"):
        held.remove_handle("wing")


def test_a_handle_may_be_made_where_it_is_to_go(server: pliant.LocalServer) -> None:
    vertices, faces = bar()
    with pliant.open((vertices, faces), server=server, label="bar") as session:
        assert session.info.label == "bar" and session.vertices == len(vertices)
        assert np.array_equal(session.positions(), vertices.astype(np.float32)), "vertices keep their order"
        session.handle("base", vertices=vertices[:, 2] < 0.3)
        session.handle(
            "top",
            vertices=np.flatnonzero(vertices[:, 2] > 3.7),
            translation=(1, 0, 0),
            rotation_vector=(0, 0.4, 0),
            pivot=tuple(vertices[vertices[:, 2] > 3.7].mean(axis=0)),
        )
        bent = session.solve()
        top = vertices[:, 2] > 3.7
        assert np.allclose(bent[top].mean(axis=0), vertices[top].mean(axis=0) + [1, 0, 0], atol=1e-5)
        assert np.array_equal(bent[vertices[:, 2] < 0.3], vertices[vertices[:, 2] < 0.3].astype(np.float32))


def test_a_matrix_moves_a_handle_as_it_moves_points(server: pliant.LocalServer) -> None:
    vertices, faces = bar()
    top = vertices[:, 2] > 3.7
    matrix = np.array([[0.0, 0, 1, 0.5], [0, 1, 0, 0.1], [-1, 0, 0, 2], [0, 0, 0, 1]])
    with pliant.open((vertices, faces), server=server) as session:
        session.handle("base", half_space=((0, 0, -1), -0.3))
        session.handle("top", vertices=top)
        bent = session.solve({"top": matrix})
        assert np.allclose(bent[top], vertices[top] @ matrix[:3, :3].T + matrix[:3, 3], atol=1e-5)


def test_frames_carry_normals_and_quality_when_asked(held: pliant.Session) -> None:
    frame = held.solve_frame(TURN, normals=True, tangents=True, self_intersections=True)
    assert frame.normals is not None and np.allclose(np.linalg.norm(frame.normals, axis=1), 1, atol=1e-4)
    assert frame.quality is not None and frame.quality.HasField("self_intersections")
    assert frame.final and frame.residual <= 1e-4


def test_sixteen_bit_positions_are_as_near_as_they_say(held: pliant.Session) -> None:
    exact = held.solve(TURN)
    packed = held.solve(TURN, encoding="u16")
    step = np.ptp(exact, axis=0).max() / 65535
    assert 0 < np.abs(packed - exact).max() <= step


def test_the_same_job_gives_the_same_bits_as_the_command_line(
    server: pliant.LocalServer, creature: Path, tmp_path: Path
) -> None:
    job = {
        "handles": [
            {"id": "feet", "region": {"halfSpace": {"normal": [0, -1, 0], "offset": -0.14}}},
            {"id": "head", "region": {"sphere": {"center": [0.76, 1.22, 0], "radius": 0.36}}},
        ],
        "steps": [{"pose": {"handles": [{"id": "head", "pose": {"rotationVector": [0, 0.8, 0], "scale": [1.1]}}]}}],
    }
    report = deform(creature, job, tmp_path, "out.glb")
    with pliant.open(creature, server=server) as session:
        session.handle("feet", **FEET)
        session.handle("head", **HEAD)
        session.solve({"head": {"rotation_vector": (0, 0.8, 0), "scale": 1.1}})
        assert session.history()[-1].digest == report["digest"]
        assert session.export_bytes()[""] == (tmp_path / "out.glb").read_bytes()


def test_the_region_of_interest_keeps_the_rest_to_the_bit(server: pliant.LocalServer) -> None:
    vertices, faces = bar()
    with pliant.open((vertices, faces), server=server) as session:
        session.handle("top", half_space=((0, 0, 1), 3.7))
        session.region_of_interest(half_space=((0, 0, 1), 2.0))
        bent = session.solve({"top": {"translation": (0.3, 0, 0)}})
        below = vertices[:, 2] < 1.99
        assert np.array_equal(bent[below], vertices[below].astype(np.float32))


def test_symmetry_mirrors_handles(server: pliant.LocalServer) -> None:
    vertices, faces = bar()
    with pliant.open((vertices, faces), server=server) as session:
        session.handle("middle", box=((-1, -1, 1.9), (1, 1, 2.1)))
        session.handle("top", half_space=((0, 0, 1), 3.7))
        session.symmetry_plane((0, 0, 1), 2.0)
        bent = session.solve({"top": {"translation": (0.3, 0, 0)}})
        assert np.allclose(bent[vertices[:, 2] < 0.2, 0], vertices[vertices[:, 2] < 0.2, 0] + 0.3, atol=1e-5)


def test_what_the_server_refuses_comes_as_it_said_it(held: pliant.Session, server: pliant.LocalServer) -> None:
    with pytest.raises(pliant.InvalidArgument) as caught:
        held.solve({"hed": {}})
    assert caught.value.field == "pose.handles[0].id" and caught.value.code == "INVALID_ARGUMENT"
    assert '"hed"' in str(caught.value) and '"feet", "head"' in caught.value.message
    with pytest.raises(ValueError, match="scale"):
        held.solve({"head": {"scale": -1}})
    held.handle("nowhere", sphere=((100, 0, 0), 0.1))
    with pytest.raises(pliant.InvalidArgument, match="handles"):
        held.solve()
    assert held.handles == ["feet", "head"]
    held.solve(TURN)
    with pytest.raises(pliant.InvalidArgument):
        pliant.open(b"not a model", server=server)
    with pliant.open(bar(), server=server) as bare, pytest.raises(pliant.FailedPrecondition):
        bare.solve()


def test_a_handle_that_makes_no_sense_is_refused_by_name(held: pliant.Session) -> None:
    for region in ({"vertices": np.ones(5, bool)}, {"sphere": ((0, 0), 1)}, {"component": 0.5}):
        with pytest.raises(ValueError, match=f"handle 'tail': {next(iter(region))}"):
            held.handle("tail", **region)
    with pytest.raises(ValueError, match=f"mask of {held.vertices + 1} values, the model's {held.vertices} are"):
        held.region_of_interest(vertices=np.ones(held.vertices + 1, bool))
    with pytest.raises(ValueError, match="delete: vertices: a mask of 5 values"):
        held.edit(delete={"region": {"vertices": np.ones(5, bool)}})
    for other in ({"falloff": 0.2}, {"stiffness": "5"}, {"rigid": "no"}, {"constrains": "position"}):
        with pytest.raises(TypeError, match=f"handle 'tail': {next(iter(other))}"):
            held.handle("tail", **HEAD, **other)
    with pytest.raises(TypeError, match="handle: 5, an id"):
        held.handle(5, **HEAD)  # type: ignore[arg-type]
    with pytest.raises(TypeError, match="poses: "):
        held.solve([1])  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="commit: 'first'"):
        list(held.drag([TURN], commit="first"))  # type: ignore[arg-type]
    assert held.handles == ["feet", "head"] and len(held.history()) == 2, "nothing came of it"


@pytest.mark.parametrize("encoding", ["f32", "delta"])
@pytest.mark.parametrize("edit", [{"cut": {"normal": (0, 0, 1), "offset": 2.0}}, {"subdivide": {}}])
def test_a_stream_that_was_open_before_an_edit_says_so(
    server: pliant.LocalServer, encoding: Literal["f32", "delta"], edit: Any
) -> None:
    with pliant.open(bar(), server=server) as session:
        session.handle("base", half_space=((0, 0, -1), -0.3))
        session.handle("middle", sphere=((0, 0, 1.5), 1.0))
        moved = {"middle": {"translation": (0.1, 0, 0)}}
        with session.stream(encoding=encoding) as stream:
            stream.send(moved)
            stream.wait(timeout=60)
            try:
                session.edit(**edit)
            except pliant.Unimplemented as refusal:
                pytest.skip(f"this server does not edit: {refusal}")
            stream.send(moved)
            with pytest.raises(pliant.Internal, match="vertices; after an edit.*open a new stream"):
                stream.wait(timeout=60)
        with session.stream(encoding=encoding) as stream:
            stream.send(moved)
            assert stream.wait(timeout=60).positions.shape == (session.vertices, 3)


def test_an_edit_is_done_or_refused_by_name(server: pliant.LocalServer) -> None:
    vertices, faces = bar()
    with pliant.open((vertices, faces), server=server) as session:
        try:
            done = session.edit(cut={"normal": (0, 0, 1), "offset": 2.0, "keep": "below", "fill": True})
        except pliant.Unimplemented as refusal:
            assert "cut" in refusal.message and refusal.code == "UNIMPLEMENTED"
            assert np.array_equal(session.positions(), vertices.astype(np.float32)), "a refusal changes nothing"
            pytest.skip(f"this server does not edit: {refusal}")
        assert done.before == (len(vertices), len(faces)) and done.after != done.before
        below = session.positions()
        stayed = done.now_from_before >= 0
        assert np.array_equal(below[done.now_from_before[stayed]], vertices[stayed].astype(np.float32))
        assert len(below) == session.vertices == done.after[0]
        assert below[:, 2].max() == pytest.approx(2.0, abs=1e-5)
        session.handle("base", half_space=((0, 0, -1), -0.3))
        session.handle("top", half_space=((0, 0, 1), 1.9))
        moved = session.solve({"top": {"translation": (0.2, 0, 0)}})
        assert moved.shape == below.shape
        session.edit(subdivide={"scheme": "loop"})
        assert "'base', 'top'" in repr(session), "the edit carries both handles"
        session.undo()
        session.undo()
        session.undo()
        session.undo()
        assert np.array_equal(session.positions(), vertices.astype(np.float32))
        assert session.vertices == len(vertices)


def test_a_session_can_be_kept_found_and_taken_up(server: pliant.LocalServer, creature: Path) -> None:
    with pliant.connect(server) as client:
        with client.open(creature, keep=True, ttl="1m", label="kept") as session:
            session.handle("head", **HEAD)
            session.apply()
        assert session.id in [s.id for s in client.sessions()]
        again = client.attach(session.id, keep=False)
        assert again.info.label == "kept" and [h.id for h in again.info.handles] == ["head"]
        with pytest.raises(pliant.FailedPrecondition, match="clear_handles"):
            again.handle("feet", **FEET)
        again.clear_handles()
        again.handle("feet", **FEET)
        again.handle("head", **HEAD)
        again.solve(TURN)
        again.close()
        assert session.id not in [s.id for s in client.sessions()]
        for call in (again.refresh, again.positions, again.solve, again.undo, again.stream):
            with pytest.raises(pliant.SessionLost, match=r"was closed by close\(\)"):
                call()
        again.close()
        with pytest.raises(TypeError, match="session_id: 5, text"):
            client.attach(5)  # type: ignore[arg-type]
        left = client.open(creature)
    for call in (client.limits, left.refresh, left.positions, left.stream().receive):
        with pytest.raises(pliant.FailedPrecondition, match="the connection is closed"):
            call()
    left.close()


def test_models_come_in_as_files_bytes_streams_and_meshes(server: pliant.LocalServer, creature: Path) -> None:
    class Mesh:
        vertices, faces = bar()

    for model in (str(creature), creature.read_bytes(), io.BytesIO(creature.read_bytes()), Mesh()):
        with pliant.open(model, server=server) as session:
            assert session.vertices > 0
    with pytest.raises(FileNotFoundError):
        pliant.open("no such file.glb", server=server)


def test_progress_is_told(server: pliant.LocalServer, creature: Path) -> None:
    told: list[tuple[int, int]] = []
    with pliant.open(creature, server=server, progress=lambda done, total: told.append((done, total))) as session:
        size = creature.stat().st_size
        assert told[-1] == (size, size)
        session.handle("feet", **FEET)
        session.handle("head", **HEAD)
        told.clear()
        poses = [TURN, {"head": {}}]
        frames = list(session.drag(poses, progress=lambda done, total: told.append((done, total))))
        assert len(frames) == 2 and told == [(1, 2), (2, 2)]
        assert len(list(session.drag(poses, progress=True))) == 2


def test_stages_of_opening_are_told(
    server: pliant.LocalServer, creature: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    class Told:
        def __init__(self) -> None:
            self.stages: list[str] = []
            self.counts: list[tuple[int, int]] = []

        def stage(self, what: str) -> None:
            self.stages.append(what)

        def __call__(self, done: int, total: int) -> None:
            self.counts.append((done, total))

    told = Told()
    pliant.open(creature, server=server, progress=told).close()
    assert told.stages == ["read", "upload", "build"]
    assert told.counts[-1] == (creature.stat().st_size,) * 2
    capfd.readouterr()
    pliant.open(creature, server=server, progress=True).close()
    bar = capfd.readouterr().err
    assert "upload" in bar and "build" in bar[bar.index("upload") :], "the bar says that the server builds"


def test_a_handle_that_holds_nothing_is_named_and_blocks_nothing(held: pliant.Session) -> None:
    rest = held.positions()
    bent = held.solve(TURN)
    held.handle("hat", sphere=((50, 0, 0), 0.1))
    # The model's box, as far as it is told: to a thousandth of its size.
    low, high = (", ".join(f"{x:.3f}" for x in corner) for corner in (rest.min(axis=0) + 0.0, rest.max(axis=0) + 0.0))
    with pytest.raises(pliant.InvalidArgument, match=r"handle 'hat': handles\[2\].region: holds no vertex") as refused:
        held.solve(TURN)
    assert f"from [{low}] to [{high}]" in refused.value.message and refused.value.field == "handles[2].region"
    assert held.handles == ["feet", "head"], "the session is as it was"
    assert np.array_equal(held.solve(TURN), bent), "and solves as it did"
    # What else was noted down is not lost with it, and a handle that was there before is again as it was.
    held.handle("tail", sphere=((-1.0, 1.06, 0), 0.16))
    held.handle("head", sphere=((50, 0, 0), 0.1))
    with pytest.raises(pliant.InvalidArgument, match="handle 'head'"):
        held.apply()
    assert held.handles == ["feet", "head", "tail"]
    facts = {h.id: h for h in held.apply().handles}
    assert list(facts) == ["feet", "head", "tail"] and facts["head"].centroid[0] < 1
    assert facts["head"].HasField("pose"), "and where it was"
    # A plane that is none is nobody's handle: all that was not sent is taken back.
    held.symmetry_plane((0, 0, 0))
    with pytest.raises(pliant.InvalidArgument):
        held.apply()
    assert held.handles == ["feet", "head", "tail"] and held.solve(TURN).shape == bent.shape


def test_the_first_handles_of_a_session_may_be_wrong(server: pliant.LocalServer, creature: Path) -> None:
    with pliant.open(creature, server=server) as session:
        session.handle("feet", **FEET)
        session.handle("head", sphere=((50, 0, 0), 0.1))
        with pytest.raises(pliant.InvalidArgument, match="handle 'head'"):
            session.solve(TURN)
        session.handle("head", **HEAD)
        assert session.solve(TURN).shape == (session.vertices, 3)


def test_a_preview_has_no_holes_and_is_seen_from_where_it_is_asked(server: pliant.LocalServer) -> None:
    corners = np.array([(x, y, z) for x in (0.0, 1) for y in (0.0, 1) for z in (0.0, 1)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    with pliant.open((corners * (1, 1, 3), np.array(quads)), server=server) as session:
        widths = []
        for view in [(0.0, 0.0), (90.0, 0.0), (30.0, 20.0)]:
            drawn = pixels_of(session.preview(900, 700, view)) < 255
            rows = drawn[drawn.any(axis=1)]
            first, last = rows.argmax(axis=1), rows.shape[1] - rows[:, ::-1].argmax(axis=1)
            assert np.array_equal(rows.sum(axis=1), last - first), f"holes from {view}"
            widths.append((last - first).max() / len(rows))
        assert np.allclose(widths[:2], [1, 3], atol=0.02), "a square from the front, and three times as wide from the side"


def test_what_covers_no_pixel_is_an_empty_picture() -> None:
    for points in (np.zeros((3, 3)), np.array([(0.0, 0, 0), (1, 1, 0), (2, 2, 0)])):
        assert pixels_of(preview.picture(points, np.array([[0, 1, 2]]))).min() == 255


def pixels_of(png: bytes) -> np.ndarray:
    """One channel of a picture that the package wrote: rows without filters."""
    width, height = (int.from_bytes(png[at : at + 4], "big") for at in (16, 20))
    start = png.index(b"IDAT") + 4
    length = int.from_bytes(png[start - 8 : start - 4], "big")
    rows = np.frombuffer(zlib.decompress(png[start : start + length]), np.uint8).reshape(height, 1 + 3 * width)
    assert not rows[:, 0].any()
    return rows[:, 1::3]


def test_a_session_shows_itself(server: pliant.LocalServer, creature: Path, tmp_path: Path) -> None:
    assert pliant.__version__ == "0.1.0"
    with pliant.open(creature, server=server) as session:
        assert session.info.label == "creature.glb", "people know it by its file"
        session.handle("<feet>", **FEET)
        session.handle("head", **HEAD)
        shown = repr(session)
        for told in ("pliant.Session", "'creature.glb'", f"{session.vertices} vertices", "'head'", session.id):
            assert told in shown
        before = session.preview()
        assert size_of(before) == (320, 240) and session._repr_png_() == before
        dark = coverage(before)
        assert 0.15 < dark < 0.8, f"the creature fills {dark} of its picture"
        session.solve({"head": {"rotation_vector": (0, 0, 0.9)}})
        assert session.preview() != before, "it is the shape as it is now"
        page = session._repr_html_()
        assert "creature.glb" in page and "&lt;feet&gt;" in page and "data:image/png;base64," in page
        [path] = session.export(tmp_path / "bent.glb")
    assert "closed" in repr(session) and session._repr_png_() is None and "creature.glb" in session._repr_html_()
    with pliant.open(path, server=server, label="another") as session:
        assert session.info.label == "another"


def size_of(png: bytes) -> tuple[int, int]:
    assert png[:8] == b"\x89PNG\r\n\x1a\n" and png[12:16] == b"IHDR"
    return int.from_bytes(png[16:20], "big"), int.from_bytes(png[20:24], "big")


def coverage(png: bytes) -> float:
    """The share of pixels of a picture that are not white."""
    length = int.from_bytes(png[33:37], "big")
    width, height = size_of(png)
    rows = np.frombuffer(zlib.decompress(png[41 : 41 + length]), np.uint8).reshape(height, 1 + 3 * width)
    return float((rows[:, 1:].reshape(-1, 3).min(axis=1) < 255).mean())


def test_progress_needs_no_package(
    server: pliant.LocalServer, creature: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "tqdm.auto", None)
    pliant.open(creature, server=server, progress=True).close()
    assert capsys.readouterr().err.split() == ["read", "upload", "build"], "without a terminal, a line for each stage"
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    pliant.open(creature, server=server, progress=True).close()
    drawn = capsys.readouterr().err
    assert "\rupload: 100 %" in drawn and drawn.endswith("\r") and "\n" not in drawn, "on one, a line that goes away"


def test_a_given_shape_is_adopted_bit_for_bit_and_its_rig_follows(
    server: pliant.LocalServer, figure: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pliant.edits, "PART", 1000)
    with pliant.open(figure, server=server) as session:
        before = session.positions()
        given = (before * np.array([1.1, 1.05, 0.9]) + np.array([0.0, 0.2, 0.0])).astype(np.float32)
        assert len(given) > 1000, "in parts"
        done = session.adopt(given)
        assert done.before == done.after and [c.kind for c in session.history()] == ["create", "edit"]
        assert np.array_equal(session.positions().view(np.uint32), given.view(np.uint32))
        model = session.export_bytes("glb")[""]
        session.undo()
        assert np.array_equal(session.positions(), before)
        session.redo()
        assert np.array_equal(session.positions(), given)
        with pytest.raises(pliant.InvalidArgument, match="adopt.positions"):
            session.adopt(given[1:])
        assert [w.code for w in session.adopt().warnings] == ["adopt-nothing"]
    with pliant.open(model, server=server, format="glb") as again:
        assert np.abs(again.positions() - given).max() < 1e-5
        joints = next(iter(again.animate(fps=10)))
        assert joints.positions.shape == given.shape, "its clips still play"


def test_targets_larger_than_a_message_are_committed_in_parts(
    server: pliant.LocalServer, creature: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pliant.open(creature, server=server) as session:
        session.handle("scan", vertices=np.arange(session.vertices), stiffness=0.5, targets=True)
        rest = session.positions()
        places, weights = rest + 0.1 * np.sin(5 * rest[:, [1, 2, 0]]), np.linspace(0.1, 1.0, session.vertices)
        for given in (pliant.Targets(places, weights), pliant.Targets(places[::-1], 0.5)):
            whole = session.solve({"scan": given})
            with monkeypatch.context() as small:
                small.setattr(pliant.poses, "PART", 500)
                small.setattr("pliant.aio.calls._LARGE", 1000)
                assert np.array_equal(session.solve({"scan": given}), whole)
                with pytest.raises(pliant.InvalidArgument, match=r"positions\[3\]: has y = NaN"):
                    wrong = places.copy()
                    wrong[3, 1] = np.nan
                    session.solve({"scan": pliant.Targets(wrong, weights)})
        assert [c.kind for c in session.history()] == ["create", "handles", "pose", "pose", "pose", "pose"]


def test_landmarks_inside_triangles_and_planes_lead_a_model(server: pliant.LocalServer, creature: Path) -> None:
    with pliant.open(creature, server=server) as session:
        rest, triangles = session.positions(), session.triangles()
        session.handle("feet", half_space=((0, -1, 0), -0.14))
        faces = np.arange(0, len(triangles), 97)
        weights = np.tile([0.5, 0.25, 0.25], (len(faces), 1))

        def places(of: np.ndarray) -> np.ndarray:
            return np.einsum("fk,fkc->fc", weights, of[triangles[faces]])

        session.handle("marks", anchors=(faces, weights), stiffness=50.0, targets=True)
        wanted = places(rest) + 0.1 * np.sin(2 * places(rest)[:, [1]])
        moved = session.solve({"marks": pliant.Targets(wanted)})
        assert np.abs(places(moved) - wanted).max() < 0.3 * np.abs(wanted - places(rest)).max()
        session.undo()
        session.handle("marks", anchors=(triangles[faces], weights), stiffness=50.0, targets=True)
        assert np.array_equal(session.solve({"marks": pliant.Targets(wanted)}), moved), "by their vertices"
        with pytest.raises(ValueError, match="anchors' weights have shape"):
            session.handle("wrong", anchors=(faces, weights[1:]), stiffness=1.0, targets=True)

        session.handle("slide", vertices=np.arange(session.vertices), stiffness=1.0, targets=True, tangential=1.0)
        across = np.tile([0.0, 0.0, 2.0], (session.vertices, 1))
        along = session.solve({"slide": pliant.Targets(rest + np.array([5.0, -3.0, 0.0]), normals=across)})
        assert np.abs(along - session.positions()).max() < 1e-6
        assert np.abs(along[:, :2] - moved[:, :2]).max() < 0.5, "targets along the plane pull nothing"


def test_work_of_an_edit_is_told_and_its_end_is_named(server: pliant.LocalServer, creature: Path) -> None:
    class Told:
        stages: list[str] = []
        counts: list[tuple[int, int]] = []

        def stage(self, what: str) -> None:
            self.stages.append(what)

        def __call__(self, done: int, total: int) -> None:
            self.counts.append((done, total))

    told = Told()
    with pliant.open(creature, server=server) as session:
        done = session.wrap(creature, progress=told)
        assert done.wrap is not None and told.stages[0] == "edit"
        assert "wrap" in told.stages, told.stages
        assert all(0 <= done <= 100 and total == 100 for done, total in told.counts)
        with pytest.raises(ValueError, match="shape: it is empty"):
            session.transfer(creature, shape=b"")
        session.edit(subdivide={})
        with pliant.connect(server, timeout=0.3) as hasty:
            with pytest.raises(pliant.DeadlineExceeded, match=r"Edit took longer than the 0.3 s"):
                hasty.attach(session.id).wrap(creature)
