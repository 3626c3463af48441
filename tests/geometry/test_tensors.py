"""Dataclasses of tensors: how they are shown, moved and chosen from."""

from __future__ import annotations

from dataclasses import replace

import torch

from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.surfels import Surfels


def cloud() -> PointCloud:
    return PointCloud(
        positions=torch.rand(5, 3, requires_grad=True),
        features=torch.rand(5, 2),
        influence=torch.ones(5),
    )


def test_shapes_are_shown_and_no_numbers() -> None:
    assert repr(cloud()) == "PointCloud(positions=[5 x 3], features=[5 x 2], influence=[5])"
    flat = Surfels.at_rest(torch.eye(3), torch.eye(3), torch.zeros(3))
    told = repr(replace(flat, spacing=torch.tensor(0.5)))
    assert told.startswith("Surfels(places=[3 x 3], normals=[3 x 3], heights=[3], beside=[3 x ")
    assert told.endswith(", spacing=0.5)")


def test_what_is_there_already_is_not_made_again() -> None:
    here = cloud()
    assert here.to("cpu") is here
    assert here.to(dtype=torch.float32) is here
    assert here.to(dtype=torch.float64).features.dtype == torch.float64
    assert not here.detached().positions.requires_grad


def test_single_numbers_stay() -> None:
    flat = Surfels.at_rest(torch.eye(3), torch.eye(3), torch.zeros(3))
    flat = replace(flat, spacing=torch.tensor(0.5))
    chosen = flat.each(lambda rows: rows[:2])
    assert len(chosen.places) == len(chosen.beside) == 2
    assert chosen.spacing is flat.spacing
