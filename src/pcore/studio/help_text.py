"""Words of the page that do not change."""

HELP = """
| | |
|---|---|
| **Orbit, move, zoom** | left, right button, wheel |
| **Put a handle** | Ctrl-click the object; it holds the place until it is dragged |
| **Drag** | the ball, or the arrows and rings of the selected one |
| **Select points** | drag a box with Shift; with Ctrl-Shift it adds |
| **Undo, redo** | Ctrl-Z, Ctrl-Shift-Z |
| **Save** | Ctrl-S |
| **Back, take away** | Escape while dragging, Delete for the selected handle |
| **Freeze, let go** | H, Shift-H |
| **Key, play** | I, space |
| **Overlay, whole object** | O, F |

Red dots: space folds there. Let go and the handle returns to the last good place; hold less still
(freeze fewer points), or drag less far.
"""

TOUR = (
    "**1 of 4.** Ctrl-click the snail's head: a handle appears.",
    "**2 of 4.** Drag the ball, or the arrows around it. Ctrl-Z takes it back.",
    "**3 of 4.** In *Edit* add a twist and move its slider.",
    "**4 of 4.** In *Files* save it; the command line there makes the same picture.",
    "That was the tour. Ctrl-click more places: handles that rest hold what is around them.",
)
"""Of the demo, one step after another."""
SAID = {"anchors": "handles"}
"""What the page calls kinds of edit that edit files call otherwise."""
NO_EDIT = "*No edits yet.* Ctrl-click the object to put a handle on it, or add an edit above."
NO_BOX = "Drag a box with Shift held."
