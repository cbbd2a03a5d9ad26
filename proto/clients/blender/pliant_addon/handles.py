"""Handles: vertex groups that are held, or that follow a control object."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np
from mathutils import Matrix

from . import mesh

_KINDS = [
    ("HOLD", "Hold", "The group stays where it is"),
    ("MOVE", "Move", "The group follows its control object"),
]
_VOLUME = [
    ("AUTO", "Automatic", "Keeps the volume of closed parts"),
    ("OFF", "Surface", "Treats the mesh as a thin surface"),
    ("REQUIRED", "Required", "Refuses meshes without an inside"),
]
_COMPONENTS = [
    ("FOLLOW", "Follow", "Parts without a handle move along with the nearest part that has one"),
    ("HOLD", "Hold", "Parts without a handle stay where they are"),
]


class PliantHandle(bpy.types.PropertyGroup):
    """One vertex group as a handle."""

    group: bpy.props.StringProperty(name="Vertex Group")
    kind: bpy.props.EnumProperty(name="Kind", items=_KINDS)
    control: bpy.props.PointerProperty(
        name="Control", type=bpy.types.Object, description="Move, turn or scale this object to move the group"
    )
    rest: bpy.props.FloatVectorProperty(
        size=16, description="Where the control was, in the mesh's space, when the handle was made; row by row"
    )
    stiffness: bpy.props.FloatProperty(
        name="Stiffness",
        description="0 holds exactly; above it the group pulls, each vertex by its weight",
        min=0.0,
        soft_max=100.0,
    )


class PliantSettings(bpy.types.PropertyGroup):
    """What an object's deformation depends on."""

    handles: bpy.props.CollectionProperty(type=PliantHandle)
    active: bpy.props.IntProperty()
    volume_graph: bpy.props.EnumProperty(name="Volume", items=_VOLUME)
    components: bpy.props.EnumProperty(name="Loose Parts", items=_COMPONENTS)
    tolerance: bpy.props.FloatProperty(
        name="Tolerance", description="Relative residual to reach", default=1e-4, min=1e-12, max=1.0, precision=8
    )
    refine: bpy.props.IntProperty(
        name="Refine",
        description="Rotation re-fits of a final result; -1: 4, and more around folds; 0 is the quickest",
        default=-1,
        min=-1,
        max=100,
    )
    result: bpy.props.StringProperty(
        name="Result",
        description="What the shape key of a result is called; baked ones add their frame. Other results are muted",
        default=mesh.KEY,
    )
    shown: bpy.props.StringProperty(
        options={"HIDDEN"}, description="Shape keys of the result that is shown, one a line"
    )
    running: bpy.props.BoolProperty(options={"SKIP_SAVE", "HIDDEN"})
    told: bpy.props.StringProperty(options={"SKIP_SAVE", "HIDDEN"}, description="What the last result was like")


def from_selected(objects: list[bpy.types.Object], kind: str, name: str) -> str:
    """Makes the selected vertices of each mesh a vertex group and a handle; all of them get one control.

    Answers the name of the groups, which no vertex group of these meshes had before.
    """
    selected = {object: mesh.selected(object) for object in objects}
    selected = {object: vertices for object, vertices in selected.items() if vertices}
    if not selected:
        raise mesh.Refusal("no vertex is selected: select those to hold or to move in Edit Mode")
    wanted = name.strip() or dict((key, label) for key, label, _ in _KINDS)[kind]
    called, number = wanted, 1
    while any(called in object.vertex_groups for object in selected):
        called, number = f"{wanted}.{number:03d}", number + 1
    control = None
    for object, vertices in selected.items():
        object.vertex_groups.new(name=called).add(vertices, 1.0, "REPLACE")
        control = add(object, called, kind, control).control
    return called


def add(object: bpy.types.Object, group: str, kind: str, control: bpy.types.Object | None = None) -> PliantHandle:
    """Makes a vertex group a handle; one that moves follows `control`, or gets one in the middle of the group."""
    weights = mesh.group_weights(object, group)
    handle = next((h for h in object.pliant.handles if h.group == group), None)
    if handle is None:
        handle = object.pliant.handles.add()
        object.pliant.active = len(object.pliant.handles) - 1
    handle.name = handle.group = group
    handle.kind = kind
    if kind == "MOVE" and handle.control is None:
        if control is None:
            control = _new_control(object, group, mesh.rest(object)[weights > 0])
        handle.control = control
        _remember(handle, object.matrix_world.inverted_safe() @ control.matrix_world)
    return handle


def _new_control(object: bpy.types.Object, group: str, points: np.ndarray) -> bpy.types.Object:
    middle = points.mean(axis=0)
    control = bpy.data.objects.new(f"{object.name} {group}", None)
    control.empty_display_type = "SPHERE"
    control.empty_display_size = float(np.linalg.norm(points - middle, axis=1).max() or 1.0)
    control.rotation_mode = "QUATERNION"
    for collection in object.users_collection or [bpy.context.scene.collection]:
        collection.objects.link(control)
    control.matrix_world = object.matrix_world @ Matrix.Translation(middle.tolist())
    return control


def _remember(handle: PliantHandle, mesh_from_control: Matrix) -> None:
    handle.rest = [number for row in mesh_from_control for number in row]


def rest_matrix(handle: PliantHandle) -> Matrix:
    """Where the control was when the handle was made, in the mesh's space."""
    numbers = list(handle.rest)
    return Matrix([numbers[4 * row : 4 * row + 4] for row in range(4)])


def to_rest(object: bpy.types.Object) -> None:
    """Puts every control back to the rest pose of its handle."""
    for handle in object.pliant.handles:
        if handle.control is not None:
            handle.control.matrix_world = object.matrix_world @ rest_matrix(handle)


def regions(object: bpy.types.Object) -> dict[str, tuple[np.ndarray, float]]:
    """The weights and the stiffness of each handle, in the order of the list."""
    if not object.pliant.handles:
        raise mesh.Refusal(
            f'"{object.name}" has no handle: select vertices in Edit Mode and press Hold or Move Selected'
        )
    if not any(handle.kind == "MOVE" for handle in object.pliant.handles):
        raise mesh.Refusal("no handle moves: make one of kind Move")
    return {h.group: (mesh.group_weights(object, h.group), h.stiffness) for h in object.pliant.handles}


def declare(session: Any, named: dict[str, tuple[np.ndarray, float]]) -> None:
    """Sends the handles to a session."""
    session.clear_handles()
    for group, (weights, stiffness) in named.items():
        if stiffness > 0:
            session.handle(group, weights=weights, stiffness=stiffness)
        else:
            session.handle(group, vertices=weights > 0)


def poses(object: bpy.types.Object, depsgraph: bpy.types.Depsgraph | None = None) -> dict[str, np.ndarray]:
    """Where the handles are: a matrix in the mesh's space for each one that moves.

    With a dependency graph, controls and mesh are taken as constraints, parents and animation leave them.
    """

    def world(thing: bpy.types.Object) -> Matrix:
        return (thing.evaluated_get(depsgraph) if depsgraph is not None else thing).matrix_world

    mesh_from_world = world(object).inverted_safe()
    found = {}
    for handle in object.pliant.handles:
        if handle.kind != "MOVE":
            continue
        if handle.control is None:
            raise mesh.Refusal(f'the handle "{handle.group}" has no control object: remove it and add it again')
        now_from_rest = mesh_from_world @ world(handle.control) @ rest_matrix(handle).inverted_safe()
        found[handle.group] = np.array(now_from_rest, dtype=np.float64)
    return found


CLASSES = (PliantHandle, PliantSettings)
