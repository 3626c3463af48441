"""The photometric loss: its terms, their weights, and LPIPS weights that are missing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import Tensor

import pcore.data.images
from pcore.data.scene import Scene
from pcore.errors import WeightsError
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.geometry.rays import RayBundle
from pcore.model.hits import Hits
from pcore.model.papr import Papr
from pcore.render.image import Image
from pcore.render.trace import trace
from pcore.training.finetune import finetune
from pcore.training.losses import Losses, mean_of, perceptual_loss, photometric
from pcore.training.patches import Patch
from pcore.training.pretrain import pretrain
from small_training import Heard, box_model, finetune_config, pretrain_config

RGB, ALPHA = torch.rand(4, 5, 3), torch.rand(4, 5)
TRUTH, COVERAGE = torch.rand(4, 5, 3), torch.rand(4, 5)


def image(rgb: Tensor = RGB, alpha: Tensor = ALPHA, spread: Tensor | None = None) -> Image:
    """What a loss looks at; whatever else rays hit does not matter here."""
    hits = Hits(
        neighbours=torch.zeros(20, 1, dtype=torch.int64),
        weights=torch.ones(20, 1),
        background=torch.zeros(20),
        features=torch.zeros(20, 1),
        centroid=torch.zeros(20, 3),
        spread=torch.zeros(20) if spread is None else spread.flatten(),
    )
    return Image(rgb=rgb, alpha=alpha, depth=alpha, surface=rgb, hits=hits)


def patch(alpha: Tensor | None = COVERAGE) -> Patch:
    rays = RayBundle(origins=torch.zeros(4, 5, 3), directions=torch.ones(4, 5, 3))
    return Patch(rays=rays, rgb=TRUTH, alpha=alpha, background=torch.ones(3))


def test_squared_error_alone() -> None:
    rgb = RGB.clone().requires_grad_()
    found = photometric(image(rgb), patch(), opacity_weight=0.0, lpips_weight=0.0, perceptual=None)
    assert list(found.terms) == ["rgb"]
    expected = (RGB - TRUTH).square().mean()
    assert torch.equal(found.squared_error, expected)
    assert not found.squared_error.requires_grad
    found.total.backward()
    assert rgb.grad is not None
    assert torch.allclose(rgb.grad, 2 * (RGB - TRUTH) / RGB.numel())


def test_opacity_and_lpips_enter_with_their_weights() -> None:
    seen: list[tuple[Tensor, Tensor]] = []

    def perceptual(first: Tensor, second: Tensor) -> Tensor:
        seen.append((first, second))
        return torch.tensor([0.5])

    found = photometric(
        image(), patch(), opacity_weight=0.3, lpips_weight=0.01, perceptual=perceptual
    )
    assert float(found.terms["opacity"]) == pytest.approx(
        0.3 * float((ALPHA - COVERAGE).square().mean())
    )
    assert float(found.terms["lpips"]) == pytest.approx(0.005)
    assert float(found.total) == pytest.approx(sum(float(term) for term in found.terms.values()))
    ((first, second),) = seen
    # LPIPS as published: (B, 3, H, W) in [-1, 1].
    assert torch.equal(first, 2 * RGB.permute(2, 0, 1)[None] - 1)
    assert torch.equal(second, 2 * TRUTH.permute(2, 0, 1)[None] - 1)


def test_photos_without_alpha_have_no_opacity_loss() -> None:
    found = photometric(image(), patch(None), opacity_weight=0.3, lpips_weight=0.0, perceptual=None)
    assert list(found.terms) == ["rgb"]


def test_attention_behind_the_first_point_costs_where_the_object_is() -> None:
    spread = torch.rand(4, 5, requires_grad=True)
    alpha = ALPHA.clone().requires_grad_()
    found = photometric(
        image(alpha=alpha, spread=spread),
        patch(),
        opacity_weight=0.0,
        lpips_weight=0.0,
        perceptual=None,
        front_weight=0.2,
    )
    term = found.terms["front"]
    assert term.item() == pytest.approx(0.2 * float((ALPHA * spread.detach()).mean()))
    term.backward()
    # Otherwise turning transparent would be a way out.
    assert alpha.grad is None
    assert spread.grad is not None


def test_points_beyond_the_cut_off_are_not_the_first() -> None:
    base = box_model()
    papr = Papr(replace(base.papr.config, neighbours=2, cutoff=0.2))
    papr.load_state_dict(base.papr.state_dict())
    cloud = PointCloud(
        positions=torch.tensor([[0.0, 0.0, 3.0], [0.5, 0.0, 1.0]]),
        features=torch.zeros(2, papr.config.feature_size),
        influence=torch.ones(2),
    )
    ray = RayBundle(origins=torch.zeros(1, 3), directions=torch.tensor([[0.0, 0.0, 1.0]]))
    hits = trace(papr, PosedCloud.at_rest(cloud), ray)
    assert hits.weights.tolist() == [[1.0, 0.0]]
    assert hits.spread.item() == 0.0


def test_mean_over_patches() -> None:
    def one(rgb: float, **others: float) -> Losses:
        terms = {"rgb": rgb, **others}
        return Losses(
            terms={name: torch.tensor(value) for name, value in terms.items()},
            squared_error=torch.tensor(rgb),
        )

    mean = mean_of([one(1.0, opacity=4.0), one(3.0)])
    assert {name: float(term) for name, term in mean.terms.items()} == {"rgb": 2.0, "opacity": 2.0}
    assert float(mean.squared_error) == 2.0


# --- missing weights --------------------------------------------------------------------------


@pytest.fixture
def no_weights(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name in ("PCORE_LPIPS_DIR", "XDG_CACHE_HOME", "TORCH_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "empty"))
    return tmp_path / "empty"


@pytest.fixture
def no_image(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, **options: object) -> Tensor:
        raise AssertionError(f"{path} was decoded")

    monkeypatch.setattr(pcore.data.images, "read_rgba", refuse)


def test_no_lpips_needs_no_weights(no_weights: Path) -> None:
    assert perceptual_loss(0.0, "vgg", torch.device("cpu")) is None


@pytest.mark.usefixtures("no_image")
def test_pretraining_asks_for_weights_before_anything_else(box: Scene, no_weights: Path) -> None:
    heard = Heard()
    with pytest.raises(WeightsError, match=r"AlexNet.*alexnet") as error:
        pretrain(box, pretrain_config(lpips_weight=0.1, lpips_trunk="alex"), listener=heard)
    assert str(no_weights) in str(error.value)
    assert heard == []


@pytest.mark.usefixtures("no_image")
def test_finetuning_asks_for_weights_before_anything_else(box: Scene, no_weights: Path) -> None:
    heard = Heard()
    with pytest.raises(WeightsError, match="vgg16") as error:
        finetune(box, box_model(), finetune_config(lpips_weight=0.1), listener=heard)
    assert str(no_weights) in str(error.value)
    assert heard == []
