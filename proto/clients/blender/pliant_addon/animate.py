"""Actions: what an armature does to a mesh is solved frame by frame, and shown by a Mesh Cache modifier."""

from __future__ import annotations

import bpy
import numpy as np

from . import cache, chosen, link, mesh, skin
from .operators import act

#: Seconds between two looks at what has come.
_BEAT = 0.02


_FRAMES = [
    ("SCENE", "Scene", "What the timeline plays: the scene's frame range, or its preview range"),
    ("ACTION", "Action", "The action of each armature, from its first key to its last"),
    ("RANGE", "Range", "From the first frame to the last one below"),
]


def meshes(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The active and the selected meshes that an armature deforms, and those of selected armatures."""
    active = context.object
    picked = [active, *(other for other in context.selected_objects if other != active)] if active is not None else []
    found = []
    for one in picked:
        if one.type == "ARMATURE":
            found += [other for other in context.scene.objects if other.type == "MESH" and one in _armatures(other)]
        elif one.type == "MESH" and (one == active or _armatures(one)):
            found.append(one)
    found = list(dict.fromkeys(found))
    # An active mesh that nothing deforms is told so, unless others are meant.
    return [object for object in found if _armatures(object)] or found[:1]


def _armatures(object: bpy.types.Object) -> list[bpy.types.Object]:
    return [m.object for m in object.modifiers if m.type == "ARMATURE" and m.object is not None]


def action_name(armature: bpy.types.Object) -> str:
    """What an armature plays: the name of its action; empty where nothing moves it."""
    animated = armature.animation_data
    if animated is None:
        return ""
    if animated.action is not None:
        return animated.action.name
    return "nla" if any(not track.mute and track.strips for track in animated.nla_tracks) else ""


def action_range(armature: bpy.types.Object, scene: bpy.types.Scene) -> tuple[int, int]:
    """First and last frame of the armature's action; those of the scene where it has none of its own."""
    animated = armature.animation_data
    if animated is not None and animated.action is not None:
        first, last = animated.action.frame_range
        return int(np.floor(first)), int(np.ceil(last))
    return chosen.frames(scene)


class Run:
    """One mesh that is being animated: frames come one by one, and nothing is changed until all are there."""

    def __init__(
        self, object: bpy.types.Object, scene: bpy.types.Scene, span: tuple[int, int], refine: int, name: str
    ) -> None:
        first, last = span
        if last < first:
            raise mesh.Refusal(f"the last frame {last} lies before the first, {first}")
        self._object = object
        self._first = first
        self.count = last - first + 1
        self.done = 0
        armature = _checked(object)
        played = action_name(armature)
        if not played:
            raise mesh.Refusal(f'the armature "{armature.name}" has no action')
        bound = skin.skin(object, armature)
        rate = scene.render.fps / scene.render.fps_base
        path = cache.path_for(name or f"{object.name}-{played}")
        matrices = skin.sample(object, bound, scene, range(first, last + 1))
        self._link = link.opened(object, skin.glb(object, bound, matrices, rate))
        try:
            how = {} if refine < 0 else {"refine": refine}
            self._frames = self._link.session.animate(
                0, fps=rate, count=self.count, skip_first=False, root="baked", **how
            )
            self._writer = cache.Writer(path, len(object.data.vertices), first, self.count)
        except BaseException:
            self._link.close()
            raise

    def step(self) -> bool:
        """Takes the next frame; False when there are no more."""
        frame = next(self._frames, None)
        if frame is None:
            return False
        if len(frame.positions) != len(self._object.data.vertices):
            found, wanted = len(frame.positions), len(self._object.data.vertices)
            raise mesh.Refusal(f"the result has {found} vertices, the mesh {wanted}: it was edited meanwhile")
        self._writer.write(frame.positions)
        self.done += 1
        return True

    def finish(self) -> list[str]:
        """Writes the cache and shows it; returns the lines to show."""
        report = self._frames.report
        self._writer.finish()
        self._close()
        cache.show(self._object, self._writer.path, self._first)
        file = self._writer.path.name
        told = f'{self.done} frames in {file}; the Armature modifier is off while "{cache.MODIFIER}" is on'
        if report is not None:
            totals = report.totals
            told += (
                f"; volume {100 * totals.volume_change_mean:+.1f} % in the mean, "
                f"{totals.flipped_triangles_worst} flipped at worst"
            )
        self._object.pliant.told = told
        return [told, *(report.warnings if report is not None else ())]

    def cancel(self) -> None:
        """Leaves everything as it was."""
        self._writer.discard()
        self._close()

    def _close(self) -> None:
        self._frames.close()
        self._link.close()


def _checked(object: bpy.types.Object) -> bpy.types.Object:
    """The armature that deforms a mesh; refuses what cannot be solved."""
    if object.parent is not None and object.parent_type == "ARMATURE":
        raise mesh.Refusal(f'"{object.name}" is deformed by its parent: give it an Armature modifier instead')
    mesh.check(object, bpy.context.evaluated_depsgraph_get())
    modifier = skin.modifier(object)
    if not modifier.use_vertex_groups:
        raise mesh.Refusal(f'the modifier "{modifier.name}" takes no vertex groups, and bones hold vertices by them')
    return modifier.object


class PLIANT_OT_animate(bpy.types.Operator):
    """Solve what the armature's action does to the mesh, every frame, into a point cache that a modifier shows"""

    bl_idname = "pliant.animate"
    bl_label = "Animate with Pliant"
    # Not REGISTER: a changed value would solve all of it again at once.
    bl_options = {"UNDO"}

    frames: bpy.props.EnumProperty(name="Frames", items=_FRAMES)
    first: bpy.props.IntProperty(name="First Frame", default=0, options={"SKIP_SAVE"})
    last: bpy.props.IntProperty(
        name="Last Frame",
        description="A script that gives both needs not say that they are a range",
        default=-1,
        options={"SKIP_SAVE"},
    )
    name: bpy.props.StringProperty(
        name="Name",
        description="Of the point cache; empty calls it after the object and the action",
        options={"SKIP_SAVE"},
    )
    refine: bpy.props.IntProperty(
        name="Refine",
        description="Rotation refinements of each frame; -1: once, starting from the frame before",
        default=-1,
        min=-1,
        max=32,
    )

    _asked = False
    _run: Run | None = None
    _waiting: list[bpy.types.Object] = []
    _running: list[bpy.types.Object] = []
    _named: dict[bpy.types.Object, str] = {}
    _timer = None

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only on meshes, or an armature that deforms some."""
        return chosen.are_idle(meshes(context))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """Asks for the frames."""

        def work() -> None:
            for object in meshes(context):
                _checked(object)

        if "CANCELLED" in act(self, work):
            return {"CANCELLED"}
        self.first, self.last = chosen.frames(context.scene)
        self._asked = True
        return context.window_manager.invoke_props_dialog(self)

    def draw(self, context: bpy.types.Context) -> None:
        """Draws the dialog."""
        self.layout.use_property_split = True
        self.layout.prop(self, "frames")
        if self.frames == "RANGE":
            self.layout.prop(self, "first")
            self.layout.prop(self, "last")
        self.layout.prop(self, "name")
        self.layout.prop(self, "refine")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Solves: in the background where someone looks on and may press Escape, else at once."""
        self._waiting = meshes(context)
        self._named = {
            object: self.name if len(self._waiting) == 1 else f"{object.name}-{self.name}"
            for object in self._waiting
            if self.name
        }
        self._run = None
        if self._asked and context.window is not None:
            self._begin(context)
            return {"RUNNING_MODAL"}

        def work() -> None:
            try:
                while self._step(context):
                    pass
            except BaseException:
                self._drop()
                raise

        return act(self, work)

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> set[str]:
        """One event: a frame at each beat."""
        if event.type == "ESC" and event.value == "PRESS":
            self._drop()
            return self._end(context, {"CANCELLED"})
        if event.type != "TIMER":
            return {"PASS_THROUGH"}
        more = True

        def work() -> None:
            nonlocal more
            more = self._step(context)

        if "CANCELLED" in act(self, work):
            self._drop()
            return self._end(context, {"CANCELLED"})
        if not more:
            return self._end(context, {"FINISHED"})
        if self._run is not None:
            done, count = self._run.done, self._run.count
            context.workspace.status_text_set(f"Pliant: frame {done} of {count}; Escape cancels")
        return {"RUNNING_MODAL"}

    def cancel(self, context: bpy.types.Context) -> None:
        """Blender ends the operator, such as by closing the file."""
        self._drop()
        self._end(context, set())

    def _begin(self, context: bpy.types.Context) -> None:
        self._running = list(self._waiting)
        for object in self._running:
            object.pliant.running = True
        manager = context.window_manager
        self._timer = manager.event_timer_add(_BEAT, window=context.window)
        manager.modal_handler_add(self)

    def _step(self, context: bpy.types.Context) -> bool:
        """A piece of work; False when nothing is left."""
        if self._run is None:
            if not self._waiting:
                return False
            object = self._waiting.pop(0)
            self._run = Run(
                object, context.scene, self._span(object, context.scene), self.refine, self._named.get(object, "")
            )
        elif not self._run.step():
            for line in self._run.finish():
                self.report({"INFO"}, line)
            self._run = None
        return True

    def _span(self, object: bpy.types.Object, scene: bpy.types.Scene) -> tuple[int, int]:
        """The frames that are wanted of a mesh."""
        given = not self._asked and self.last >= self.first
        if given or self.frames == "RANGE":
            return self.first, self.last
        return action_range(_checked(object), scene) if self.frames == "ACTION" else chosen.frames(scene)

    def _drop(self) -> None:
        if self._run is not None:
            self._run.cancel()
            self._run = None

    def _end(self, context: bpy.types.Context, answer: set[str]) -> set[str]:
        context.window_manager.event_timer_remove(self._timer)
        context.workspace.status_text_set(None)
        for object in self._running:
            object.pliant.running = False
        return answer


CLASSES = (PLIANT_OT_animate,)
