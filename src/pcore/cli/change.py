"""What an edit did to points, in lines."""

from __future__ import annotations

from torch import Tensor


def change_lines(before: Tensor, after: Tensor) -> list[str]:
    """Extents of points (N, 3) before and after, and how far they went."""
    lines: list[str] = []
    for name, points in (("before", before), ("after", after)):
        lower, upper = points.amin(dim=0).tolist(), points.amax(dim=0).tolist()
        box = "  ".join(
            f"{axis} {lo:.4g} to {hi:.4g}" for axis, lo, hi in zip("xyz", lower, upper, strict=True)
        )
        lines.append(f"  {name}: {box}")
    distance = (after - before).norm(dim=-1)
    mean, most = float(distance.mean()), float(distance.max())
    lines.append(f"  moved by {mean:.4g} on average, {most:.4g} at most")
    return lines


def fold_notes(folded: int, total: int) -> list[str]:
    """Say that an edit folds space at some of the points; nothing where it does not."""
    if not folded:
        return []
    return [
        f"the edit flattens space or turns it inside out at {folded:,} of {total:,} points; a run "
        "would refuse to render it"
    ]
