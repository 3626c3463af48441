"""The kinds of edit by the name that an edit file gives them; a new kind is two more lines."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from pcore.editing.anchors_edit import AnchorsEdit
from pcore.editing.cage_edit import CageEdit
from pcore.editing.edits import (
    BendEdit,
    Edit,
    RigidEdit,
    ScaleEdit,
    StretchEdit,
    TaperEdit,
    TwistEdit,
)
from pcore.editing.part import PartEdit
from pcore.editing.shapes import DisplacementEdit, MeshEdit

AnyEdit = Annotated[
    TwistEdit
    | BendEdit
    | TaperEdit
    | StretchEdit
    | ScaleEdit
    | RigidEdit
    | PartEdit
    | CageEdit
    | MeshEdit
    | DisplacementEdit
    | AnchorsEdit,
    Field(discriminator="type"),
]

EDIT_TYPES: dict[str, type[Edit]] = {
    "twist": TwistEdit,
    "bend": BendEdit,
    "taper": TaperEdit,
    "stretch": StretchEdit,
    "scale": ScaleEdit,
    "rigid": RigidEdit,
    "part": PartEdit,
    "cage": CageEdit,
    "mesh": MeshEdit,
    "displacement": DisplacementEdit,
    "anchors": AnchorsEdit,
}
