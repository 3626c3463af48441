"""The figures of the paper's tables, as it prints them; they are no baselines of ours."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

Row = tuple[str, tuple[float | str | None, ...]]
COLUMNS = ("psnr", "ssim", "lpips_alex")
"""Metrics of the tables, over whole images; the paper does not name the trunk of its LPIPS."""


@dataclass(frozen=True, kw_only=True)
class Table:
    """One table of the paper.

    Attributes:
        title: what it shows.
        kinds: of the states whose mean is taken, of what is at hand; published sets give all.
        sets: data sets that it is made of, see `benchmarks.paper_scenes`.
        quoted: data set -> rows of the paper: method, PSNR, SSIM, LPIPS, and primitives if given.
    """

    title: str
    kinds: tuple[str, ...]
    sets: tuple[str, ...]
    quoted: Mapping[str, Sequence[Row]]


TABLES = {
    "main": Table(
        title="zero-shot editing",
        kinds=("analytic",),
        sets=("at hand", "Neural Editor", "Objaverse"),
        quoted={
            "Neural Editor": (
                ("Deforming-NeRF", (14.71, 0.722, 0.197, None)),
                ("Neural Editor", (25.62, 0.939, 0.078, "1M")),
                ("SC-GS", (18.55, 0.832, 0.123, "236K")),
                ("Mani-GS", (20.59, 0.875, 0.116, "1.2M")),
                ("PAPR", (24.22, 0.930, 0.066, "30K")),
                ("P-CORE", (25.31, 0.942, 0.054, "30K")),
            ),
            "Objaverse": (
                ("Deforming-NeRF", (15.89, 0.773, 0.180, None)),
                ("Neural Editor", (28.02, 0.956, 0.048, "1M")),
                ("SC-GS", (25.29, 0.929, 0.057, "228K")),
                ("Mani-GS", (26.04, 0.946, 0.069, "362K")),
                ("PAPR", (23.15, 0.940, 0.058, "30K")),
                ("P-CORE", (28.30, 0.965, 0.039, "30K")),
            ),
        },
    ),
    "realistic": Table(
        title="realistic motions",
        kinds=("skeletal",),
        sets=("at hand", "Objaverse hand", "Mixamo running"),
        quoted={
            "Objaverse hand": (
                ("PAPR", (28.55, 0.964, 0.040)),
                ("P-CORE", (29.66, 0.972, 0.028)),
            ),
            "Mixamo running": (
                ("PAPR", (24.40, 0.956, 0.046)),
                ("P-CORE", (29.95, 0.979, 0.021)),
            ),
        },
    ),
    "motion": Table(
        title="beside PAPR-in-Motion, which is trained on the end state",
        kinds=("skeletal",),
        sets=("at hand", "Objaverse"),
        quoted={
            "Objaverse": (
                ("PAPR-in-Motion (geometry)", (26.31, 0.946, 0.044)),
                ("PAPR-in-Motion (geometry + appearance)", (33.46, 0.986, 0.021)),
                ("P-CORE", (28.84, 0.968, 0.030)),
            )
        },
    ),
    "nvs": Table(
        title="novel views before any editing",
        kinds=("canonical",),
        sets=("NeRF-Synthetic", "DTU", "Mip-NeRF 360"),
        quoted={
            "DTU": (
                ("3DGS", (33.77, 0.965, 0.044)),
                ("2DGS", (33.89, 0.966, 0.048)),
                ("Mani-GS", (31.50, 0.943, 0.088)),
                ("P-CORE", (33.48, 0.973, 0.023)),
            ),
            "Mip-NeRF 360": (
                ("3DGS", (26.54, 0.776, 0.266)),
                ("2DGS", (27.03, 0.805, 0.223)),
                ("P-CORE, half resolution", (28.04, 0.808, 0.183)),
            ),
        },
    ),
}

NBS_QUOTED = (
    ("RBF", (25.32, 0.945, 0.054, 0.077, 0.307, 0.409, 0.626)),
    ("NBS", (26.46, 0.952, 0.050, 0.077, 0.303, 0.438, 0.640)),
)
"""Skinning weights on six Objaverse scenes: PSNR, SSIM, LPIPS, CD, EMD, F 0.01, F 0.02."""
