"""Pixels that a straightened photo does not show: no loss, figure or hull looks at them."""

from dataclasses import dataclass, replace

import pytest
import torch
from torch import Tensor

from capture_files import WIDTH, write_colmap
from pcore.capture.load import load_scene
from pcore.data.scene import View
from pcore.evaluation.protocol import STANDARD, measure
from pcore.geometry.camera import Camera
from pcore.render.image import Image
from pcore.training.config import PatchConfig
from pcore.training.held_out import mean_scores
from pcore.training.hull import hull_points
from pcore.training.losses import photometric
from pcore.training.patches import Patch, draw_patch


@pytest.fixture(scope="module")
def bent(tmp_path_factory: pytest.TempPathFactory) -> View:
    """A view whose corners are not valid."""
    root = tmp_path_factory.mktemp("bent")
    write_colmap(root, cameras={1: ("SIMPLE_RADIAL", WIDTH, 16, [20.0, 12.0, 8.0, 0.2])})
    return load_scene(root).split("train")[0]


def patch_of(view: View) -> Patch:
    return draw_patch(
        [view],
        PatchConfig(side=99),
        "white",
        torch.Generator().manual_seed(0),
        torch.device("cpu"),
    )


def test_a_bent_view(bent: View) -> None:
    valid = bent.valid()
    assert valid is not None
    assert 0.5 < float(valid.float().mean()) < 0.99
    assert not bool(bent.rgba()[~valid].any())
    assert not bent.has_alpha
    coarse = replace(bent.image, factor=8).valid()
    assert coarse is not None
    assert torch.equal(coarse, valid.reshape(2, 8, 3, 8).all(dim=3).all(dim=1))


def test_a_crop_moves_the_camera_and_what_is_valid(bent: View) -> None:
    part = bent.cropped((4, 2, 14, 16)).cropped((1, 1, 9, 12))
    valid, whole = part.valid(), bent.valid()
    assert valid is not None
    assert whole is not None
    assert torch.equal(valid, whole[3:14, 5:13])
    assert torch.equal(part.rgba(), bent.rgba()[3:14, 5:13])
    ray, same = part.camera.rays().directions, bent.camera.rays().directions[3:14, 5:13]
    torch.testing.assert_close(ray, same)


def test_patches_and_their_losses(bent: View) -> None:
    patch, valid = patch_of(bent), bent.valid()
    assert valid is not None
    assert patch.valid is not None
    assert torch.equal(patch.valid, valid)
    rgb = torch.where(valid[..., None], patch.rgb, torch.rand(16, WIDTH, 3)).requires_grad_()
    plane = torch.ones(16, WIDTH)
    image = Image(rgb=rgb, alpha=plane, depth=plane, surface=torch.ones(16, WIDTH, 3))
    losses = photometric(
        image,
        patch,
        opacity_weight=1.0,
        lpips_weight=1.0,
        perceptual=lambda a, b: (a - b).square().mean(),
    )
    assert float(losses.total.detach()) == 0.0
    losses.total.backward()
    assert not bool(rgb.grad.any()), "nothing is learned from pixels without content"


def test_figures(bent: View) -> None:
    valid = bent.valid()
    assert valid is not None

    def draw(view: View) -> Tensor:
        wrong = torch.where(valid[..., None], view.rgba()[..., :3] + 0.1, 0.3)
        return wrong.clamp(0, 1)

    found = mean_scores([bent], torch.ones(3), draw)
    shown = bent.rgba()[..., :3][valid]
    error = ((shown + 0.1).clamp(0, 1) - shown).square().mean()
    assert found["psnr"] == pytest.approx(float(-10 * torch.log10(error)), abs=1e-4)


def test_tables(bent: View) -> None:
    rgba, valid = bent.rgba(), bent.valid()
    assert valid is not None
    wrong = torch.where(valid[..., None], rgba[..., :3], 0.3)
    scores = measure(STANDARD, wrong, rgba, None, valid.numpy())
    assert scores.psnr == float("inf")
    assert scores.ssim == 1.0
    assert measure(STANDARD, wrong, rgba, None).psnr < 20


@dataclass(frozen=True)
class Silhouette:
    """A view that shows the object all over, but says nothing about one half."""

    camera: Camera
    knows: bool

    def alpha(self) -> Tensor:
        alpha = torch.ones(24, 24)
        alpha[:, :12] = 0.0
        return alpha

    def valid(self) -> Tensor | None:
        valid = torch.ones(24, 24, dtype=torch.bool)
        valid[:, :12] = False
        return valid if self.knows else None


@pytest.mark.parametrize("knows", [True, False])
def test_hulls(knows: bool) -> None:
    pose = torch.eye(4)
    pose[2, 3] = 4.0
    camera = Camera.from_fov(pose, width=24, height=24, angle_x=0.8)
    whole = Silhouette(camera=camera, knows=knows)
    other = replace(whole, camera=camera.moved(torch.diag(torch.tensor([-1.0, 1, -1, 1])) @ pose))
    box = torch.full((3,), 0.5)
    if not knows:
        with pytest.raises(Exception, match="no common inside"):
            hull_points(50, [whole, other], -box, box, generator=torch.Generator(), resolution=16)
        return
    points = hull_points(50, [whole, other], -box, box, generator=torch.Generator(), resolution=16)
    assert float(points[:, 0].min()) < -0.3
    assert float(points[:, 0].max()) > 0.3
