"""Operators that are done at once: handles, a single solve, controls back to rest."""

from __future__ import annotations

import bpy

from . import handles, link, mesh


def act(operator: bpy.types.Operator, work) -> set[str]:
    """Runs an operator's work; what it refuses is reported, not raised."""
    try:
        work()
    except Exception as error:
        if not link.is_failure(error):
            raise
        operator.report({"ERROR"}, link.words(error))
        return {"CANCELLED"}
    return {"FINISHED"}


class _OnMesh:
    """What operators on a mesh have in common."""

    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only on a mesh, and not while it is being dragged."""
        object = context.object
        return object is not None and object.type == "MESH" and not object.pliant.running


class PLIANT_OT_add_handle(_OnMesh, bpy.types.Operator):
    """Make the active vertex group a handle"""

    bl_idname = "pliant.add_handle"
    bl_label = "Add Handle"

    kind: bpy.props.EnumProperty(name="Kind", items=handles._KINDS)
    group: bpy.props.StringProperty(name="Vertex Group", description="Empty takes the active one")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Adds the handle."""

        def work() -> None:
            object = context.object
            if object.mode == "EDIT":
                raise mesh.Refusal("leave Edit Mode first")
            active = object.vertex_groups.active
            name = self.group or (active.name if active is not None else "")
            if not name:
                raise mesh.Refusal("the object has no vertex group: make one of the vertices to hold or move")
            handles.add(object, name, self.kind)

        return act(self, work)


class PLIANT_OT_remove_handle(_OnMesh, bpy.types.Operator):
    """Take the handle away, and its control; the vertex group stays"""

    bl_idname = "pliant.remove_handle"
    bl_label = "Remove Handle"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Removes the active handle."""

        def work() -> None:
            settings = context.object.pliant
            if not 0 <= settings.active < len(settings.handles):
                raise mesh.Refusal("no handle is selected")
            control = settings.handles[settings.active].control
            settings.handles.remove(settings.active)
            settings.active = max(0, settings.active - 1)
            if control is not None:
                bpy.data.objects.remove(control)

        return act(self, work)


class PLIANT_OT_solve(_OnMesh, bpy.types.Operator):
    """Deform the mesh to where the controls are, into a shape key"""

    bl_idname = "pliant.solve"
    bl_label = "Solve"

    name: bpy.props.StringProperty(name="Shape Key", default=mesh.KEY)

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Solves and writes the key."""

        def work() -> None:
            object = context.object
            depsgraph = context.evaluated_depsgraph_get()
            mesh.check(object, depsgraph)
            poses = handles.poses(object, depsgraph)
            frame = link.session(object).solve_frame(poses, **link.options(object))
            mesh.write(object, mesh.key(object, self.name), frame.positions)
            link.result(object, frame)

        return act(self, work)


class PLIANT_OT_rest(_OnMesh, bpy.types.Operator):
    """Put all controls back to where their groups are at rest"""

    bl_idname = "pliant.rest"
    bl_label = "Controls to Rest"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Moves the controls."""
        return act(self, lambda: handles.to_rest(context.object))


CLASSES = (PLIANT_OT_add_handle, PLIANT_OT_remove_handle, PLIANT_OT_solve, PLIANT_OT_rest)
