"""Pliant for Blender: vertex groups become handles, handles are dragged or keyed, results are shape keys;
actions of armatures become point caches.

The topology never changes, and every operator is one step of undo. The mathematics happens in a pliant server: one that
the preferences name, or one that is started on this machine.
"""

from __future__ import annotations

import bpy

from . import animate, bake, drag, handles, link, operators, panel, preferences

_MODULES = (preferences, handles, operators, drag, bake, animate, panel)


def register() -> None:
    """Makes the add-on known to Blender."""
    for module in _MODULES:
        for kind in module.CLASSES:
            bpy.utils.register_class(kind)
    bpy.types.Object.pliant = bpy.props.PointerProperty(type=handles.PliantSettings)


def unregister() -> None:
    """Takes the add-on back, and closes its sessions."""
    link.close_all()
    del bpy.types.Object.pliant
    for module in reversed(_MODULES):
        for kind in reversed(module.CLASSES):
            bpy.utils.unregister_class(kind)
