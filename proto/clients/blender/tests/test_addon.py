"""The add-on in Blender without a window: what it makes is measured against `pliant deform`."""

from __future__ import annotations

import json
import math
import signal
import socket
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion, Vector

import pliant_addon
from pliant.server import LocalServer, find_binary
from pliant_addon import bake, drag, handles, link, mesh


@pytest.fixture
def bar() -> Iterator[bpy.types.Object]:
    """A square bar along z from 0 to 4, with the groups "base" and "top", turned and moved in the world."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    vertices, faces = geometry()
    data = bpy.data.meshes.new("bar")
    data.from_pydata(vertices.tolist(), [], faces.tolist())
    object = bpy.data.objects.new("bar", data)
    bpy.context.scene.collection.objects.link(object)
    bpy.context.view_layer.objects.active = object
    object.location = (5, -2, 1)
    object.rotation_euler = (0.3, 0.2, 0.1)
    object.vertex_groups.new(name="base").add(np.flatnonzero(vertices[:, 2] < 0.3).tolist(), 1.0, "REPLACE")
    object.vertex_groups.new(name="top").add(np.flatnonzero(vertices[:, 2] > 3.7).tolist(), 1.0, "REPLACE")
    object.vertex_groups.new(name="nothing")
    bpy.context.view_layer.update()
    yield object
    link.close_all()


def geometry(cells: int = 24) -> tuple[np.ndarray, np.ndarray]:
    ring = np.array([(-1, -1), (0, -1), (1, -1), (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0)]) * 0.25
    sides = [(x, y, z) for z in np.linspace(0, 4, cells + 1) for x, y in ring]
    faces = []
    for k in range(cells):
        for i in range(8):
            a, b = 8 * k + i, 8 * k + (i + 1) % 8
            faces += [(a, b, b + 8), (a, b + 8, a + 8)]
    low, high, top = len(sides), len(sides) + 1, 8 * cells
    for i in range(8):
        faces += [(low, (i + 1) % 8, i), (high, top + i, top + (i + 1) % 8)]
    return np.array([*sides, (0, 0, 0), (0, 0, 4)]), np.array(faces)


def held(object: bpy.types.Object) -> bpy.types.Object:
    """Holds the base, moves the top; answers the top's control."""
    assert bpy.ops.pliant.add_handle(kind="HOLD", group="base") == {"FINISHED"}
    assert bpy.ops.pliant.add_handle(kind="MOVE", group="top") == {"FINISHED"}
    control = object.pliant.handles[1].control
    bpy.context.view_layer.update()
    return control


def move(object: bpy.types.Object, control: bpy.types.Object, angle: float, by=(0.0, 0.0, 0.0)) -> None:
    """Turns the top about the mesh's own y axis and moves it, through its control."""
    rest = handles.rest_matrix(object.pliant.handles[1])
    turned = Matrix.Translation(Vector(by)) @ rest @ Quaternion((0, 1, 0), angle).to_matrix().to_4x4()
    control.matrix_world = object.matrix_world @ turned
    bpy.context.view_layer.update()


def command_line(object: bpy.types.Object, angle: float, by: list[float], folder: Path) -> np.ndarray:
    """The same deformation by `pliant deform` on an OBJ that it reads by itself."""
    vertices, faces = geometry()
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.astype(np.float32).astype(float).tolist()]
    lines += ["f " + " ".join(str(corner + 1) for corner in face) for face in faces]
    (folder / "bar.obj").write_text("\n".join(lines) + "\n")
    group = lambda name: np.flatnonzero(mesh.group_weights(object, name) > 0).tolist()
    # Controls stand in the middle of their group, and turn about themselves.
    middle = mesh.rest(object)[group("top")].mean(axis=0).tolist()
    pose = {"rotationVector": [0, angle, 0], "translation": by, "pivot": middle}
    job = {
        "handles": [{"id": name, "region": {"vertices": {"indices": group(name)}}} for name in ("base", "top")],
        "steps": [{"pose": {"handles": [{"id": "top", "pose": pose}]}}],
        "options": {"tolerance": 1e-8},
    }
    (folder / "job.json").write_text(json.dumps(job))
    command = [find_binary(), "deform", "bar.obj", "--job", "job.json", "-o", "out.obj", "--force"]
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    rows = [line.split()[1:4] for line in (folder / "out.obj").read_text().splitlines() if line.startswith("v ")]
    return np.array(rows, float)


def farthest(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.linalg.norm(a - b, axis=1).max())


def test_a_solve_makes_a_shape_key_that_matches_the_command_line(bar: bpy.types.Object, tmp_path: Path) -> None:
    rest, faces = mesh.rest(bar), mesh.triangles(bar)
    bar.pliant.tolerance = 1e-8
    control = held(bar)
    move(bar, control, 1.2, (0.8, 0.0, -0.3))
    assert bpy.ops.pliant.solve() == {"FINISHED"}
    keys = bar.data.shape_keys.key_blocks
    assert [key.name for key in keys] == ["Basis", "Pliant"] and keys["Pliant"].value == 1.0
    wanted = command_line(bar, 1.2, [0.8, 0.0, -0.3], tmp_path)
    assert farthest(mesh.shape(keys["Pliant"]), wanted) < 1e-5
    assert farthest(wanted, rest) > 0.5
    assert np.array_equal(mesh.rest(bar), rest) and np.array_equal(mesh.triangles(bar), faces)
    assert "error at most" in bar.pliant.told
    shown = bar.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(3 * len(shown.vertices), np.float32)
    shown.vertices.foreach_get("co", flat)
    assert farthest(flat.reshape(-1, 3), wanted) < 1e-5, "the viewport shows it"


def test_folds_are_looked_for_unless_refine_is_given(bar: bpy.types.Object, tmp_path: Path) -> None:
    bar.pliant.tolerance = 1e-8
    control = held(bar)
    move(bar, control, 2.9)
    wanted = command_line(bar, 2.9, [0, 0, 0], tmp_path)

    def solved() -> np.ndarray:
        assert bpy.ops.pliant.solve() == {"FINISHED"}
        return mesh.shape(bar.data.shape_keys.key_blocks["Pliant"])

    assert farthest(solved(), wanted) < 1e-5 and " 0 flipped" in bar.pliant.told
    bar.pliant.refine = 4
    assert farthest(solved(), wanted) > 0.1 and " 0 flipped" not in bar.pliant.told


def test_dragging_follows_the_control_and_ends_exact(bar: bpy.types.Object, tmp_path: Path) -> None:
    bar.pliant.tolerance = 1e-8
    control = held(bar)
    dragged = drag.Drag(bar, bpy.context.evaluated_depsgraph_get())
    seen = []
    for k in range(1, 13):
        move(bar, control, 0.1 * k)
        end = time.monotonic() + 60
        dragged.settled = False
        while not (dragged.step() and dragged.settled):
            assert time.monotonic() < end
            time.sleep(0.002)
        seen.append(mesh.shape(bar.data.shape_keys.key_blocks["Pliant"]))
    steps = [farthest(a, b) for a, b in zip(seen, seen[1:])]
    assert min(steps) > 0.02, "every step moves the mesh"
    assert not dragged.step(), "nothing moves when the control rests"
    dragged.finish()
    result = mesh.shape(bar.data.shape_keys.key_blocks["Pliant"])
    assert farthest(result, command_line(bar, 1.2, [0, 0, 0], tmp_path)) < 1e-5


def test_a_cancelled_drag_gives_back_what_was_there(bar: bpy.types.Object) -> None:
    control = held(bar)
    move(bar, control, 0.5)
    dragged = drag.Drag(bar, bpy.context.evaluated_depsgraph_get())
    until_shown(dragged)
    dragged.cancel()
    assert bar.data.shape_keys is None, "there was no key before"
    assert bpy.ops.pliant.solve() == {"FINISHED"}
    key = bar.data.shape_keys.key_blocks["Pliant"]
    key.value = 0.5
    before = mesh.shape(key)
    move(bar, control, 1.0)
    dragged = drag.Drag(bar, bpy.context.evaluated_depsgraph_get())
    until_shown(dragged)
    assert not np.array_equal(mesh.shape(key), before) and key.value == 1.0
    dragged.cancel()
    assert np.array_equal(mesh.shape(key), before) and key.value == 0.5


def until_shown(dragged: drag.Drag) -> None:
    end = time.monotonic() + 60
    while not dragged.step():
        assert time.monotonic() < end
        time.sleep(0.002)


class Operator:
    """The drag's operator without the window that Blender would give it: its own methods, made-up events."""

    invoke, modal, _drop = (getattr(drag.PLIANT_OT_drag, name) for name in ("invoke", "modal", "_drop"))
    _end, _fail, cancel = drag.PLIANT_OT_drag._end, drag.PLIANT_OT_drag._fail, drag.PLIANT_OT_drag.cancel
    _timer = None

    def __init__(self, object: bpy.types.Object, *others: bpy.types.Object) -> None:
        self.object, self.reports, self.calls = object, [], []
        self.selected_objects, self.scene = [object, *others], bpy.context.scene
        self.window = self.area = self
        self.areas = [self]

    window_manager = workspace = screen = property(lambda self: self)

    def report(self, kind: set[str], text: str) -> None:
        self.reports.append(text)

    def evaluated_depsgraph_get(self) -> bpy.types.Depsgraph:
        return bpy.context.evaluated_depsgraph_get()

    def __getattr__(self, name: str):
        if name not in ("event_timer_add", "event_timer_remove", "modal_handler_add", "status_text_set", "tag_redraw"):
            raise AttributeError(name)
        return lambda *words, **named: self.calls.append(name)

    def event(self, kind: str) -> set[str]:
        class Event:
            type, value = kind, "PRESS"

        return self.modal(self, Event)


@pytest.mark.parametrize("ending", ["RET", "ESC", "keep", "failure"])
def test_the_operator_drags_on_a_timer_until_a_key_ends_it(bar: bpy.types.Object, ending: str, monkeypatch) -> None:
    control = held(bar)
    operator = Operator(bar)
    assert operator.invoke(operator, None) == {"RUNNING_MODAL"} and bar.pliant.running
    assert not bpy.ops.pliant.solve.poll(), "nothing else starts meanwhile"
    move(bar, control, 0.6)
    end = time.monotonic() + 60
    while "tag_redraw" not in operator.calls:
        assert operator.event("TIMER") == {"PASS_THROUGH"} and time.monotonic() < end
    assert operator.event("G") == {"PASS_THROUGH"}, "other keys are Blender's"
    if ending == "failure":
        bpy.data.objects.remove(control)
        assert operator.event("TIMER") == {"CANCELLED"}
        assert "no control object" in operator.reports[0]
    elif ending == "keep":
        assert bpy.ops.pliant.keep() == {"FINISHED"}
        assert operator.event("TIMER") == {"FINISHED"}
    else:
        assert operator.event(ending) == ({"FINISHED"} if ending == "RET" else {"CANCELLED"})
    kept = ending in ("RET", "keep")
    assert (bar.data.shape_keys is not None) == kept
    assert not bar.pliant.running and operator.calls[-2:] == ["event_timer_remove", "status_text_set"]


def test_undo_takes_the_result_away_and_redo_brings_it_back(bar: bpy.types.Object) -> None:
    control = held(bar)
    move(bar, control, 0.7)
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.pliant.solve() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="Solve")
    result = mesh.shape(bpy.data.objects["bar"].data.shape_keys.key_blocks["Pliant"])
    bpy.ops.ed.undo()
    again = bpy.data.objects["bar"]
    assert again.data.shape_keys is None
    assert [h.group for h in again.pliant.handles] == ["base", "top"]
    bpy.ops.ed.redo()
    again = bpy.data.objects["bar"]
    assert np.array_equal(mesh.shape(again.data.shape_keys.key_blocks["Pliant"]), result)
    bpy.context.view_layer.objects.active = again
    assert bpy.ops.pliant.solve() == {"FINISHED"}, "the session goes on after undo and redo"
    assert np.array_equal(mesh.shape(again.data.shape_keys.key_blocks["Pliant"]), result)


def test_key_frames_become_shape_keys_that_take_turns(bar: bpy.types.Object, tmp_path: Path) -> None:
    bar.pliant.tolerance = 1e-8
    control = held(bar)
    for frame, angle in ((1, 0.0), (21, 1.2)):
        move(bar, control, angle)
        control.keyframe_insert("rotation_quaternion", frame=frame)
        control.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(7)
    assert bpy.ops.pliant.bake(first=1, last=21, step=10) == {"FINISHED"}
    assert bpy.context.scene.frame_current == 7, "the scene is where it was"
    keys = bar.data.shape_keys.key_blocks
    assert [key.name for key in keys] == ["Basis", "Pliant 0001", "Pliant 0011", "Pliant 0021"]
    assert farthest(mesh.shape(keys["Pliant 0001"]), mesh.rest(bar)) < 1e-5
    assert farthest(mesh.shape(keys["Pliant 0021"]), command_line(bar, 1.2, [0, 0, 0], tmp_path)) < 1e-5
    for frame, weights in ((1, (1, 0, 0)), (6, (0.5, 0.5, 0)), (11, (0, 1, 0)), (21, (0, 0, 1)), (30, (0, 0, 1))):
        bpy.context.scene.frame_set(frame)
        found = [keys[f"Pliant {number:04d}"].value for number in (1, 11, 21)]
        assert found == pytest.approx(weights, abs=1e-4), f"at frame {frame}"
    assert bpy.ops.pliant.bake(first=1, last=21, step=10) == {"FINISHED"}, "baking again replaces the keys"
    assert len(bar.data.shape_keys.key_blocks) == 4
    assert bake.frames(1, 10, 4) == [1, 5, 9, 10]


def test_soft_handles_pull_and_hard_ones_hold(bar: bpy.types.Object) -> None:
    control = held(bar)
    move(bar, control, 0.0, (0.5, 0, 0))
    top = mesh.group_weights(bar, "top") > 0
    assert bpy.ops.pliant.solve() == {"FINISHED"}
    key = bar.data.shape_keys.key_blocks["Pliant"]
    hard = mesh.shape(key)[top] - mesh.rest(bar)[top]
    assert np.allclose(hard, [0.5, 0, 0], atol=1e-5)
    bar.pliant.handles[1].stiffness = 0.001
    assert bpy.ops.pliant.solve() == {"FINISHED"}
    soft = mesh.shape(key)[top] - mesh.rest(bar)[top]
    assert 0 < soft[:, 0].mean() < 0.49


def refusal(words: str, **arguments: object) -> None:
    """Solving is refused with these words, and changes nothing."""
    object = bpy.context.object
    before = None if object.data.shape_keys is None else len(object.data.shape_keys.key_blocks)
    with pytest.raises(RuntimeError, match=f"(?i){words}"):
        bpy.ops.pliant.solve(**arguments)
    assert before == (None if object.data.shape_keys is None else len(object.data.shape_keys.key_blocks))


def test_modifiers_that_change_counts_are_refused_by_name(bar: bpy.types.Object) -> None:
    control = held(bar)
    move(bar, control, 0.5)
    modifier = bar.modifiers.new("Smooth it", "SUBSURF")
    refusal('"Smooth it" change the vertex count from 202 to .*disable it')
    with pytest.raises(mesh.Refusal, match="Smooth it"):
        drag.Drag(bar, bpy.context.evaluated_depsgraph_get())
    with pytest.raises(RuntimeError, match="Smooth it"):
        bpy.ops.pliant.bake(first=1, last=2, step=1)
    modifier.show_viewport = False
    assert bpy.ops.pliant.solve() == {"FINISHED"}
    bar.modifiers.new("Waves", "WAVE")
    assert bpy.ops.pliant.solve() == {"FINISHED"}, "modifiers that keep the count do not matter"


def test_what_cannot_be_done_is_said(bar: bpy.types.Object) -> None:
    refusal('"bar" has no handle: select vertices in Edit Mode')
    with pytest.raises(RuntimeError, match='"nothing" is empty'):
        bpy.ops.pliant.add_handle(kind="HOLD", group="nothing")
    with pytest.raises(RuntimeError, match='no vertex group "wing"'):
        bpy.ops.pliant.add_handle(kind="HOLD", group="wing")
    bpy.ops.pliant.add_handle(kind="HOLD", group="base")
    refusal("no handle moves")
    bpy.ops.pliant.add_handle(kind="MOVE", group="top")
    bpy.context.view_layer.update()
    control = bar.pliant.handles[1].control
    control.scale = (-1, 1, 1)
    bpy.context.view_layer.update()
    refusal("mirrors")
    bpy.data.objects.remove(control)
    refusal("no control")
    bar.pliant.active = 1
    assert bpy.ops.pliant.remove_handle() == {"FINISHED"}
    assert [h.group for h in bar.pliant.handles] == ["base"]
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.object.empty_add()
    assert not bpy.ops.pliant.solve.poll(), "only on a mesh"


def test_a_server_that_is_not_there_or_went_is_told_and_found_again(bar: bpy.types.Object, monkeypatch) -> None:
    control = held(bar)
    move(bar, control, 0.5)
    monkeypatch.setattr(pliant_addon.preferences, "way", lambda: ("not an address", "", ""))
    refusal("HOST:PORT")
    # Who uses Blender decides about the network; what stays on this machine is none.
    assert not bpy.app.online_access, "Blender starts with the network switched off"
    for far in ("https://mesh.example:7411", "192.0.2.1:7411", "http://[2001:db8::1]:7411"):
        monkeypatch.setattr(pliant_addon.preferences, "way", lambda far=far: (far, "", ""))
        refusal("Allow Online Access")
    for near in ("http://localhost:7411", "127.0.0.1:7411", "http://[::1]:7411", ""):
        monkeypatch.setattr(pliant_addon.preferences, "way", lambda near=near: (near, "", ""))
        assert link.refusal() == "", near
    with LocalServer() as first:
        monkeypatch.setattr(pliant_addon.preferences, "way", lambda: (first.url, "a token", ""))
        assert bpy.ops.pliant.solve() == {"FINISHED"}
        assert bpy.ops.pliant.solve() == {"FINISHED"}
    program = find_binary()
    monkeypatch.setattr(pliant_addon.preferences, "way", lambda: ("", "", program))
    assert bpy.ops.pliant.solve() == {"FINISHED"}, "a new session is opened where the old one went"
    link._server.kill()
    assert bpy.ops.pliant.solve() == {"FINISHED"}, "and a new server is started"


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGKILL])
def test_a_drag_goes_on_while_its_server_is_started_again(
    bar: bpy.types.Object, tmp_path: Path, monkeypatch, how: signal.Signals
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    # Far more time to end than it takes: the add-on leaves by itself.
    flags = [f"--listen=127.0.0.1:{port}", f"--data-dir={tmp_path / 'data'}", "--drain-deadline=300s"]

    def start() -> subprocess.Popen:
        server = subprocess.Popen([find_binary(), "serve", *flags], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL)
        assert server.stdout.readline().startswith(b"listening on ")
        return server

    server = start()
    try:
        monkeypatch.setattr(pliant_addon.preferences, "way", lambda: (f"http://127.0.0.1:{port}", "", ""))
        bar.pliant.tolerance = 1e-8
        control = held(bar)
        operator = Operator(bar)
        assert operator.invoke(operator, None) == {"RUNNING_MODAL"}
        dragged = operator._drags[0]

        def follow(angle: float) -> None:
            move(bar, control, angle)
            dragged.settled = False
            end = time.monotonic() + 60
            while not dragged.settled:
                assert operator.event("TIMER") == {"PASS_THROUGH"}, operator.reports
                assert time.monotonic() < end
                time.sleep(0.002)

        follow(0.3)
        session = dragged._session.id
        said = operator.calls.count("status_text_set")
        server.send_signal(how)
        assert server.wait(timeout=60) == (0 if how == signal.SIGTERM else -how)
        move(bar, control, 0.6)
        end = time.monotonic() + 60
        while not dragged.lost:
            assert operator.event("TIMER") == {"PASS_THROUGH"} and time.monotonic() < end
            time.sleep(0.002)
        operator.event("TIMER")
        server = start()
        follow(0.9)
        assert not dragged.lost
        operator.event("TIMER")
        assert operator.calls.count("status_text_set") == said + 2, (
            "it is told that the server is away, and that it is back"
        )
        assert operator.event("RET") == {"FINISHED"}
        assert dragged._session.id == session, "nothing was opened anew"
        result = mesh.shape(bar.data.shape_keys.key_blocks["Pliant"])
        assert farthest(result, command_line(bar, 0.9, [0, 0, 0], tmp_path)) < 1e-5
        assert [c.kind for c in dragged._session.history()] == ["create", "handles", "pose"]
        link.close_all()
    finally:
        server.kill()
        server.wait()


def test_controls_go_back_to_rest_and_the_mesh_with_them(bar: bpy.types.Object) -> None:
    control = held(bar)
    move(bar, control, 0.9, (1, 1, 1))
    assert bpy.ops.pliant.rest() == {"FINISHED"}
    bpy.context.view_layer.update()
    found = handles.poses(bar)["top"]
    assert np.allclose(found, np.eye(4), atol=1e-6)
    bar.location = (0, 0, 9)
    bar.rotation_euler = (math.pi / 3, 0, 0)
    control.parent = bar
    control.matrix_parent_inverse = Matrix()
    control.matrix_basis = handles.rest_matrix(bar.pliant.handles[1])
    bpy.context.view_layer.update()
    assert np.allclose(handles.poses(bar)["top"], np.eye(4), atol=1e-6), "a control that goes along does not deform"


def test_the_panel_draws_for_what_can_and_cannot_be_deformed(bar: bpy.types.Object) -> None:
    lines: list[str] = []

    class Layout:
        """Stands for Blender's layout, which needs a window."""

        def __getattr__(self, name: str):
            return lambda *a, **k: Layout()

        def label(self, text: str = "", icon: str = "NONE") -> None:
            lines.append(text)

    class Region:
        width = 240

    class Context:
        object = bar
        region = Region
        scene = bpy.context.scene
        evaluated_depsgraph_get = staticmethod(bpy.context.evaluated_depsgraph_get)

    class Panel:
        layout = Layout()

    draw = pliant_addon.panel.PLIANT_PT_sidebar.draw
    held(bar)
    draw(Panel, Context)
    bar.modifiers.new("Twice", "ARRAY")
    draw(Panel, Context)
    assert '"Twice" change the vertex' in " ".join(lines)
    assert max(map(len, lines)) <= 40
