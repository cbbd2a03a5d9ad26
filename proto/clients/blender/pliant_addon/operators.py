"""Operators that are done at once: handles, a single solve, controls back to rest."""

from __future__ import annotations

import bpy

from . import chosen, handles, link, mesh, results


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
        """Only on meshes, and not while one is being dragged."""
        return chosen.are_idle(chosen.meshes(context))


class PLIANT_OT_handle_selected(bpy.types.Operator):
    """Make the selected vertices a vertex group and a handle, on every mesh that is edited; leaves Edit Mode"""

    bl_idname = "pliant.handle_selected"
    bl_label = "Handle from Selected"
    bl_options = {"REGISTER", "UNDO"}

    kind: bpy.props.EnumProperty(name="Kind", items=handles._KINDS)
    name: bpy.props.StringProperty(name="Name", description="Of the vertex group; empty calls it Hold or Move")

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only in Edit Mode of meshes."""
        return context.mode == "EDIT_MESH"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Adds the handles."""

        def work() -> None:
            edited = list(context.objects_in_mode)
            # Undo in Edit Mode would bring back the mesh alone, and leave handles and controls behind.
            bpy.ops.object.mode_set(mode="OBJECT")
            try:
                called = handles.from_selected(edited, self.kind, self.name)
            except mesh.Refusal:
                bpy.ops.object.mode_set(mode="EDIT")
                raise
            self.report({"INFO"}, f'made the handle "{called}"')

        return act(self, work)


class PLIANT_OT_add_handle(_OnMesh, bpy.types.Operator):
    """Make the active vertex group a handle"""

    bl_idname = "pliant.add_handle"
    bl_label = "Add Handle"

    kind: bpy.props.EnumProperty(name="Kind", items=handles._KINDS)
    group: bpy.props.StringProperty(name="Vertex Group", description="Empty takes the active one")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Adds the handle."""

        def work() -> None:
            object = chosen.shown(context)
            if object.mode == "EDIT":
                raise mesh.Refusal(
                    "in Edit Mode press Hold Selected or Move Selected; vertex groups are taken in Object Mode"
                )
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
            settings = chosen.shown(context).pliant
            if not 0 <= settings.active < len(settings.handles):
                raise mesh.Refusal("no handle is selected")
            control = settings.handles[settings.active].control
            settings.handles.remove(settings.active)
            settings.active = max(0, settings.active - 1)
            if control is not None and not chosen.moved_by(control, context.scene):
                bpy.data.objects.remove(control)

        return act(self, work)


class PLIANT_OT_solve(_OnMesh, bpy.types.Operator):
    """Deform the mesh to where the controls are, into a shape key"""

    bl_idname = "pliant.solve"
    bl_label = "Solve"

    name: bpy.props.StringProperty(name="Shape Key", description="Empty takes the name of the object's settings")

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Solves and writes the key."""

        def work() -> None:
            meant = chosen.meshes(context)
            depsgraph = context.evaluated_depsgraph_get()
            chosen.check(meant, depsgraph)
            solved = []
            for object in meant:
                poses = handles.poses(object, depsgraph)
                solved.append(link.session(object).solve_frame(poses, **link.options(object)))
            # None is changed before all are there.
            for object, frame in zip(meant, solved):
                results.write(object, self.name or results.name(object), frame.positions)
                link.result(object, frame)

        return act(self, work)


class PLIANT_OT_rest(_OnMesh, bpy.types.Operator):
    """Put all controls back to the rest pose of their groups"""

    bl_idname = "pliant.rest"
    bl_label = "Controls to Rest"

    def execute(self, context: bpy.types.Context) -> set[str]:
        """Moves the controls."""

        def work() -> None:
            for object in chosen.meshes(context):
                handles.to_rest(object)

        return act(self, work)


CLASSES = (PLIANT_OT_handle_selected, PLIANT_OT_add_handle, PLIANT_OT_remove_handle, PLIANT_OT_solve, PLIANT_OT_rest)
