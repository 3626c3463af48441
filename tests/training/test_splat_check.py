from dataclasses import dataclass, replace

import pytest
import torch
from tests.gaussians.some import some_gaussians

from pcore.errors import InputError
from pcore.gaussians.gaussians import Gaussians
from pcore.gaussians.render import Footprint, PosedGaussians, render
from pcore.geometry.camera import Camera
from pcore.training.splat_check import agreement_with, best_agreement, check_agreement

FOOTPRINT = Footprint(variance=0.3, antialiased=False)


@dataclass(frozen=True)
class Photo:
    """A view of a scene that shows what Gaussians show."""

    camera: Camera
    image: torch.Tensor
    has_alpha: bool = True

    def rgba(self) -> torch.Tensor:
        return self.image

    def valid(self) -> None:
        return None


def camera(distance: float) -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = distance
    return Camera(width=32, height=24, fx=30.0, fy=30.0, cx=16.0, cy=12.0, world_from_camera=pose)


def solid() -> Gaussians:
    return replace(some_gaussians(300), opacities=torch.full((300,), 0.9))


def photos_of(
    gaussians: Gaussians, far: float = 0.0, footprint: Footprint = FOOTPRINT
) -> list[Photo]:
    """On black, as a trainer composites them."""
    result = []
    for distance in (far + 3.0, far + 3.5, far + 4.0):
        seen = render(
            PosedGaussians(gaussians=gaussians),
            [camera(distance)],
            footprint=footprint,
            background=torch.zeros(3),
        )
        alpha = seen.alpha[0][..., None]
        color = seen.rgb[0].clamp(0, 1) / alpha.clamp_min(1e-6)
        result.append(Photo(camera(distance), torch.cat([color.clamp(0, 1), alpha], dim=-1)))
    return result


def test_gaussians_agree_with_their_own_photos():
    gaussians = solid()
    found = agreement_with(gaussians, FOOTPRINT, photos_of(gaussians))
    assert found.views == 3
    assert found.psnr > 30
    assert found.overlap is not None
    assert found.overlap > 0.95
    check_agreement(found, where="a.ply", scene="s")


def test_a_moved_world_is_found_out():
    gaussians = solid()
    moved = replace(gaussians, means=gaussians.means + torch.tensor([1.5, 0.0, 0.0]))
    found = agreement_with(moved, FOOTPRINT, photos_of(gaussians))
    with pytest.raises(InputError, match=r"overlap by .*--transform"):
        check_agreement(found, where="a.ply", scene="s")


def test_a_turned_world_is_found_out_however_much_empty_space_agrees():
    one = solid()
    # Bright to the right, dark to the left; far away, so that the pictures are mostly empty.
    side = torch.where(one.means[:, :1] > 0, 1.5, -1.5)
    gaussians = replace(one, sh=side[:, :, None].expand(-1, 1, 3).contiguous())
    photos = photos_of(gaussians, far=9.0)
    turned = replace(gaussians, sh=-gaussians.sh)
    found = agreement_with(turned, FOOTPRINT, photos)
    assert found.overlap is not None
    assert found.overlap > 0.95
    whole = agreement_with(turned, FOOTPRINT, [replace(p, has_alpha=False) for p in photos])
    assert whole.psnr > 15
    with pytest.raises(InputError, match=r"overlap by .*--transform"):
        check_agreement(found, where="a.ply", scene="s")
    doubt = check_agreement(replace(found, psnr=20.0), where="a.ply", scene="s")
    assert doubt is not None
    assert "--variance" in doubt


def test_photos_without_masks_are_judged_by_their_colours():
    gaussians = solid()
    photos = [replace(one, has_alpha=False) for one in photos_of(gaussians)]
    found = agreement_with(gaussians, FOOTPRINT, photos)
    assert found.overlap is None
    check_agreement(found, where="a.ply", scene="s")
    with pytest.raises(InputError, match=r"14\.0 dB: they are"):
        check_agreement(replace(found, psnr=14.0), where="a.ply", scene="s")


def test_the_screen_filter_that_the_photos_were_made_by_is_found():
    small = replace(solid(), scales=solid().scales / 4)
    ours = Footprint()
    assert best_agreement(small, [ours, FOOTPRINT], photos_of(small))[1] == FOOTPRINT
    found, filter_ = best_agreement(small, [FOOTPRINT, ours], photos_of(small, footprint=ours))
    assert filter_ == ours
    assert found == agreement_with(small, ours, photos_of(small, footprint=ours))
    assert found.psnr > agreement_with(small, FOOTPRINT, photos_of(small, footprint=ours)).psnr + 3


def test_a_filter_that_is_hardly_better_is_not_taken():
    gaussians, near = solid(), replace(FOOTPRINT, variance=0.35)
    photos = photos_of(gaussians, footprint=near)
    noise = torch.rand(24, 32, 1, generator=torch.Generator().manual_seed(0)) / 5
    seen = [replace(one, image=one.image * (1 - noise)) for one in photos]
    better = (
        agreement_with(gaussians, near, seen).psnr - agreement_with(gaussians, FOOTPRINT, seen).psnr
    )
    assert 0 < better < 0.5
    assert best_agreement(gaussians, [FOOTPRINT, near], seen)[1] == FOOTPRINT
