"""Actions of armatures as point caches: what Blender shows is what `pliant animate` makes of the same bones."""

from __future__ import annotations

import json
import struct
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Quaternion
from test_addon import farthest, geometry

from pliant.server import find_binary
from pliant_addon import animate, cache, link, mesh, skin


@pytest.fixture
def arm(tmp_path: Path) -> Iterator[bpy.types.Object]:
    """A bar on two bones, both objects turned and moved, in a saved file; an action bends the upper bone."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    vertices, faces = geometry()
    data = bpy.data.meshes.new("bar")
    data.from_pydata(vertices.tolist(), [], faces.tolist())
    object = bpy.data.objects.new("bar", data)
    scene.collection.objects.link(object)
    rig = bpy.data.objects.new("rig", bpy.data.armatures.new("rig"))
    scene.collection.objects.link(rig)
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    low = rig.data.edit_bones.new("low")
    low.head, low.tail = (0, 0, 0), (0, 0, 2)
    high = rig.data.edit_bones.new("high")
    high.head, high.tail, high.parent = (0, 0, 2), (0, 0, 4), low
    aim = rig.data.edit_bones.new("aim")
    aim.head, aim.tail, aim.use_deform = (3, 0, 0), (3, 0, 1), False
    bpy.ops.object.mode_set(mode="OBJECT")
    share = np.clip((vertices[:, 2] - 1.5), 0, 1)
    for name, weights in (("low", 1 - share), ("high", share)):
        group = object.vertex_groups.new(name=name)
        for k, weight in enumerate(weights):
            if weight > 0:
                group.add([k], float(weight) * 0.5, "REPLACE")
    object.vertex_groups.new(name="aim").add([0], 1.0, "REPLACE")
    modifier = object.modifiers.new("Armature", "ARMATURE")
    modifier.object = rig
    rig.matrix_world = object.matrix_world = Matrix.Translation((5, -2, 1)) @ Matrix.Rotation(0.7, 4, (1, 2, 3))
    rig.location.x += 0.25
    turn(rig, {1: 0.0, 11: 1.3})
    bpy.context.view_layer.objects.active = object
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "arm.blend"))
    scene.frame_start, scene.frame_end = 1, 11
    yield object
    link.close_all()


def turn(rig: bpy.types.Object, keys: dict[int, float]) -> None:
    bone = rig.pose.bones["high"]
    bone.rotation_mode = "QUATERNION"
    for frame, angle in keys.items():
        bone.rotation_quaternion = Quaternion((1, 0, 0), angle)
        bone.keyframe_insert("rotation_quaternion", frame=frame)
    rig.animation_data.action.name = "bend it"


def shown(object: bpy.types.Object, frame: int | None = None) -> np.ndarray:
    """What the viewport shows, in the mesh's own space."""
    if frame is not None:
        bpy.context.scene.frame_set(frame)
    data = object.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    flat = np.empty(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def command_line(object: bpy.types.Object, folder: Path, frames: range) -> np.ndarray:
    """The frames that `pliant animate` writes of the model that the add-on sends."""
    bound = skin.skin(object, skin.modifier(object).object)
    scene = bpy.context.scene
    rate = scene.render.fps / scene.render.fps_base
    (folder / "sent.glb").write_bytes(skin.glb(object, bound, skin.sample(object, bound, scene, frames), rate))
    command = [find_binary(), *f"animate sent.glb --clip 0 -o sent.pc2 --fps {rate!r} --force --json".split()]
    done = subprocess.run(command, cwd=folder, check=True, capture_output=True)
    assert json.loads(done.stdout)["totals"]["frames"] == len(frames)
    return read(folder / "sent.pc2")[1]


def read(path: Path) -> tuple[tuple[float, ...], np.ndarray]:
    data = path.read_bytes()
    sign, *head = struct.unpack("<12siiffi", data[:32])
    assert sign == b"POINTCACHE2\0"
    return tuple(head), np.frombuffer(data[32:], "<f4").reshape(head[-1], head[1], 3)


def test_every_frame_of_an_action_is_solved_and_shown(arm: bpy.types.Object, tmp_path: Path) -> None:
    scene = bpy.context.scene
    rest, blended = mesh.rest(arm), {frame: shown(arm, frame) for frame in (1, 6, 11)}
    assert farthest(blended[11], rest) > 1.0
    scene.frame_set(7)
    assert bpy.ops.pliant.animate() == {"FINISHED"}
    assert scene.frame_current == 7, "the scene is where it was"
    first, second = arm.modifiers
    assert (first.name, first.type, second.name) == ("Pliant Animation", "MESH_CACHE", "Armature")
    assert not second.show_viewport and not second.show_render
    assert first.filepath == "//bar-bend_it.pc2" and (first.frame_start, first.frame_scale) == (1, 1)
    head, frames = read(tmp_path / "bar-bend_it.pc2")
    assert head == (1, len(rest), 1, 1, 11)
    wanted = command_line(arm, tmp_path, range(1, 12))
    for frame in (1, 6, 11):
        assert farthest(shown(arm, frame), wanted[frame - 1]) < 1e-6, f"frame {frame} is what the command line makes"
        held = farthest(shown(arm, frame), blended[frame])
        assert held < 0.35, f"frame {frame} is the same moment as the blend's: {held}"
    assert farthest(shown(arm, 11), blended[11]) > 0.01, "and another way"
    assert farthest(shown(arm, 1), rest) < 0.01
    assert farthest(shown(arm, 11), shown(arm, 20)) == 0, "after the last frame it stays"
    assert np.array_equal(mesh.rest(arm), rest) and arm.data.shape_keys is None
    assert "11 frames in bar-bend_it.pc2" in arm.pliant.told and not list(tmp_path.glob("*.part"))


def test_bones_follow_exactly_wherever_the_objects_are(arm: bpy.types.Object) -> None:
    rig = skin.modifier(arm).object
    bound = skin.skin(arm, rig)
    assert (bound.bones, bound.parents) == (["low", "high"], [-1, 0]), "what does not deform is not a joint"
    assert np.allclose(bound.weights.sum(axis=1), 1), "shares sum to one, whatever the groups say"
    # The objects move, too: what the modifier does counts, not where the world is.
    for frame, x in ((1, 5.0), (11, 9.0)):
        rig.location.x = x
        rig.keyframe_insert("location", frame=frame)
    matrices = skin.sample(arm, bound, bpy.context.scene, [1, 6, 11])
    points = np.concatenate([mesh.rest(arm), np.ones((len(mesh.rest(arm)), 1))], axis=1)
    for k, frame in enumerate((1, 6, 11)):
        moved = matrices[k + 1] @ np.linalg.inv(matrices[0])
        blend = sum(
            bound.weights[:, j, None] * np.einsum("vij,vj->vi", moved[bound.joints[:, j]], points) for j in range(8)
        )
        assert farthest(blend[:, :3], shown(arm, frame)) < 1e-5, f"blended, frame {frame} is what Blender shows"


def test_it_can_be_done_again_in_part_and_from_the_armature(arm: bpy.types.Object, tmp_path: Path) -> None:
    assert bpy.ops.pliant.animate(first=3, last=5) == {"FINISHED"}
    whole = command_line(arm, tmp_path, range(1, 12))
    modifier = arm.modifiers[0]
    assert modifier.frame_start == 3 and read(tmp_path / "bar-bend_it.pc2")[0] == (1, 202, 3, 1, 3)
    rig = arm.modifiers["Armature"].object
    bpy.context.view_layer.objects.active = rig
    turn(rig, {21: 0.0})
    bpy.context.scene.render.fps = 30
    assert bpy.ops.pliant.animate(refine=2, frames="ACTION") == {"FINISHED"}
    assert [m.type for m in arm.modifiers] == ["MESH_CACHE", "ARMATURE"], "the modifier is the same one"
    assert modifier.filepath == "//bar-bend_it-2.pc2" and modifier.frame_start == 1
    assert (tmp_path / "bar-bend_it.pc2").exists(), "what undo goes back to is there"
    assert len(read(tmp_path / "bar-bend_it-2.pc2")[1]) == 21
    assert farthest(shown(arm, 5), whole[4]) < 0.1
    assert bpy.ops.pliant.animate(first=4, last=4) == {"FINISHED"}, "one frame is an animation, too"
    assert len(read(tmp_path / "bar-bend_it-3.pc2")[1]) == 1


def test_undo_brings_the_armature_back(arm: bpy.types.Object) -> None:
    before = shown(arm, 11)
    bpy.ops.ed.undo_push(message="before")
    assert bpy.ops.pliant.animate() == {"FINISHED"}
    bpy.ops.ed.undo_push(message="animated")
    bpy.ops.ed.undo()
    object = bpy.data.objects["bar"]
    assert [m.type for m in object.modifiers] == ["ARMATURE"] and object.modifiers[0].show_viewport
    assert farthest(shown(object, 11), before) < 1e-6


def refusal(words: str, folder: Path, **how: object) -> None:
    object = bpy.context.object
    before = [(m.type, m.show_viewport) for m in object.modifiers]
    with pytest.raises(RuntimeError, match=f"(?i){words}"):
        bpy.ops.pliant.animate(**how)
    assert before == [(m.type, m.show_viewport) for m in object.modifiers]
    assert not list(folder.glob("*.pc2*")), "nothing is left behind"


def full(*_: object) -> None:
    raise OSError(28, "No space left on device")


def test_what_cannot_be_animated_is_said(arm: bpy.types.Object, tmp_path: Path, monkeypatch) -> None:
    rig = skin.modifier(arm).object
    second = arm.modifiers.new("Another", "ARMATURE")
    second.object = rig
    refusal('"Armature", "Another" all deform it', tmp_path)
    arm.modifiers.remove(second)
    arm.modifiers["Armature"].use_vertex_groups = False
    refusal("takes no vertex groups", tmp_path)
    arm.modifiers["Armature"].use_vertex_groups = True
    subdivided = arm.modifiers.new("Smooth it", "SUBSURF")
    refusal('"Smooth it" change the vertex count', tmp_path)
    arm.modifiers.remove(subdivided)
    arm.vertex_groups["low"].name, arm.vertex_groups["high"].name = "left", "right"
    refusal('no vertex group of "bar" is called as a bone of "rig"', tmp_path)
    arm.vertex_groups["left"].name, arm.vertex_groups["right"].name = "low", "high"
    action = rig.animation_data.action
    rig.animation_data.action = None
    refusal('the armature "rig" has no action', tmp_path)
    rig.animation_data.action = action
    monkeypatch.setattr(link.preferences, "way", lambda: ("not an address", "", ""))
    refusal("HOST:PORT", tmp_path)
    monkeypatch.undo()
    monkeypatch.setattr(cache.Writer, "write", full)
    refusal("no space left", tmp_path)
    monkeypatch.undo()
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.object.empty_add()
    assert not bpy.ops.pliant.animate.poll(), "only on a mesh or an armature"


def test_a_file_that_was_never_saved_has_no_place_for_a_cache(
    arm: bpy.types.Object, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(cache.bpy, "data", type("Data", (), {"filepath": ""})())
    with pytest.raises(mesh.Refusal, match="save the .blend file first"):
        cache.path_for("bar-walk")


class Watched:
    """Stands for the operator as Blender's window runs it: an event at a time."""

    first, last, refine, frames = 0, -1, -1, "SCENE"
    _asked, _named = True, {}
    _begin, _step, _span, _drop, _end = (
        getattr(animate.PLIANT_OT_animate, name) for name in ("_begin", "_step", "_span", "_drop", "_end")
    )

    def __init__(self, object: bpy.types.Object) -> None:
        self.said: list[str] = []
        self._run, self._waiting = None, [object]
        nothing = lambda *_, **__: None
        manager = SimpleNamespace(event_timer_add=nothing, modal_handler_add=nothing, event_timer_remove=nothing)
        self.context = SimpleNamespace(
            window=None,
            scene=bpy.context.scene,
            window_manager=manager,
            workspace=SimpleNamespace(status_text_set=self.said.append),
        )
        self._begin(self.context)

    def report(self, kind: set[str], line: str) -> None:
        self.said.append(line)

    def event(self, kind: str) -> set[str]:
        return animate.PLIANT_OT_animate.modal(self, self.context, SimpleNamespace(type=kind, value="PRESS"))


def test_a_window_is_told_how_far_it_is_and_escape_leaves_nothing(arm: bpy.types.Object, tmp_path: Path) -> None:
    watched = Watched(arm)
    assert arm.pliant.running and not bpy.ops.pliant.animate.poll(), "one at a time"
    for _ in range(4):
        assert watched.event("TIMER") == {"RUNNING_MODAL"}
    assert watched.said[-1] == "Pliant: frame 3 of 11; Escape cancels"
    assert watched.event("MOUSEMOVE") == {"PASS_THROUGH"}
    assert watched.event("ESC") == {"CANCELLED"}
    assert not list(tmp_path.glob("*.pc2*")) and not arm.pliant.running
    assert [m.type for m in arm.modifiers] == ["ARMATURE"] and arm.modifiers[0].show_viewport
    watched = Watched(arm)
    answers = [watched.event("TIMER") for _ in range(14)]
    assert answers[-1] == {"FINISHED"} and {"FINISHED"} not in answers[:-1]
    assert len(read(tmp_path / "bar-bend_it.pc2")[1]) == 11 and not arm.pliant.running
