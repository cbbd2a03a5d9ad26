"""Preferences: which server, and how it is started."""

from __future__ import annotations

import bpy


class PliantPreferences(bpy.types.AddonPreferences):
    """Where the deformation is computed."""

    bl_idname = __package__

    server: bpy.props.StringProperty(
        name="Server",
        description="http://HOST:PORT or https://HOST:PORT; empty starts a server on this machine",
    )
    token: bpy.props.StringProperty(name="Token", description="Sent to the server with every call", subtype="PASSWORD")
    program: bpy.props.StringProperty(
        name="Program",
        description="The program to start; if empty: PLIANT_BIN, the program of this add-on, or PATH",
        subtype="FILE_PATH",
    )

    def draw(self, context: bpy.types.Context) -> None:
        """Draws the page of the preferences."""
        from . import link  # which asks this module

        if link.refusal():
            self.layout.label(text=link.refusal(), icon="INFO")
        self.layout.prop(self, "server")
        self.layout.prop(self, "token")
        row = self.layout.row()
        row.enabled = not self.server
        row.prop(self, "program")


def way() -> tuple[str, str, str]:
    """Server, token and program as they are set; empty where they are not."""
    addon = bpy.context.preferences.addons.get(__package__)
    if addon is None or addon.preferences is None:
        return "", "", ""
    chosen = addon.preferences
    return chosen.server.strip(), chosen.token, bpy.path.abspath(chosen.program)


CLASSES = (PliantPreferences,)
