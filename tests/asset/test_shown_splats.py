"""Any object as splats, at rest and while a session moves it."""

from pathlib import Path

import pytest
import torch
from tests.asset.test_gaussian_content import an_asset

import pcore
from pcore.asset.asset import Asset
from pcore.errors import InputError
from seeded_runs import write_runs

EYE = torch.tensor([0.0, -3.0, 0.5])
TWIST = {"type": "twist", "axis": "z", "angle_deg": 40}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return write_runs(tmp_path_factory.mktemp("splats"))


@pytest.fixture(params=["gaussians", "points", "lit points"])
def asset(request: pytest.FixtureRequest, runs: dict[str, Path]) -> Asset:
    if request.param == "gaussians":
        return an_asset(degree=2)
    return pcore.load(runs["lit" if request.param == "lit points" else "plain"])


def test_a_session_shows_what_its_pose_shows(asset: Asset) -> None:
    session = asset.session()
    state = session.do(TWIST)
    shown = asset.splats(state, EYE)
    posed = asset.splats(asset.pose(state, light="baked"), EYE)
    assert len(shown) == len(asset)
    for part in ("centers", "covariances", "rgb", "opacities"):
        one, other = (torch.from_numpy(getattr(each, part)) for each in (shown, posed))
        assert bool(one.isfinite().all())
        torch.testing.assert_close(one, other, rtol=1e-3, atol=1e-5)
    still = asset.splats(None, EYE)
    session.undo()
    assert (asset.splats(session, EYE).centers == still.centers).all()
    assert abs(shown.centers - still.centers).max() > 0.01


def test_the_light_of_what_was_posed_last_is_shown(runs: dict[str, Path]) -> None:
    asset = pcore.load(runs["lit"])
    posed = asset.pose({"version": 2, "edits": [{"type": "rigid", "axis": "x", "angle_deg": 90}]})
    gains = asset.gains_of(posed)
    assert gains is not None
    assert float((gains - 1).abs().max()) > 0.01
    lit = asset.splats(posed, EYE)
    rest = asset.splats(None, EYE, gains=gains)
    baked = asset.splats(None, EYE)
    assert (lit.rgb == rest.rgb).all()
    torch.testing.assert_close(
        torch.from_numpy(lit.rgb),
        (torch.from_numpy(baked.rgb) * gains.unsqueeze(1)).clamp(0, 1),
    )


def test_a_session_of_another_object_is_not_shown(asset: Asset) -> None:
    other = pcore.EditSession(torch.zeros(3, 3) + torch.arange(3.0).unsqueeze(1))
    with pytest.raises(InputError, match="points of this asset, got edits of 3 others"):
        asset.splats(other, EYE)


def test_a_light_as_a_second_stage_is_the_light_of_one(runs: dict[str, Path]) -> None:
    asset = pcore.load(runs["lit"])
    edit = {"version": 2, "edits": [{"type": "rigid", "axis": "x", "angle_deg": 90}]}
    baked, lit = asset.pose(edit, light="baked"), asset.pose(edit)
    gains, expected = asset.gains_of(asset.lit(baked)), asset.gains_of(lit)
    assert gains is not None
    assert expected is not None
    assert torch.equal(gains, expected)
    assert asset.gains_of(baked) is None
    kept = asset.gains_of(asset.lit(baked, gains))
    assert kept is not None
    assert torch.equal(kept, gains)
