"""Key frames: the controls' animation becomes shape keys that take turns."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import bpy
import numpy as np

from . import chosen, handles, link, mesh, results
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


def bake(
    objects: list[bpy.types.Object], scene: bpy.types.Scene, listed: list[int], progress=lambda done: None
) -> None:
    """Shape keys of each object, one a frame, keyed so that they follow one another and blend in between."""
    chosen.check(objects, bpy.context.evaluated_depsgraph_get())
    back = scene.frame_current
    done = 0
    solved = []
    try:
        for object in objects:
            shapes = []
            for frame in link.session(object).drag(
                poses_at(object, scene, listed), commit=True, **link.options(object)
            ):
                shapes.append(frame.positions)
                link.result(object, frame)
                done += 1
                progress(done)
            solved.append(shapes)
    finally:
        scene.frame_set(back)
    for object, shapes in zip(objects, solved):
        _write(object, listed, shapes)
    scene.frame_set(back)


def _write(object: bpy.types.Object, listed: list[int], shapes: list[np.ndarray]) -> None:
    """The shapes of the frames as shape keys that take turns."""
    names = [f"{results.name(object)} {number:04d}" for number in listed]
    with _straight_keys():
        for name, positions in zip(names, shapes):
            mesh.write(object, mesh.key(object, name), positions, value=0.0)
        for at, (name, number) in enumerate(zip(names, listed)):
            key = mesh.key(object, name)
            for other in listed[max(0, at - 1) : at + 2]:
                key.value = 1.0 if other == number else 0.0
                key.keyframe_insert("value", frame=other)
    results.show(object, names)


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

    first: bpy.props.IntProperty(name="First Frame", default=0, options={"SKIP_SAVE"})
    last: bpy.props.IntProperty(
        name="Last Frame", description="Before the first: the scene's frame range", default=-1, options={"SKIP_SAVE"}
    )
    step: bpy.props.IntProperty(name="Step", description="1 bakes every frame", default=1, min=1)

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only on meshes, and not while one is being dragged."""
        return chosen.are_idle(chosen.meshes(context))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Asks for the frames."""
        self.first, self.last = chosen.frames(context.scene)
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Bakes."""

        def work() -> None:
            meant = chosen.meshes(context)
            whole = self.last < self.first
            listed = frames(*(chosen.frames(context.scene) if whole else (self.first, self.last)), self.step)
            manager = context.window_manager
            manager.progress_begin(0, len(listed) * len(meant))
            try:
                bake(meant, context.scene, listed, manager.progress_update)
            finally:
                manager.progress_end()

        return act(self, work)


CLASSES = (PLIANT_OT_bake,)
