"""Which objects are meant: what is selected, and a control stands for the meshes that it moves."""

from __future__ import annotations

import bpy

from . import mesh


def meshes(context: bpy.types.Context) -> list[bpy.types.Object]:
    """The active mesh, or those that the active control moves, and the selected ones that have handles."""
    active = context.object
    found = [active] if active is not None and active.type == "MESH" else moved_by(active, context.scene)
    found += [
        other
        for other in context.selected_objects
        if other.type == "MESH" and other not in found and other.pliant.handles
    ]
    with_handles = [object for object in found if object.pliant.handles]
    # An active mesh without handles beside selected ones that have some is not the one to deform.
    return with_handles or found[:1]


def shown(context: bpy.types.Context) -> bpy.types.Object | None:
    """The object that the panel is about: the active one, or the mesh that the active control moves."""
    active = context.object
    return next(iter(moved_by(active, context.scene)), active)


def moved_by(control: bpy.types.Object | None, scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The meshes that have a handle which follows a control."""
    if control is None or control.type != "EMPTY":
        return []
    return [
        object
        for object in scene.objects
        if object.type == "MESH" and any(handle.control == control for handle in object.pliant.handles)
    ]


def are_idle(objects: list[bpy.types.Object]) -> bool:
    """Whether there are some, and none is being dragged or animated."""
    return bool(objects) and not any(object.pliant.running for object in objects)


def check(objects: list[bpy.types.Object], depsgraph: bpy.types.Depsgraph) -> None:
    """Refuses meshes that cannot be deformed, alone or together."""
    owners: dict[str, str] = {}
    for object in objects:
        mesh.check(object, depsgraph)
        other = owners.setdefault(object.data.name, object.name)
        if other != object.name:
            raise mesh.Refusal(
                f'"{other}" and "{object.name}" share one mesh: select one of them, or make the mesh single-user'
            )


def frames(scene: bpy.types.Scene) -> tuple[int, int]:
    """The frames that the timeline plays: the scene's, or its preview range."""
    if scene.use_preview_range:
        return scene.frame_preview_start, scene.frame_preview_end
    return scene.frame_start, scene.frame_end
