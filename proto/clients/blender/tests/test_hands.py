"""What hands do first: handles from what is selected, several objects, frames of the scene, results by name."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import bpy
import numpy as np
import pytest
from mathutils import Matrix, Vector
from test_addon import Operator, farthest, held, move, until_shown
from test_addon import bar as bar  # noqa: F401  (a fixture)
from test_animate import arm as arm  # noqa: F401
from test_animate import read, turn

import pliant_addon
from pliant_addon import chosen, drag, handles, link, mesh, panel, results


@pytest.fixture
def pair(bar: bpy.types.Object) -> Iterator[tuple[bpy.types.Object, bpy.types.Object]]:
    """The bar, and a copy of it with a mesh of its own, elsewhere; both selected."""
    other = bar.copy()
    other.data = bar.data.copy()
    other.name = "sleeve"
    other.location = (5, -1, 1)
    bpy.context.scene.collection.objects.link(other)
    for object in (bar, other):
        object.select_set(True)
    bpy.context.view_layer.update()
    yield bar, other


def select(*objects: bpy.types.Object, above: float = -9.0, below: float = 9.0) -> None:
    """Enters Edit Mode with the vertices between two heights selected."""
    for object in objects:
        bpy.ops.object.mode_set(mode="OBJECT")
        bpy.ops.object.select_all(action="DESELECT")
        bpy.context.view_layer.objects.active = object
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.select_all(action="DESELECT")
        bpy.ops.object.mode_set(mode="OBJECT")
        heights = mesh.rest(object)[:, 2]
        object.data.vertices.foreach_set("select", ((heights > above) & (heights < below)).tolist())
    for object in objects:
        object.select_set(True)
    bpy.context.view_layer.objects.active = objects[0]
    bpy.ops.object.mode_set(mode="EDIT")


def key(object: bpy.types.Object, name: str) -> np.ndarray:
    return mesh.shape(object.data.shape_keys.key_blocks[name])


def test_selected_vertices_become_handles_and_are_solved(bar: bpy.types.Object) -> None:
    assert not bpy.ops.pliant.handle_selected.poll(), "in Object Mode nobody sees what is selected"
    select(bar, below=0.3)
    assert bpy.ops.pliant.handle_selected(kind="HOLD") == {"FINISHED"}
    assert bar.mode == "OBJECT", "dragging and undo are of Object Mode"
    select(bar, above=3.7)
    assert bpy.ops.pliant.handle_selected(kind="MOVE", name="tip") == {"FINISHED"}
    assert [(h.group, h.kind) for h in bar.pliant.handles] == [("Hold", "HOLD"), ("tip", "MOVE")]
    for made, by_hand in (("Hold", "base"), ("tip", "top")):
        assert np.array_equal(mesh.group_weights(bar, made), mesh.group_weights(bar, by_hand))
    control = bar.pliant.handles["tip"].control
    middle = mesh.rest(bar)[mesh.group_weights(bar, "tip") > 0].mean(axis=0)
    bpy.context.view_layer.update()
    assert (control.matrix_world.translation - bar.matrix_world @ Vector(middle.tolist())).length < 1e-5
    move(bar, control, 0.8)
    assert bpy.ops.pliant.solve() == {"FINISHED"}
    assert farthest(key(bar, "Pliant"), mesh.rest(bar)) > 0.1


def test_selecting_nothing_is_told_and_names_are_never_taken_from_a_group(bar: bpy.types.Object) -> None:
    select(bar, above=99.0)
    with pytest.raises(RuntimeError, match="No vertex is selected"):
        bpy.ops.pliant.handle_selected(kind="HOLD")
    assert bar.mode == "EDIT" and not bar.pliant.handles, "the hand goes on where it was"
    before = mesh.group_weights(bar, "top")
    select(bar, below=0.3)
    assert bpy.ops.pliant.handle_selected(kind="HOLD", name="top") == {"FINISHED"}
    assert bar.pliant.handles[0].group == "top.001"
    assert np.array_equal(mesh.group_weights(bar, "top"), before)


def test_undo_takes_a_handle_of_selected_vertices_away(bar: bpy.types.Object) -> None:
    select(bar, above=3.7)
    bpy.ops.ed.undo_push(message="selected")
    assert bpy.ops.pliant.handle_selected(kind="MOVE", name="tip") == {"FINISHED"}
    bpy.ops.ed.undo_push(message="Handle")
    bpy.ops.ed.undo()
    object = bpy.data.objects["bar"]
    assert not object.pliant.handles and "tip" not in object.vertex_groups
    assert "bar tip" not in bpy.data.objects, "nor is its control left"


def test_several_meshes_follow_one_control(pair: tuple[bpy.types.Object, bpy.types.Object]) -> None:
    select(*pair, below=0.3)
    assert bpy.ops.pliant.handle_selected(kind="HOLD") == {"FINISHED"}
    select(*pair, above=3.7)
    assert bpy.ops.pliant.handle_selected(kind="MOVE", name="tip") == {"FINISHED"}
    control = pair[0].pliant.handles["tip"].control
    assert control == pair[1].pliant.handles["tip"].control
    bpy.context.view_layer.update()
    for object in pair:
        assert np.allclose(handles.poses(object)["tip"], np.eye(4), atol=1e-5), "it starts at rest for both"
    control.matrix_world = Matrix.Translation((0.5, 0, 0)) @ control.matrix_world
    bpy.context.view_layer.update()
    assert bpy.ops.pliant.solve() == {"FINISHED"}
    for object in pair:
        moved = key(object, "Pliant") - mesh.rest(object)
        tip = mesh.group_weights(object, "tip") > 0
        world = moved[tip] @ np.array(object.matrix_world.to_3x3()).T
        assert np.allclose(world, (0.5, 0, 0), atol=1e-4), object.name
    # The control alone is active, as after it was moved: it stands for the meshes that follow it.
    bpy.ops.object.select_all(action="DESELECT")
    bpy.context.view_layer.objects.active = control
    assert set(chosen.meshes(bpy.context)) == set(pair) and bpy.ops.pliant.solve.poll()
    assert chosen.shown(bpy.context) in pair
    assert bpy.ops.pliant.rest() == {"FINISHED"}
    bpy.context.view_layer.update()
    assert np.allclose(handles.poses(pair[1])["tip"], np.eye(4), atol=1e-5)
    bpy.context.view_layer.objects.active = pair[0]
    pair[0].pliant.active = 1
    assert bpy.ops.pliant.remove_handle() == {"FINISHED"}
    assert pair[1].pliant.handles["tip"].control == control, "the other one follows it still"


def test_several_meshes_are_dragged_kept_and_given_back_together(
    pair: tuple[bpy.types.Object, bpy.types.Object],
) -> None:
    for object in pair:
        bpy.context.view_layer.objects.active = object
        # Their matrices differ by what is rounded; at the default tolerance so may the number of cycles.
        object.pliant.tolerance = 1e-8
        control = held(object)
        move(object, control, 0.5)
    operator = Operator(*pair)
    assert operator.invoke(operator, None) == {"RUNNING_MODAL"} and all(object.pliant.running for object in pair)
    for dragged in operator._drags:
        until_shown(dragged)
    assert operator.event("ESC") == {"CANCELLED"}
    assert [object.data.shape_keys for object in pair] == [None, None]
    assert operator.invoke(operator, None) == {"RUNNING_MODAL"}
    assert operator.event("RET") == {"FINISHED"}
    assert farthest(key(pair[0], "Pliant"), key(pair[1], "Pliant")) < 1e-5, "both are bent alike"
    assert not any(object.pliant.running for object in pair)
    pair[1].modifiers.new("Twice", "ARRAY")
    with pytest.raises(RuntimeError, match="Twice"):
        bpy.ops.pliant.solve()
    assert operator.invoke(operator, None) == {"CANCELLED"} and "Twice" in operator.reports[-1]
    assert not any(object.pliant.running for object in pair)


def test_meshes_that_are_one_are_refused_together(pair: tuple[bpy.types.Object, bpy.types.Object]) -> None:
    for object in pair:
        bpy.context.view_layer.objects.active = object
        move(object, held(object), 0.5)
    pair[1].data = pair[0].data
    with pytest.raises(RuntimeError, match="share one mesh"):
        bpy.ops.pliant.solve()
    assert pair[0].data.shape_keys is None


def test_baking_takes_every_frame_that_the_scene_plays_for_all_objects(
    pair: tuple[bpy.types.Object, bpy.types.Object],
) -> None:
    for object in pair:
        bpy.context.view_layer.objects.active = object
        control = held(object)
        for frame, angle in ((3, 0.0), (6, 0.6)):
            move(object, control, angle)
            control.keyframe_insert("rotation_quaternion", frame=frame)
            control.keyframe_insert("location", frame=frame)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 3, 6
    assert bpy.ops.pliant.bake() == {"FINISHED"}
    for object in pair:
        names = [one.name for one in object.data.shape_keys.key_blocks]
        assert names == ["Basis", *(f"Pliant {frame:04d}" for frame in (3, 4, 5, 6))], object.name
    scene.use_preview_range, scene.frame_preview_start, scene.frame_preview_end = True, 4, 5
    for object in pair:
        object.pliant.result = "Swing"
    assert bpy.ops.pliant.bake() == {"FINISHED"}
    blocks = pair[1].data.shape_keys.key_blocks
    assert [one.name for one in blocks if one.name != "Basis" and not one.mute] == ["Swing 0004", "Swing 0005"]


def test_a_result_has_the_name_that_it_is_given_and_is_shown_alone(bar: bpy.types.Object) -> None:
    control = held(bar)
    shown = {}
    for name, angle in (("Nod", 0.5), ("Bow", 1.0)):
        bar.pliant.result = name
        move(bar, control, angle)
        assert bpy.ops.pliant.solve() == {"FINISHED"}
        evaluated = bar.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
        flat = np.empty(3 * len(evaluated.vertices), np.float32)
        evaluated.vertices.foreach_get("co", flat)
        shown[name] = flat.reshape(-1, 3)
        assert farthest(shown[name], key(bar, name)) < 1e-5, f"{name} is what is seen, not the sum of both"
    assert [one.name for one in bar.data.shape_keys.key_blocks] == ["Basis", "Nod", "Bow"]
    assert farthest(shown["Nod"], shown["Bow"]) > 0.1
    bar.pliant.result = "Third"
    dragged = drag.Drag(bar, bpy.context.evaluated_depsgraph_get())
    until_shown(dragged)
    assert bar.data.shape_keys.key_blocks["Bow"].mute
    dragged.cancel()
    assert [one.name for one in bar.data.shape_keys.key_blocks] == ["Basis", "Nod", "Bow"]
    assert not bar.data.shape_keys.key_blocks["Bow"].mute and bar.pliant.shown == "Bow"
    assert bpy.ops.pliant.solve(name="By Script") == {"FINISHED"}
    bar.pliant.result = "  "
    assert results.name(bar) == "Pliant", "no name is none"


def test_frames_of_the_scene_are_animated_under_a_name(arm: bpy.types.Object, tmp_path: Path) -> None:
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 2, 5
    assert bpy.ops.pliant.animate(name="shot 7") == {"FINISHED"}
    head, frames = read(tmp_path / "shot_7.pc2")
    assert head[2] == 2 and len(frames) == 4
    assert bpy.ops.pliant.animate(frames="ACTION") == {"FINISHED"}
    assert len(read(tmp_path / "bar-bend_it.pc2")[1]) == 11
    rig = arm.modifiers["Armature"].object
    other = arm.copy()
    other.data = arm.data.copy()
    other.name = "sleeve"
    other.modifiers.remove(other.modifiers["Pliant Animation"])
    other.modifiers["Armature"].show_viewport = True
    scene.collection.objects.link(other)
    arm.select_set(True)
    other.select_set(True)
    turn(rig, {11: 0.5})
    assert bpy.ops.pliant.animate(name="both") == {"FINISHED"}
    assert [len(read(tmp_path / f"{name}-both.pc2")[1]) for name in ("bar", "sleeve")] == [4, 4]


@pytest.mark.parametrize(
    ("system", "told"), [("win32", "no server runs on Windows"), ("darwin", "no program is made for macOS")]
)
def test_where_no_server_runs_it_is_said_before_anything_is_tried(
    bar: bpy.types.Object, monkeypatch: pytest.MonkeyPatch, system: str, told: str
) -> None:
    move(bar, held(bar), 0.5)
    monkeypatch.setattr(link.sys, "platform", system)
    monkeypatch.delenv("PLIANT_BIN", raising=False)
    monkeypatch.setattr(link.shutil, "which", lambda _: None)
    try:
        with pytest.raises(RuntimeError, match=f"(?i){told}.*Server"):
            bpy.ops.pliant.solve()
        lines: list[str] = []
        monkeypatch.setattr(panel, "_words", lambda layout, text, width, icon="ERROR": lines.append(text))

        class Layout:
            """Stands for Blender's layout, which needs a window."""

            def __getattr__(self, name: str):
                return lambda *a, **k: Layout()

        class Shown:
            layout = Layout()

        class Context:
            object, scene, region = bar, bpy.context.scene, type("Region", (), {"width": 240})

        pliant_addon.panel.PLIANT_PT_sidebar.draw(Shown, Context)
        assert told in lines[0], "the panel says it before a button is pressed"
        monkeypatch.setattr(pliant_addon.preferences, "way", lambda: ("http://127.0.0.1:7411", "", ""))
        assert link.refusal() == "", "a server elsewhere is all that it takes"
    finally:
        monkeypatch.undo()
