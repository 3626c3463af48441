"""The affine map of a file that some trainers write beside their splats.

nerfstudio moves and scales the world before it trains: x' = scale (A x + b), with the 3 x 4 matrix
[A | b] under "transform" and the number under "scale" of its `dataparser_transforms.json`.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import torch
from pydantic import BaseModel, ConfigDict, Field

from pcore.deform.base import Affine
from pcore.errors import InputError
from pcore.validation import parse, read_json

Row = tuple[float, float, float, float]


class _File(BaseModel):
    model_config = ConfigDict(allow_inf_nan=False)

    transform: Annotated[tuple[Row, ...], Field(min_length=3, max_length=4)]
    scale: Annotated[float, Field(gt=0)] = 1.0


def load_world_transform(path: Path | str) -> Affine:
    """Read the map from the scene's world to that of the splats.

    Raises:
        InputError: missing, not JSON, without "transform", or a matrix that turns space inside out
            or has no inverse.
    """
    path = Path(path)
    data = read_json(path, what="transform file", error=InputError)
    found = parse(_File, data, where=f"transform file {path}", error=InputError)
    matrix = found.scale * torch.tensor(found.transform[:3], dtype=torch.float64)
    if not float(torch.linalg.det(matrix[:, :3])) > 0:
        raise InputError(
            f'transform file {path}: expected "transform" to be a matrix 3 x 4 whose first three '
            "columns turn and scale, got one with a determinant that is not above 0"
        )
    return Affine(matrix[:, :3], matrix[:, 3])
