"""Key frames: the controls' animation becomes shape keys that take turns."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np

from . import handles, link, mesh
from .operators import act


def frames(first: int, last: int, step: int) -> list[int]:
    """The frames to bake; the last one always among them."""
    if last < first:
        raise mesh.Refusal(f"the last frame {last} lies before the first, {first}")
    listed = list(range(first, last + 1, step))
    return listed if listed[-1] == last else [*listed, last]


def poses_at(object: bpy.types.Object, scene: bpy.types.Scene, listed: list[int]) -> Iterator[dict[str, np.ndarray]]:
    """Where the handles are at each frame. Leaves the scene at the last one."""
    for frame in listed:
        scene.frame_set(frame)
        yield handles.poses(object, bpy.context.evaluated_depsgraph_get())


def bake(object: bpy.types.Object, scene: bpy.types.Scene, listed: list[int], progress=lambda done: None) -> None:
    """A shape key for every frame of `listed`, keyed so that they follow one another and blend in between."""
    depsgraph = bpy.context.evaluated_depsgraph_get()
    mesh.check(object, depsgraph)
    session = link.session(object)
    back = scene.frame_current
    solved = []
    try:
        for frame in session.drag(poses_at(object, scene, listed), commit=True, **link.options(object)):
            solved.append(frame.positions)
            link.result(object, frame)
            progress(len(solved))
    finally:
        scene.frame_set(back)
    with _straight_keys():
        for number, positions in zip(listed, solved):
            key = mesh.key(object, f"{mesh.KEY} {number:04d}")
            mesh.write(object, key, positions, value=0.0)
        for at, number in enumerate(listed):
            key = mesh.key(object, f"{mesh.KEY} {number:04d}")
            for other in listed[max(0, at - 1) : at + 2]:
                key.value = 1.0 if other == number else 0.0
                key.keyframe_insert("value", frame=other)
    _silence(object)
    scene.frame_set(back)


def _silence(object: bpy.types.Object) -> None:
    """The key of single solves would add to the baked ones."""
    single = object.data.shape_keys.key_blocks.get(mesh.KEY)
    if single is not None:
        single.value = 0.0


@contextmanager
def _straight_keys() -> Iterator[None]:
    """New key frames blend linearly meanwhile, so that the weights of two neighbours add up to one."""
    edit = bpy.context.preferences.edit
    before = edit.keyframe_new_interpolation_type
    edit.keyframe_new_interpolation_type = "LINEAR"
    try:
        yield
    finally:
        edit.keyframe_new_interpolation_type = before


class PLIANT_OT_bake(bpy.types.Operator):
    """Solve every frame of the controls' animation into shape keys that take turns"""

    bl_idname = "pliant.bake"
    bl_label = "Bake Key Frames"
    bl_options = {"REGISTER", "UNDO"}

    first: bpy.props.IntProperty(name="First Frame", default=1)
    last: bpy.props.IntProperty(name="Last Frame", default=50)
    step: bpy.props.IntProperty(name="Step", default=5, min=1)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only on a mesh that is not being dragged."""
        object = context.object
        return object is not None and object.type == "MESH" and not object.pliant.running

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Asks for the frames."""
        self.first, self.last = context.scene.frame_start, context.scene.frame_end
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Bakes."""

        def work() -> None:
            listed = frames(self.first, self.last, self.step)
            manager = context.window_manager
            manager.progress_begin(0, len(listed))
            try:
                bake(context.object, context.scene, listed, manager.progress_update)
            finally:
                manager.progress_end()

        return act(self, work)


CLASSES = (PLIANT_OT_bake,)
