"""`pcore light` and what the other verbs make of the light of a run."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from pcore.editing.apply import deformed_cloud
from pcore.relight.shading import Shading
from toys import toy_cameras, write_cameras, write_run, write_scene

import tiny_scene
from pcore.cli.main import main
from pcore.deform.base import Identity
from pcore.editing.script import load_edit
from pcore.geometry.point_cloud import PointCloud
from pcore.model.papr import Papr
from pcore.relight.lamps import Light, sphere
from pcore.relight.light_file import LIGHT_FILE, load_shading, save_shading
from pcore.render.picture import render

TURN = {"version": 2, "edits": [{"type": "rigid", "axis": "x", "angle_deg": 120}]}


def lamp_from_above() -> Light:
    directions = sphere(40)
    return Light(
        directions=directions,
        radiance=0.1 + (4 * directions[:, 2] - 2).exp(),
        nearness=torch.zeros(40),
        center=torch.zeros(3),
    )


def write_light(run: Path, cloud: PointCloud) -> Shading:
    """A light from above; the points lie on a ball, which says how they face."""
    normals = torch.nn.functional.normalize(cloud.positions, dim=1)
    positions = cloud.positions.detach()
    bright = torch.full((len(positions),), 0.3)
    shading = Shading(
        light=lamp_from_above(), normals=normals, positions=positions, brightness=bright, lift=0.01
    )
    save_shading(run / LIGHT_FILE, shading)
    return shading


@pytest.fixture
def made(tmp_path: Path) -> tuple[Path, Papr, PointCloud, Shading]:
    papr, cloud = write_run(tmp_path / "run")
    return tmp_path / "run", papr, cloud, write_light(tmp_path / "run", cloud)


def picture_of(run: Path, tmp_path: Path, *options: str, what: str = "rgb") -> np.ndarray:
    (tmp_path / "turn.json").write_text(json.dumps(TURN))
    cameras = write_cameras(tmp_path / "cameras.json", toy_cameras(1, size=8), w=8, h=8)
    words = ["render", run, "--cameras", cameras, "--raw", "--overwrite", "-o", tmp_path / "out"]
    assert main([*map(str, words), *options]) == 0
    return np.load(tmp_path / "out" / "r_0.npz")[what]


@pytest.mark.parametrize(
    ("options", "aware", "lit"),
    [
        ((), True, True),
        (("--light", "still"), True, True),
        (("--light", "baked"), True, False),
        (("--rays", "plain"), False, False),
        (("--rays", "plain", "--light", "still"), False, True),
    ],
)
def test_a_light_stands_still_unless_asked_otherwise(
    made: tuple[Path, Papr, PointCloud, Shading],
    tmp_path: Path,
    options: tuple[str, ...],
    aware: bool,
    lit: bool,
) -> None:
    run, papr, cloud, shading = made
    found = picture_of(run, tmp_path, "--edit", str(tmp_path / "turn.json"), *options)
    deformation = load_edit(tmp_path / "turn.json").bind(cloud.positions)
    expected, other = (
        render(
            papr,
            deformed_cloud(cloud, deformation, aware=aware, shading=one),
            toy_cameras(1, size=8)[0],
        ).rgb.numpy()
        for one in ((shading, None) if lit else (None, shading))
    )
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert np.abs(expected - other).max() > 0.02


def test_without_an_edit_a_light_changes_depths_alone(
    made: tuple[Path, Papr, PointCloud, Shading], tmp_path: Path
) -> None:
    run, papr, cloud, shading = made
    bare = render(papr, cloud, toy_cameras(1, size=8)[0])
    covered = render(papr, cloud.covered(shading.rest), toy_cameras(1, size=8)[0])
    met = torch.isfinite(bare.depth)
    assert float((covered.depth - bare.depth)[met].abs().max()) > 0.05
    np.testing.assert_allclose(picture_of(run, tmp_path), bare.rgb.numpy(), atol=1e-6)
    for options, expected in (
        ((), covered),
        (("--light", "still"), covered),
        (("--light", "baked"), bare),
        (("--rays", "plain"), bare),
    ):
        found = picture_of(run, tmp_path, *options, what="depth")
        np.testing.assert_allclose(found, expected.depth.numpy(), atol=1e-5)


def test_an_edit_that_moves_nothing_is_as_deep_as_none(
    made: tuple[Path, Papr, PointCloud, Shading],
) -> None:
    _, papr, cloud, shading = made
    still = deformed_cloud(cloud, Identity(), shading=shading)
    camera = toy_cameras(1, size=8)[0]
    found, expected = (render(papr, one, camera) for one in (still, cloud.covered(shading.rest)))
    torch.testing.assert_close(found.depth, expected.depth, rtol=0, atol=0, equal_nan=True)
    assert torch.equal(found.rgb, expected.rgb)
    assert deformed_cloud(cloud, Identity()).skin is None


def test_a_light_that_cannot_be_read_can_be_done_without(
    made: tuple[Path, Papr, PointCloud, Shading],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    run, _, _, shading = made
    save_shading(run / LIGHT_FILE, replace(shading, positions=shading.positions + 1))
    assert main(["render", str(run), "--orbit", "2", "-o", str(tmp_path / "film")]) == 2
    assert "`pcore light RUN`" in capsys.readouterr().err
    picture_of(run, tmp_path, "--light", "baked")


def test_a_light_that_is_not_there(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path / "run")
    edit = ("--edit", str(tmp_path / "turn.json"))
    picture_of(tmp_path / "run", tmp_path, *edit)
    words = ["render", str(tmp_path / "run"), "--orbit", "2", *edit, "--light", "still"]
    assert main(words) == 2
    assert "expected a light.safetensors in the folder of the run" in capsys.readouterr().err


@pytest.mark.parametrize("verb", ["render", "animate", "eval"])
def test_rays_per_pixel_are_checked_first(
    made: tuple[Path, Papr, PointCloud, Shading],
    tmp_path: Path,
    verb: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = {
        "render": ["-o", str(tmp_path / "out")],
        "animate": ["--edit", "no.json", "-o", str(tmp_path / "out.mp4")],
        "eval": ["-o", str(tmp_path / "out")],
    }
    assert main([verb, str(made[0]), *words[verb], "--samples", "3"]) == 2
    assert "--samples: expected rays per pixel that make a square" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_info_tells_of_the_light(
    made: tuple[Path, Papr, PointCloud, Shading], capsys: pytest.CaptureFixture[str]
) -> None:
    run, _, _, shading = made
    assert main(["info", str(run)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "brightest on surfaces that face" in said
    assert "lamps are far away" in said
    size = float((shading.positions.amax(dim=0) - shading.positions.amin(dim=0)).norm())
    near = replace(shading.light, nearness=torch.full((40,), 1 / (2.5 * size)))
    save_shading(run / LIGHT_FILE, replace(shading, light=near))
    assert main(["info", str(run)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "lamps are 2.5 times the object's size away" in said
    save_shading(run / LIGHT_FILE, replace(shading, positions=shading.positions + 1))
    assert main(["info", str(run)]) == 0, "a stale light is no reason to say nothing"
    assert "cannot be used" in " ".join(capsys.readouterr().out.split())


def test_the_light_of_other_points_is_an_error(
    made: tuple[Path, Papr, PointCloud, Shading], capsys: pytest.CaptureFixture[str]
) -> None:
    run, _, _, shading = made
    save_shading(run / LIGHT_FILE, replace(shading, positions=shading.positions + 1))
    edit = run / "turn.json"
    edit.write_text(json.dumps(TURN))
    assert main(["render", str(run), "--orbit", "2", "--edit", str(edit)]) == 2
    said = " ".join(capsys.readouterr().err.split())
    assert "points that the light was estimated with" in said


def test_a_random_run_has_no_normals_to_speak_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_scene(tmp_path / "scene")
    write_run(tmp_path / "run", scene="../scene")
    assert main(["light", str(tmp_path / "run")]) == 2
    assert "at least 50 points with a normal" in " ".join(capsys.readouterr().err.split())
    assert not (tmp_path / "run" / LIGHT_FILE).exists()


def test_an_evaluation_shows_pictures_with_the_light_and_without(tmp_path: Path) -> None:
    scene = tiny_scene.write_scene(tmp_path / "box")
    run = tiny_scene.write_run(tmp_path / "run", scene)
    from pcore.files.model_file import load_model

    cloud = load_model(run).cloud
    write_light(run, cloud)
    assert len(load_shading(run, cloud.positions).normals) == len(cloud)
    assert main(["eval", str(run), "--protocol", "standard"]) == 0
    with (run / "eval" / "images.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(dict.fromkeys(row["method"] for row in rows)) == ["PAPR", "aware", "aware + light"]
    psnr = {
        (row["state"], row["method"]): float(row["psnr"]) for row in rows if row["view"] == "r_0"
    }
    assert psnr["canonical", "aware + light"] == psnr["canonical", "aware"]
    assert psnr["grown", "aware + light"] == pytest.approx(psnr["grown", "aware"], abs=1e-3)
    assert psnr["walk", "aware + light"] != psnr["walk", "aware"], "a shear turns normals"
    deep = {(row["state"], row["view"], row["method"]): row["depth_error"] for row in rows}
    for state, view, method in list(deep):
        if method == "aware + light":
            assert deep[state, view, method] == deep[state, view, "aware"], "one kind of depth"
    shading = load_shading(run, cloud.positions)
    near = replace(shading.light, nearness=torch.full((40,), 0.2))
    save_shading(run / LIGHT_FILE, replace(shading, light=near))
    words = ["eval", str(run), "--protocol", "standard", "--state", "scale:2", "grown"]
    assert main([*words, "-o", str(tmp_path / "near")]) == 0
    with (tmp_path / "near" / "images.csv").open(newline="") as file:
        near_rows = list(csv.DictReader(file))
    psnr = {
        (row["state"], row["method"]): float(row["psnr"])
        for row in near_rows
        if row["view"] == "r_0"
    }
    assert psnr["scale:2", "aware + light"] == pytest.approx(psnr["scale:2", "aware"], abs=1e-3)
    assert psnr["grown", "aware + light"] != pytest.approx(psnr["grown", "aware"], abs=1e-3)
    assert main(["eval", str(run), "--light", "baked", "-o", str(tmp_path / "baked")]) == 0
    assert "aware + light" not in (tmp_path / "baked" / "images.csv").read_text()
    shading = load_shading(run, cloud.positions)
    save_shading(run / LIGHT_FILE, replace(shading, positions=shading.positions + 1))
    assert main(["eval", str(run), "--rays", "plain"]) == 0, "plain rays ask for no light"
    assert main(["eval", str(run)]) == 2
