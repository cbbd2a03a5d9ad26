"""The panel in the 3D view's sidebar."""

from __future__ import annotations

import bpy

from . import chosen, link, mesh


class PLIANT_UL_handles(bpy.types.UIList):
    """The object's handles."""

    def draw_item(self, context, layout, data, item, icon, active_data, active_property, index=0, flt_flag=0) -> None:
        """One handle in a row."""
        missing = item.group not in item.id_data.vertex_groups
        row = layout.row(align=True)
        row.label(text=item.group, icon="ERROR" if missing else "PINNED" if item.kind == "HOLD" else "EMPTY_ARROWS")
        row.prop(item, "kind", text="")


class PLIANT_PT_sidebar(bpy.types.Panel):
    """Handles, and what can be done with them"""

    bl_label = "Pliant"
    bl_idname = "PLIANT_PT_sidebar"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Pliant"

    def draw(self, context: bpy.types.Context) -> None:
        """Draws the panel."""
        layout = self.layout
        object = chosen.shown(context)
        try:
            if link.refusal():
                raise mesh.Refusal(link.refusal())
            if object is not None and object.mode == "EDIT" and object.type == "MESH":
                _selected(layout)
                return
            if object is not None and object.type == "ARMATURE":
                layout.operator("pliant.animate", icon="ARMATURE_DATA")
                return
            mesh.check(object, context.evaluated_depsgraph_get())
        except mesh.Refusal as refusal:
            _words(layout, str(refusal), context.region.width)
            return
        settings = object.pliant
        if settings.running:
            layout.operator("pliant.keep", icon="CHECKMARK")
            layout.label(text="Move the controls; Escape cancels")
        else:
            _handles(layout, settings)
            column = layout.column(align=True)
            column.enabled = len(settings.handles) > 0
            column.prop(settings, "result")
            column.operator("pliant.drag", icon="VIEW_PAN")
            column.operator("pliant.solve", icon="SHAPEKEY_DATA")
            column.operator("pliant.bake", icon="KEYFRAME")
            column.operator("pliant.rest", icon="LOOP_BACK")
            if any(modifier.type == "ARMATURE" for modifier in object.modifiers):
                layout.operator("pliant.animate", icon="ARMATURE_DATA")
        if settings.told:
            _words(layout, settings.told, context.region.width, icon="INFO")


class PLIANT_PT_options(bpy.types.Panel):
    """How the mesh is deformed"""

    bl_label = "Options"
    bl_parent_id = "PLIANT_PT_sidebar"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only for a mesh."""
        object = chosen.shown(context)
        return object is not None and object.type == "MESH"

    def draw(self, context: bpy.types.Context) -> None:
        """Draws the options."""
        self.layout.use_property_split = True
        settings = chosen.shown(context).pliant
        self.layout.enabled = not settings.running
        for name in ("volume_graph", "components", "tolerance", "refine"):
            self.layout.prop(settings, name)


def _selected(layout: bpy.types.UILayout) -> None:
    """What can be done in Edit Mode."""
    row = layout.row(align=True)
    row.operator("pliant.handle_selected", text="Hold Selected", icon="PINNED").kind = "HOLD"
    row.operator("pliant.handle_selected", text="Move Selected", icon="EMPTY_ARROWS").kind = "MOVE"
    layout.label(text="Drag and Solve are in Object Mode")


def _handles(layout: bpy.types.UILayout, settings) -> None:
    row = layout.row()
    row.template_list("PLIANT_UL_handles", "", settings, "handles", settings, "active", rows=3)
    row.column(align=True).operator("pliant.remove_handle", text="", icon="REMOVE")
    row = layout.row(align=True)
    row.operator("pliant.add_handle", text="Hold Group", icon="PINNED").kind = "HOLD"
    row.operator("pliant.add_handle", text="Move Group", icon="EMPTY_ARROWS").kind = "MOVE"
    if 0 <= settings.active < len(settings.handles):
        layout.prop(settings.handles[settings.active], "stiffness")
        if settings.handles[settings.active].kind == "MOVE":
            layout.prop(settings.handles[settings.active], "control")


def _words(layout: bpy.types.UILayout, text: str, width: int, icon: str = "ERROR") -> None:
    """A text in as many lines as it needs."""
    column = layout.column(align=True)
    room = max(16, width // 8)
    line = ""
    for word in text.split():
        if line and len(line) + len(word) + 1 > room:
            column.label(text=line, icon=icon)
            line, icon = "", "BLANK1"
        line = f"{line} {word}".strip()
    column.label(text=line, icon=icon)


CLASSES = (PLIANT_UL_handles, PLIANT_PT_sidebar, PLIANT_PT_options)
