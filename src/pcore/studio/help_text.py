"""Words of the page that do not change."""

HELP = """
| | |
|---|---|
| **Camera** | left, right button, wheel; F shows all |
| **Handle** | Ctrl-click; it holds the place until it is dragged |
| **Pin** | Alt-click: stays where it was before the edit |
| **Drag** | the ball, or arrows and rings; Escape puts back |
| **Gizmo** | 1 moves, 2 turns, 3 scales; again: moves and turns |
| **One axis** | X, Y, Z, also in a drag; again: free |
| **Reach** | Shift and the wheel; PageUp, PageDown |
| **Next edit** | Enter: the next handle begins another edit |
| **Remove** | Delete, for the selected handle |
| **Select** | Shift-drag; Ctrl-Shift adds, Alt-Shift removes |
| **Tools** | R box, B brush, L lasso, G ball |
| **Freeze** | H; Shift-H lets everything go |
| **Undo** | Ctrl-Z; Ctrl-Shift-Z does it again |
| **Save** | Ctrl-S |
| **Time** | I keys, space plays, Left and Right step |
| | Shift-Left, Shift-Right: from key to key |
| **View** | C before, P points, O overlay, M mirror, T dark, K this help |

Grey balls hold their place. Red diamonds: space folds there; let go, and the handle returns to the
last good place.
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
GIZMO_NAMES = {
    "all": "moves and turns",
    "move": "moves (1)",
    "turn": "turns (2)",
    "scale": "scales (3)",
}
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
OVERLAY_LEGENDS = {
    "none": "",
    "strain": "Red: stretched to twice or more; blue: squeezed to half or less.",
    "holes": "Orange: torn open, paler where it only begins.",
    "handles": "Teal: moves with no handle near; brown: handles disagree.",
    "exposed": "Yellow: came to light, seen in no photo.",
    "frozen": "Blue: frozen.",
}
"""What their colours mean."""
NO_PHOTOS = "⚠ The photos of this object are not here: what they did not see is not known."
WIDEN = "Allow it with wider soft edges"
FOLDS = "⚠ Space folds at the red diamonds: go back by {}."
NO_SCALE = "Nothing to scale: take an edit with a factor, handles, or one that acts in a ball."
WORKING = "*Working&hellip;* The first time on a machine takes longer."
LOADING = "*Loading&hellip;* The first picture takes a moment."
