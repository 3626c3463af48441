"""What an edit needs of the folder of a run: its points, and the weights that it learned."""

from __future__ import annotations

from pathlib import Path

from torch import Tensor

from pcore.editing.anchors import AnchorRig, rig_with
from pcore.files.model_file import load_model
from pcore.files.skinning_file import SKINNING_FILE, load_skinning


def learned_rig(path: Path | str, points: Tensor) -> AnchorRig | None:
    """Anchors of a run with the weights that it learned; None where it learned none.

    Args:
        path: folder of the run; a bare model file has no skinning beside it.
        points: (N, 3) of its model.

    Raises:
        CheckpointError: its skinning is damaged or belongs to other points.
    """
    if not (Path(path) / SKINNING_FILE).is_file():
        return None
    skinning = load_skinning(path, points)
    return rig_with(skinning.paths, skinning)


def points_of_run(path: Path | str) -> tuple[Tensor, AnchorRig | None]:
    """Canonical points (N, 3) of a run or model file, world units, and its `learned_rig`.

    Raises:
        CheckpointError: no model there, or one that is damaged; as `learned_rig`.
    """
    points = load_model(path).cloud.positions
    return points, learned_rig(path, points)
