"""Dragging in the viewport: while it runs, the mesh follows its controls.

:class:`Drag` is the work of one drag and knows no window; the operator around it gives it the beat of a timer.
"""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from . import chosen, handles, link, mesh, results

_BEAT = 1 / 60
_HELP = "Pliant: move the controls; Enter keeps, Escape cancels"
_LOST = "Pliant: no connection, trying again; the mesh follows when the server is back. Escape cancels"


class Drag:
    """One drag: poses go out when controls move, frames come in when they are ready, the newest wins."""

    def __init__(self, object: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> None:
        mesh.check(object, depsgraph)
        self._object = object
        session = link.session(object)
        had_keys = object.data.shape_keys is not None
        called = results.name(object)
        existed = had_keys and object.data.shape_keys.key_blocks.get(called) is not None
        self._stream: Any = session.stream(tolerance=object.pliant.tolerance, window=2)
        self._key = mesh.key(object, called)
        self._shown = object.pliant.shown
        self._muted = {key.name: key.mute for key in object.data.shape_keys.key_blocks}
        results.show(object, [called])
        self._before = (mesh.shape(self._key), self._key.value) if existed else None
        self._had_keys = had_keys
        self._sent: dict[str, np.ndarray] | None = None
        self._seq = 0
        #: Whether the newest pose is on the screen.
        self.settled = True
        self._options = link.options(object)
        self._session = session

    @property
    def lost(self) -> bool:
        """Whether the server is away; the newest pose goes out when it is back."""
        return bool(self._stream.lost)

    def step(self, depsgraph: bpy.types.Depsgraph | None = None) -> bool:
        """One beat: sends what moved, shows what came. Whether something was shown."""
        poses = handles.poses(self._object, depsgraph)
        if self._sent is None or any(not np.array_equal(poses[id], self._sent.get(id)) for id in poses):
            self._seq = self._stream.send(poses)
            self._sent = poses
            self.settled = False
        frame = self._stream.latest()
        if frame is None:
            return False
        mesh.write(self._object, self._key, frame.positions)
        link.result(self._object, frame)
        self.settled = frame.final and frame.seq == self._seq
        return True

    def finish(self, depsgraph: bpy.types.Depsgraph | None = None) -> None:
        """Solves the last pose to the end and keeps it."""
        self._stream.close()
        frame = self._session.solve_frame(handles.poses(self._object, depsgraph), **self._options)
        mesh.write(self._object, self._key, frame.positions)
        link.result(self._object, frame)

    def cancel(self) -> None:
        """Gives back the shape key as it was before, or takes it away if there was none."""
        self._stream.close()
        for key in self._object.data.shape_keys.key_blocks:
            key.mute = self._muted.get(key.name, key.mute)
        self._object.pliant.shown = self._shown
        if self._before is not None:
            mesh.write(self._object, self._key, self._before[0], value=self._before[1])
            return
        self._object.shape_key_remove(self._key)
        if not self._had_keys:
            self._object.shape_key_clear()
        self._object.data.update()


class PLIANT_OT_drag(bpy.types.Operator):
    """Follow the controls while they are moved. Enter keeps the result, Escape brings back what was before"""

    bl_idname = "pliant.drag"
    bl_label = "Drag"
    bl_options = {"REGISTER", "UNDO"}

    _drags: list[Drag] = []
    _objects: list[bpy.types.Object] = []
    _timer = None
    _was_lost = False

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only on meshes, and not while one is being dragged."""
        return chosen.are_idle(chosen.meshes(context))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Starts the drag."""
        self._objects, self._drags = chosen.meshes(context), []
        depsgraph = context.evaluated_depsgraph_get()
        try:
            chosen.check(self._objects, depsgraph)
            for object in self._objects:
                self._drags.append(Drag(object, depsgraph))
        except Exception as error:
            self._drop()
            return self._fail(error)
        self._was_lost = False
        for object in self._objects:
            object.pliant.running = True
        manager = context.window_manager
        self._timer = manager.event_timer_add(_BEAT, window=context.window)
        manager.modal_handler_add(self)
        context.workspace.status_text_set(_HELP)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """One event."""
        try:
            if event.type == "ESC" and event.value == "PRESS":
                self._drop()
                return self._end(context, {"CANCELLED"})
            keeps = event.type in {"RET", "NUMPAD_ENTER"} and event.value == "PRESS"
            if keeps or not all(object.pliant.running for object in self._objects):
                for drag in self._drags:
                    drag.finish(context.evaluated_depsgraph_get())
                return self._end(context, {"FINISHED"})
            # All of them are stepped, whichever has news.
            if event.type == "TIMER" and any([drag.step(context.evaluated_depsgraph_get()) for drag in self._drags]):
                for area in context.screen.areas:
                    area.tag_redraw()
            lost = any(drag.lost for drag in self._drags)
            if lost != self._was_lost:
                self._was_lost = lost
                context.workspace.status_text_set(_LOST if lost else _HELP)
        except Exception as error:
            self._drop()
            self._end(context, set())
            return self._fail(error)
        return {"PASS_THROUGH"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator, such as by closing the file."""
        self._drop()
        self._end(context, set())

    def _drop(self) -> None:
        for drag in self._drags:
            drag.cancel()

    def _end(self, context: bpy.types.Context, answer: set[str]) -> set[str]:
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        for object in self._objects:
            object.pliant.running = False
        self._drags = []
        return answer

    def _fail(self, error: Exception) -> set[str]:
        if not link.is_failure(error):
            raise error
        self.report({"ERROR"}, link.words(error))
        return {"CANCELLED"}


class PLIANT_OT_keep(bpy.types.Operator):
    """End the drag and keep its result"""

    bl_idname = "pliant.keep"
    bl_label = "Keep"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only while it is being dragged."""
        return any(object.pliant.running for object in chosen.meshes(context))

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Asks the drag to end at its next beat."""
        for object in chosen.meshes(context):
            object.pliant.running = False
        return {"FINISHED"}


CLASSES = (PLIANT_OT_drag, PLIANT_OT_keep)
