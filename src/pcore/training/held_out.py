"""Figures on held-out training views; test views are never looked at."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from statistics import fmean
from typing import Any

import torch
from torch import Tensor

from pcore.data.images import background_color, composite
from pcore.data.scene import View
from pcore.geometry.posed import PosedCloud
from pcore.render.picture import render
from pcore.training.config import Background
from pcore.training.exposure import fitted_exposure
from pcore.training.trained import Trained
from pcore.training.work import Work


def validate(
    model: Trained, views: Sequence[View], background: Background, *, fitted: bool = False
) -> dict[str, float]:
    """Mean PSNR over the views, and of foreground pixels (alpha > 0.5) where there is alpha, dB."""
    color = background_color("white" if background == "random" else background)
    posed = PosedCloud.at_rest(model.cloud)

    def draw(view: View) -> Tensor:
        return render(model.papr, posed, view.camera).rgb.cpu()

    return mean_scores(views, color, draw, fitted=fitted)


def mean_scores(
    views: Sequence[View],
    color: Tensor,
    draw: Callable[[View], Tensor],
    *,
    fitted: bool = False,
) -> dict[str, float]:
    """Figures of `validate` for pictures of any kind.

    Args:
        views: what is compared with.
        color: (3,) background of the photos.
        draw: renders a view over that background, (H, W, 3).
        fitted: also give `fitted_psnr`, under the map of colours that brings every picture closest
            to its photo (`fitted_exposure`); of the object alone where there are masks.
    """
    found: dict[str, list[float]] = {"psnr": [], "foreground_psnr": [], "fitted_psnr": []}
    for view in views:
        rgba, rgb, valid = view.rgba(), draw(view).clamp(0, 1), view.valid()
        photo = composite(rgba, color)
        error = (rgb - photo).square().mean(dim=-1)
        known = torch.ones_like(error, dtype=torch.bool) if valid is None else valid
        found["psnr"].append(_decibels(error[known].mean()))
        solid = rgba[..., 3] > 0.5
        if view.has_alpha and bool(solid.any()):
            found["foreground_psnr"].append(_decibels(error[solid].mean()))
        known = known & solid
        if fitted and bool(known.any()):
            closest = fitted_exposure(rgb[known], photo[known]).clamp(0, 1)
            found["fitted_psnr"].append(_decibels((closest - photo[known]).square().mean()))
    return {name: sum(values) / len(values) for name, values in found.items() if values}


def scores_by_view(
    work: Work[Any],
    views: Sequence[View],
    background: Background,
    weights: Mapping[str, Tensor] | None = None,
) -> list[dict[str, float]]:
    """Figures of every single view, of what is trained or of weights in its place."""
    return [work.scores([view], background, weights) for view in views]


def mean_of_views(scores: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Mean of every figure over the views that have it."""
    names = dict.fromkeys(name for one in scores for name in one)
    return {name: fmean(one[name] for one in scores if name in one) for name in names}


def _decibels(squared_error: Tensor) -> float:
    return float(-10 * torch.log10(squared_error.clamp_min(1e-12)))
