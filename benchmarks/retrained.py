"""One edit file on two runs of the same object: does the surface move by the same field?

    python -m benchmarks.retrained RUN OTHER SCENE EDIT [EDIT ...]

RUN and OTHER were trained with different seeds, so their points lie elsewhere. A run with learned
skinning uses it, as the commands do. Both fields are
evaluated at the vertices of the true canonical mesh; differences are in percent of the diagonal of
its bounding box.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

import pcore
from pcore.evaluation.ground_truth import load_truth

_MOVES = 1e-3


def main() -> None:
    """Print a row per edit file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", type=Path, nargs=2, metavar="RUN")
    parser.add_argument("scene", type=Path)
    parser.add_argument("edits", type=Path, nargs="+", metavar="EDIT")
    wish = parser.parse_args()
    truth = load_truth(wish.scene)
    surface = torch.from_numpy(truth.vertices(None)).float()
    subjects = [pcore.load(run) for run in wish.runs]
    print(
        "| edit | vertices that move | largest move | mean difference of those | 99 % | largest |"
    )
    print("|---|---|---|---|---|---|")
    for path in wish.edits:
        row = compare(pcore.load_edit(path), subjects, surface, truth.object_size())
        print(
            f"| {path.stem} | {' | '.join(f'{100 * value:.2f} %' for value in row)} |", flush=True
        )


def compare(
    script: pcore.EditScript,
    subjects: list[pcore.Asset],
    surface: torch.Tensor,
    size: float,
) -> tuple[float, ...]:
    """Shares and lengths of the table's columns; lengths in units of the object's size."""
    first, second = (script.bind(one.points, rig=one.rig)(surface) - surface for one in subjects)
    difference = (first - second).norm(dim=1) / size
    length = first.norm(dim=1) / size
    moves = torch.maximum(length, second.norm(dim=1) / size) > _MOVES
    return (
        float(moves.float().mean()),
        float(length.max()),
        float(difference[moves].mean()),
        float(difference.quantile(0.99)),
        float(difference.max()),
    )


if __name__ == "__main__":
    main()
