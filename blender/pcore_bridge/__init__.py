"""pcore bridge: pose captured objects in Blender and hand the edits back.

Files are the contract: a bundle that `pcore blender export` wrote, and edit files. Nothing of
pcore is imported.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, StringProperty
from bpy.types import AddonPreferences, Operator, Panel

from .bundle import BridgeError, open_bundle
from .cameras import add_cameras, export_cameras
from .edits import export_edit
from .frames import BEHIND, COMPOSITOR, PLANE, import_frames
from .rendering import command_of, last_words, start
from .rigging import add_cage, add_handle, add_lattice, bind_armature
from .scene import CAGE, POINTS, PROXY, add_bundle, bundle_of, root_of

_MODES = (
    ("anchors", "Anchors", "Empties that were dragged or turned"),
    ("cage", "Cage", "The cage, however it was bent"),
    ("mesh", "Proxy", "The proxy mesh, however it was posed"),
    ("points", "Points", "The points themselves, moved by modifiers"),
)
_BENT = (
    (CAGE, "Cage", "The cage, for an edit by it"),
    (PROXY, "Proxy", "The proxy mesh, for an edit by it"),
    (POINTS, "Points", "The points themselves"),
)
_WHERE = (
    (BEHIND, "Behind the camera", "In the viewport, behind what the camera sees"),
    (PLANE, "On a plane", "Before the camera, at the distance of the object; it renders"),
    (COMPOSITOR, "Compositor", "Under the render"),
)


class PcorePreferences(AddonPreferences):
    bl_idname = __package__

    program: StringProperty(name="pcore", subtype="FILE_PATH", default="pcore")

    def draw(self, _context):
        self.layout.prop(self, "program")


class _Guarded(Operator):
    """What all operators share: errors that the user can mend become reports."""

    bl_options = {"REGISTER", "UNDO"}

    def execute(self, context):
        try:
            said = self.work(context)
        except BridgeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.report({"INFO"}, said)
        return {"FINISHED"}


class PCORE_OT_import_bundle(_Guarded):
    """Import a bundle that `pcore blender export` wrote"""

    bl_idname = "pcore.import_bundle"
    bl_label = "Import bundle"

    filepath: StringProperty(subtype="FILE_PATH")
    filter_glob: StringProperty(default="bundle.json", options={"HIDDEN"})
    with_cameras: BoolProperty(name="Cameras", default=True)

    def invoke(self, context, _event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def work(self, context):
        bundle = open_bundle(bpy.path.abspath(self.filepath))
        root = add_bundle(context, bundle)
        cameras = add_cameras(root, bundle) if self.with_cameras else []
        if cameras and context.scene.camera is None:
            context.scene.camera = cameras[0]
        context.scene.render.fps = max(1, round(bundle.about["fps"]))
        context.view_layer.objects.active = root
        return f"{root.name}: {bundle.about['point_count']} points, {len(cameras)} cameras"


class PCORE_OT_export_edit(_Guarded):
    """Write an edit file for pcore beside the bundle"""

    bl_idname = "pcore.export_edit"
    bl_label = "Export edit"

    mode: EnumProperty(name="What", items=_MODES)
    moving: BoolProperty(name="All frames", default=True)
    name: StringProperty(name="File", default="edit.json")

    def invoke(self, context, _event):
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context):
        path, notes = export_edit(context, self.mode, self.name, moving=self.moving)
        for note in notes:
            self.report({"WARNING"}, note)
        return f"wrote {path}"


class PCORE_OT_export_cameras(_Guarded):
    """Write the scene's camera at every frame beside the bundle"""

    bl_idname = "pcore.export_cameras"
    bl_label = "Export camera path"

    moving: BoolProperty(name="All frames", default=True)
    name: StringProperty(name="File", default="camera_path.json")

    def invoke(self, context, _event):
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context):
        return f"wrote {export_cameras(context, self.name, moving=self.moving)}"


class PCORE_OT_import_frames(_Guarded):
    """Show pictures of pcore with what the camera sees"""

    bl_idname = "pcore.import_frames"
    bl_label = "Import frames"

    directory: StringProperty(subtype="DIR_PATH")
    where: EnumProperty(name="Where", items=_WHERE)

    def invoke(self, context, _event):
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def work(self, context):
        folder = Path(bpy.path.abspath(self.directory))
        image, notes = import_frames(context, folder, self.where)
        for note in notes:
            self.report({"WARNING"}, note)
        return f"{image.name}: {self.where}, with {context.scene.camera.name}"


class PCORE_OT_add_handle(_Guarded):
    """Put an empty to drag on the object, at the 3D cursor"""

    bl_idname = "pcore.add_handle"
    bl_label = "Add handle"

    def work(self, context):
        return add_handle(context, pin=False)[1]


class PCORE_OT_pin(_Guarded):
    """Hold the object where the 3D cursor is"""

    bl_idname = "pcore.pin"
    bl_label = "Pin"

    def work(self, context):
        return add_handle(context, pin=True)[1]


class PCORE_OT_add_cage(_Guarded):
    """Put the cage back that was deleted"""

    bl_idname = "pcore.add_cage"
    bl_label = "Add cage"

    def work(self, context):
        return f"{add_cage(context).name} is back"


class PCORE_OT_add_lattice(_Guarded):
    """Put a lattice around the cage, the proxy or the points"""

    bl_idname = "pcore.add_lattice"
    bl_label = "Add lattice"

    what: EnumProperty(name="Around", items=_BENT)
    resolution: IntProperty(name="Points a side", default=3, min=2, max=32)

    def invoke(self, context, _event):
        return context.window_manager.invoke_props_dialog(self)

    def work(self, context):
        return f"{add_lattice(context, self.what, self.resolution).name} bends the {self.what}"


class PCORE_OT_bind_armature(_Guarded):
    """Make bones at the selected anchors, which carry them and bend the proxy"""

    bl_idname = "pcore.bind_armature"
    bl_label = "Bind armature"

    chain: BoolProperty(name="One after the other", default=True)

    def work(self, context):
        armature = bind_armature(context, chain=self.chain)
        return f"{armature.name}: {len(armature.data.bones)} bones"


class PCORE_OT_render(Operator):
    """Render an edit file with pcore; Esc stops it"""

    bl_idname = "pcore.render"
    bl_label = "Render with pcore"

    edit: StringProperty(name="Edit", default="edit.json")
    cameras: StringProperty(name="Camera path", default="")
    run: StringProperty(name="Run", subtype="DIR_PATH")
    program: StringProperty(name="pcore", options={"HIDDEN"})

    def invoke(self, context, _event):
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context):
        try:
            self._begin(context)
        except (BridgeError, OSError, ValueError) as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        if bpy.app.background:
            self._process.wait()
            return self._end(context)
        self._timer = context.window_manager.event_timer_add(0.5, window=context.window)
        context.window_manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context, event):
        if event.type == "ESC":
            self._process.terminate()
            self._process.wait()
            context.window_manager.event_timer_remove(self._timer)
            self.report({"WARNING"}, "stopped")
            return {"CANCELLED"}
        if event.type != "TIMER" or self._process.poll() is None:
            return {"PASS_THROUGH"}
        context.window_manager.event_timer_remove(self._timer)
        return self._end(context)

    def _begin(self, context):
        bundle = bundle_of(root_of(context))
        self._folder = bundle.folder
        addon = context.preferences.addons.get(__package__)
        program = self.program or (addon.preferences.program if addon else "pcore")
        run = bpy.path.abspath(self.run) if self.run else ""
        fps = round(context.scene.render.fps / context.scene.render.fps_base)
        frames = bundle.folder / "frames"
        words = command_of(bundle, program, run, self.edit, self.cameras, frames, fps)
        self._process = start(words, bundle.folder)

    def _end(self, context):
        if self._process.returncode:
            self.report({"ERROR"}, f"pcore: {last_words(self._folder)}")
            return {"CANCELLED"}
        try:
            import_frames(context, self._folder / "frames")
        except BridgeError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        return {"FINISHED"}


class PCORE_PT_panel(Panel):
    bl_label = "pcore"
    bl_idname = "PCORE_PT_panel"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "pcore"

    def draw(self, _context):
        for operator in _OPERATORS:
            self.layout.operator(operator.bl_idname)


_OPERATORS = (
    PCORE_OT_import_bundle,
    PCORE_OT_add_handle,
    PCORE_OT_pin,
    PCORE_OT_add_cage,
    PCORE_OT_add_lattice,
    PCORE_OT_bind_armature,
    PCORE_OT_export_edit,
    PCORE_OT_export_cameras,
    PCORE_OT_render,
    PCORE_OT_import_frames,
)
_CLASSES = (PcorePreferences, *_OPERATORS, PCORE_PT_panel)


def register():
    for one in _CLASSES:
        bpy.utils.register_class(one)


def unregister():
    for one in reversed(_CLASSES):
        bpy.utils.unregister_class(one)
