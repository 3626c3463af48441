"""States of a scene, and scoring of methods on them with a renderer that is perfect."""

import math
from dataclasses import replace
from pathlib import Path

import pytest
import torch

import tiny_scene
from pcore.asset.asset import Asset
from pcore.asset.posed_asset import Posed
from pcore.asset.saving import asset_of
from pcore.errors import InputError, SceneError
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.protocol import PAPR, STANDARD, Perceptual
from pcore.evaluation.runner import ImageRow, Taken, evaluate
from pcore.evaluation.states import CANONICAL, SceneStates, open_states
from pcore.geometry.camera import Camera
from pcore.geometry.surfels import Surfels
from pcore.model.papr import Papr
from pcore.relight.lamps import Light, sphere
from pcore.relight.relighting import Relighting
from pcore.render.image import Image
from tiny_scene import draw_box


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tiny_scene.write_scene(tmp_path_factory.mktemp("scenes") / "box")


@pytest.fixture
def states(scene: Path) -> SceneStates:
    return open_states(scene)


@pytest.fixture
def perfect() -> AssetMethod:
    asset = asset_of(Papr(tiny_scene.CONFIG), tiny_scene.corner_cloud())
    return AssetMethod(name="true", asset=asset, rays="plain", take=draw_box)


def test_a_perfect_renderer_is_perfect_in_every_state(
    states: SceneStates, perfect: AssetMethod
) -> None:
    rows = evaluate([perfect], states.select(["all", "scale:2", "scale:0.5"]))
    kinds = {row.state: row.kind for row in rows}
    assert kinds == {
        "canonical": "canonical",
        "grown": "analytic",
        "walk": "skeletal",
        "scale:2": "analytic",
        "scale:0.5": "analytic",
    }
    assert len(rows) == 5 * 2 * 2  # states, views, protocols
    for row in rows:
        psnr = row.scores["psnr"]
        assert psnr is not None
        assert psnr > 120  # the protocol `papr` compares floats, which round
        assert row.scores["hole_rate"] == 0
        assert row.scores["spill"] == 0
        error = row.scores["depth_error"]
        assert error is not None
        assert error < 1e-5


def test_points_are_carried_and_cameras_scaled(states: SceneStates, perfect: AssetMethod) -> None:
    seen: list[tuple[Posed, Camera]] = []

    def draw(asset: Asset, posed: Posed, camera: Camera) -> Image:
        seen.append((posed, camera))
        return draw_box(asset, posed, camera)

    canonical, grown, scaled = states.select(["grown", "scale:2"])
    evaluate([replace(perfect, take=draw)], [canonical, grown, scaled], protocols=[PAPR])
    start = perfect.asset.points
    torch.testing.assert_close(seen[0][0].points, start)
    torch.testing.assert_close(seen[2][0].points, 1.5 * start)
    torch.testing.assert_close(seen[4][0].points, 2 * start)
    torch.testing.assert_close(seen[4][1].center, 2 * seen[0][1].center)
    torch.testing.assert_close(seen[2][1].center, seen[0][1].center)


def test_holes_show_in_both_kinds_of_figures(states: SceneStates, perfect: AssetMethod) -> None:
    def torn(asset: Asset, posed: Posed, camera: Camera) -> Image:
        whole = draw_box(asset, posed, camera)
        alpha = whole.alpha.clone()
        alpha[:, : alpha.shape[1] // 2] = 0
        white = torch.ones_like(whole.rgb)
        rgb = torch.where(alpha[..., None] > 0, whole.rgb, white)
        return Image(rgb=rgb, alpha=alpha, depth=whole.depth, surface=whole.surface)

    (row,) = evaluate([replace(perfect, take=torn)], states.select([])[:1], protocols=[PAPR])[:1]
    hole, psnr = row.scores["hole_rate"], row.scores["foreground_psnr"]
    assert hole is not None
    assert psnr is not None
    assert 0.3 < hole < 0.7
    assert psnr < 15


def test_without_a_mesh_only_opacity_is_judged(tmp_path: Path, perfect: AssetMethod) -> None:
    plain = open_states(tiny_scene.write_scene(tmp_path / "plain", meshes=False, states=False))
    rows = evaluate([perfect], plain.select(["scale:2"]), protocols=[STANDARD])
    assert {row.state for row in rows} == {"canonical", "scale:2"}
    for row in rows:
        assert row.scores["psnr"] == math.inf
        assert row.scores["hole_rate"] is None
        assert row.scores["depth_error"] is None
        assert row.scores["see_through_rate"] == 0
        assert row.scores["spill_to_object"] == 0


def test_shows_pictures_and_counts(states: SceneStates, perfect: AssetMethod) -> None:
    shown: list[Taken] = []
    counted: list[tuple[int, int]] = []
    other = replace(perfect, name="other")
    rows = evaluate(
        [perfect, other],
        states.select(["walk"]),
        protocols=[PAPR],
        perceptual=Perceptual(missing={"vgg": "no weights"}),
        progress=lambda done, total: counted.append((done, total)),
        show=shown.append,
    )
    assert counted == [(2, 8), (4, 8), (6, 8), (8, 8)]
    assert [(t.state, t.index) for t in shown] == [
        ("canonical", 0),
        ("canonical", 1),
        ("walk", 0),
        ("walk", 1),
    ]
    assert set(shown[0].photos) == {"true", "other"}
    assert all(row.scores["lpips_vgg"] is None for row in rows)


def test_one_row_per_picture_in_a_fixed_order(states: SceneStates, perfect: AssetMethod) -> None:
    rows: list[ImageRow] = evaluate([perfect], states.select(["walk"]))
    keys = [(row.state, row.view, row.protocol) for row in rows]
    assert keys == [
        (state, view, protocol)
        for state in ("canonical", "walk")
        for view in ("r_0", "r_1")
        for protocol in ("papr", "standard")
    ]


def test_the_factor_scales_truth_and_cameras(scene: Path, perfect: AssetMethod) -> None:
    (shot, *_) = open_states(scene, factor=2).select([])[0].shots
    assert (shot.camera.width, shot.camera.height) == (12, 12)
    assert tuple(shot.view.rgba().shape) == (12, 12, 4)


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("wlak", "no state 'wlak'; expected one of canonical, grown, walk, scale:S"),
        ("scale:0", "state 'scale:0': expected scale:S with a factor S > 0, got '0'"),
        ("scale:two", "expected scale:S with a factor S > 0, got 'two'"),
        ("scale:inf", "expected scale:S with a factor S > 0, got 'inf'"),
    ],
)
def test_an_unknown_state(states: SceneStates, name: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        states.select([name])
    assert message in str(caught.value)


def test_a_state_without_a_mesh_is_refused_and_left_out_of_all(tmp_path: Path) -> None:
    states = open_states(tiny_scene.write_scene(tmp_path / "box", meshes=False))
    assert states.names == ()
    assert [state.name for state in states.select(["all"])] == ["canonical"]
    assert states.left_out is not None
    assert "left out: grown, walk" in states.left_out
    with pytest.raises(SceneError, match=r"'walk' has true images but no mesh in meshes\.npz"):
        states.select(["walk"])


def test_a_pair_of_papr_in_motion_has_no_mesh(tmp_path: Path) -> None:
    for side in ("start", "end"):
        tiny_scene.write_scene(tmp_path / "pair" / side, meshes=False, states=False)
    states = open_states(tmp_path / "pair")
    with pytest.raises(SceneError, match="'end' has true images but no mesh"):
        states.select(["end"])
    assert len(states.select([])[0].shots) == 2


def test_methods_need_different_names(states: SceneStates, perfect: AssetMethod) -> None:
    with pytest.raises(InputError, match="no name twice, got true, true"):
        evaluate([perfect, perfect], states.select([]))
    with pytest.raises(InputError, match="at least one and no name twice, got none"):
        evaluate([], states.select([]))


def test_one_kind_of_depth_whatever_rays_and_light(states: SceneStates) -> None:
    """Surfels follow every method's points, so that hole rates compare."""
    rest = tiny_scene.corner_cloud().positions
    normals = torch.nn.functional.normalize(rest, dim=1)
    surfels = Surfels.at_rest(rest, normals, torch.full((8,), 0.05))
    light = Light(
        directions=sphere(9),
        radiance=torch.ones(9),
        nearness=torch.zeros(9),
        center=torch.zeros(3),
    )
    lit = Relighting.of(light, rest, surfels, torch.ones(8))
    asset = asset_of(Papr(tiny_scene.CONFIG), tiny_scene.corner_cloud(), surfels=surfels, light=lit)
    methods = [
        AssetMethod(name="plain", asset=asset, rays="plain"),
        AssetMethod(name="aware", asset=asset, rays="aware"),
        AssetMethod(name="lit", asset=asset, rays="aware", light="still"),
    ]
    for state in states.select(["grown", "walk"]):
        posed = {name: one.content for name, one in ((m.name, m.pose(state)) for m in methods)}
        for one in posed.values():
            assert torch.equal(one.surfels.places, posed["aware"].surfels.places)
        moved = state.name != CANONICAL
        assert posed["plain"].local_maps is None
        assert (posed["aware"].local_maps is not None) is moved
        assert (posed["lit"].gains is not None) is moved
        assert posed["aware"].gains is None
