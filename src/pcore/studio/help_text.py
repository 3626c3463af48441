"""Words of the page that do not change."""

HELP = """
| | |
|---|---|
| **Orbit, move, zoom** | left, right button, wheel |
| **Put a handle** | Ctrl-click the object; it holds the place until it is dragged |
| **Put a pin** | Alt-click: this place stays where it was before the edit |
| **Drag** | the ball, or the arrows and rings of the selected one |
| **Along one axis** | X, Y or Z, also while dragging; once more lets it go |
| **Select points** | drag with Shift; Ctrl-Shift adds, Alt-Shift takes away |
| **With which tool** | R box, B brush, L lasso, G ball along the surface |
| **Reach of handles** | PageUp, PageDown; the dots show where it ends |
| **Undo, redo, save** | Ctrl-Z, Ctrl-Shift-Z, Ctrl-S |
| **Back, take away** | Escape while dragging, Delete for the selected handle |
| **Freeze, unfreeze all** | H, Shift-H |
| **Mirror, next overlay** | M, O |
| **Key, play** | I, space |
| **Whole object, this help** | F, K |

Grey balls rest and hold their place. Red dots: space folds there. Let go and the handle returns to
the last good place; freeze fewer points, or drag less far.
"""

TOUR = (
    "**1 of 4.** Ctrl-click the snail's head: a handle appears.",
    "**2 of 4.** Drag the ball, or the arrows around it. Ctrl-Z takes it back.",
    "**3 of 4.** In *Edit* add a twist and move its slider.",
    "**4 of 4.** In *Files* save it; the command line there makes the same picture.",
    "That was the tour. Ctrl-click more places: handles that rest hold what is around them.",
)
"""Of the demo, one step after another."""
NO_EDIT = "*No edits yet.* Ctrl-click the object to put a handle on it, or add an edit above."
NOT_SELECTED = "*Nothing is selected.* Hold Shift and drag over the object."
TOOL_NAMES = {
    "box": "Box (R)",
    "brush": "Brush (B)",
    "lasso": "Lasso (L)",
    "ball": "Ball on the surface (G)",
}
OVERLAY_NAMES = {
    "none": "nothing",
    "strain": "stretched or squeezed",
    "holes": "torn open",
    "handles": "far from all handles",
    "exposed": "seen in no photo",
    "frozen": "frozen",
}
"""What the page calls overlays."""
WORKING = "*Working&hellip;* The first time on a machine takes longer."
LOADING = "*Loading&hellip;* The first picture takes a moment."
