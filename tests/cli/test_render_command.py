"""`pcore render`: cameras, edits, files, and what must not be overwritten."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import av
import numpy as np
import pytest
import torch
from PIL import Image
from torch import Tensor
from toys import toy_cameras, write_cameras, write_run, write_scene

from pcore.capture.load import load_cameras, load_scene
from pcore.cli import draw
from pcore.cli.main import main
from pcore.contrib.learned_skinning import SkinningConfig, untrained_skinning
from pcore.deform.anchor_distance import path_distance
from pcore.deform.jacobian import estimated_maps
from pcore.editing.anchors import rig_with
from pcore.editing.script import load_edit
from pcore.errors import EditError
from pcore.files.skinning_file import SKINNING_FILE, save_skinning
from pcore.geometry.farthest_points import farthest_points
from pcore.geometry.local_maps import LocalMaps
from pcore.geometry.point_cloud import PointCloud
from pcore.geometry.posed import PosedCloud
from pcore.model.papr import Papr
from pcore.render.image import whole_normals
from pcore.render.picture import FAST_THRESHOLD, render

Made = tuple[Path, Papr, PointCloud]


@pytest.fixture
def made(tmp_path: Path) -> Made:
    """A run whose scene lies beside it."""
    write_scene(tmp_path / "ball")
    papr, cloud = write_run(tmp_path / "run", scene="../ball", factor=2)
    return tmp_path / "run", papr, cloud


def call(*args: object) -> int:
    return main(["render", *map(str, args), "--device", "cpu"])


def names(folder: Path) -> list[str]:
    return sorted(item.name for item in folder.iterdir())


def write_edit(path: Path, *edits: dict[str, object]) -> Path:
    path.write_text(json.dumps({"version": 2, "edits": edits}))
    return path


TWIST: dict[str, object] = {"type": "twist", "axis": "z", "angle_deg": 60}


def size_of(path: Path) -> tuple[int, int]:
    with Image.open(path) as image:
        return image.size


def pixels(path: Path) -> np.ndarray:
    with Image.open(path) as image:
        return np.asarray(image)


def film(path: Path) -> np.ndarray:
    with av.open(str(path)) as file:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in file.decode(video=0)])


def test_a_split_gives_pictures_named_like_its_views(
    made: Made, capsys: pytest.CaptureFixture[str]
) -> None:
    run, papr, cloud = made
    assert call(run, "--split", "test") == 0
    folder = run / "renders" / "test"
    assert names(folder) == ["r_0.png", "r_1.png"]
    assert f"2 views of 8 x 8 pixels in {folder}: r_0.png, r_1.png" in capsys.readouterr().out
    expected = render(
        papr, PosedCloud.at_rest(cloud), toy_cameras(2, size=8, elevation=0.1)[1]
    ).rgb.clamp(0, 1)
    shown = pixels(folder / "r_1.png")
    assert shown.dtype == np.uint8
    assert np.abs(shown - expected.numpy() * 255).max() <= 0.51


def test_raw_files_hold_what_the_library_renders(made: Made, tmp_path: Path) -> None:
    run, papr, cloud = made
    cameras = write_cameras(tmp_path / "path.json", toy_cameras(3), w=20, h=12)
    out = tmp_path / "out"
    assert call(run, "--cameras", cameras, "-o", out, "--raw", "--normals", "--depth") == 0
    assert names(out) == sorted(
        f"r_{i}{ending}"
        for i in range(3)
        for ending in (".png", "_depth.png", "_normals.png", ".npz")
    )
    camera = load_cameras(cameras)[2][1]
    picture = render(papr, PosedCloud.at_rest(cloud), camera)
    with np.load(out / "r_2.npz") as raw:
        assert sorted(raw) == ["alpha", "depth", "normals", "rgb", "surface"]
        for name in ("rgb", "alpha", "depth", "surface"):
            assert raw[name].dtype == np.float32
            np.testing.assert_allclose(raw[name], getattr(picture, name), atol=1e-5)
        np.testing.assert_allclose(raw["normals"], whole_normals(picture, camera), atol=1e-3)
        assert raw["rgb"].shape == (12, 20, 3)


def test_fast_pictures_leave_out_small_weights(made: Made, tmp_path: Path) -> None:
    run, papr, cloud = made
    file = write_cameras(tmp_path / "path.json", toy_cameras(1, size=8))
    out = tmp_path / "out"
    assert call(run, "--cameras", file, "--size", 8, 8, "--raw", "--fast", "-o", out) == 0
    (archive,) = (item for item in out.iterdir() if item.suffix == ".npz")
    with np.load(archive) as found:
        rgb = torch.from_numpy(found["rgb"])
    fast = render(
        papr, PosedCloud.at_rest(cloud), toy_cameras(1, size=8)[0], threshold=FAST_THRESHOLD
    )
    torch.testing.assert_close(rgb, fast.rgb)
    exact = render(papr, PosedCloud.at_rest(cloud), toy_cameras(1, size=8)[0])
    assert float((rgb - exact.rgb).abs().max()) > 0


@pytest.mark.parametrize("rays", ["plain", "aware"])
def test_an_edit_moves_the_canonical_points(made: Made, tmp_path: Path, rays: str) -> None:
    run, papr, cloud = made
    edit = write_edit(tmp_path / "turn.json", {"type": "rigid", "axis": "z", "angle_deg": 90})
    assert call(run, "--split", "test", "--edit", edit, "--raw", "--rays", rays) == 0
    x, y, z = cloud.positions.unbind(dim=-1)
    back = torch.tensor([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    maps = LocalMaps(to_rest=back.expand(len(cloud), 3, 3)) if rays == "aware" else None
    places = torch.stack([-y, x, z], dim=-1)
    moved = PosedCloud(cloud=cloud, positions=places, local_maps=maps)
    picture = render(papr, moved, toy_cameras(2, size=8, elevation=0.1)[0])
    with np.load(run / "renders" / "test-turn" / "r_0.npz") as raw:
        np.testing.assert_allclose(raw["surface"], picture.surface, atol=1e-4)
        np.testing.assert_allclose(raw["rgb"], picture.rgb, atol=1e-3)


@pytest.mark.parametrize("learned", [True, False])
def test_anchors_move_points_by_the_weights_that_the_run_learned(
    tmp_path: Path, learned: bool
) -> None:
    papr, cloud = write_run(tmp_path / "run")
    distance = path_distance(cloud.positions, farthest_points(cloud.positions, 20))
    skinning = untrained_skinning(distance, SkinningConfig(width=8))
    torch.nn.init.normal_(skinning.network.layers[-1].get_parameter("weight"))
    if learned:
        save_skinning(tmp_path / "run" / SKINNING_FILE, skinning)
    top = cloud.positions[cloud.positions[:, 2].argmax()]
    handle = {"near": top.tolist(), "to": (top + torch.tensor([0.0, 0.0, 0.3])).tolist()}
    script = {"version": 2, "edits": [{"type": "anchors", "count": 20, "handles": [handle]}]}
    edit, cameras = tmp_path / "edit.json", toy_cameras(1, size=8)
    edit.write_text(json.dumps(script))
    file, out = write_cameras(tmp_path / "cameras.json", cameras, w=8, h=8), tmp_path / "out"
    options = ("--cameras", file, "--edit", edit, "--rays", "plain", "--raw", "-o", out)
    assert call(tmp_path / "run", *options) == 0
    camera, pictures = load_cameras(file)[0][1], list[np.ndarray]()
    for rig in (rig_with(distance, skinning), None):
        deformation = load_edit(edit).bind(cloud.positions, rig=rig)
        places = deformation(cloud.positions.double()).float()
        moved = PosedCloud(cloud=cloud, positions=places)
        pictures.append(render(papr, moved, camera).rgb.numpy())
    expected, other = pictures if learned else pictures[::-1]
    found = np.load(next(out.glob("*.npz")))["rgb"]
    np.testing.assert_allclose(found, expected, atol=1e-5)
    assert np.abs(found - other).max() > 1e-4


def test_an_orbit_is_a_film_that_can_be_read_back(made: Made, tmp_path: Path) -> None:
    run, _, _ = made
    out = tmp_path / "out"
    options = ("--orbit", 5, "--frames", "--depth", "--size", 21, 15, "-o", out)
    assert call(run, *options) == 0
    frames = [f"frame_{i:03}{ending}.png" for i in range(5) for ending in ("", "_depth")]
    assert names(out) == sorted([*frames, "orbit.mp4", "orbit_depth.mp4"])
    shown = film(out / "orbit.mp4")
    assert shown.shape == (5, 16, 22, 3)
    first = pixels(out / "frame_000.png").astype(float)
    assert np.abs(shown[0, :15, :21].mean(axis=(0, 1)) - first.mean(axis=(0, 1))).max() < 6
    assert film(out / "orbit_depth.mp4").shape == shown.shape


def test_the_default_is_an_orbit_like_the_training_cameras(
    made: Made, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, _, _ = made
    seen: list[object] = []

    def note(
        papr: object, cloud: object, views: object, *rest: object, **options: object
    ) -> list[Path]:
        seen.append(views)
        return [Path("orbit.mp4")]

    monkeypatch.setattr(draw, "draw", note)
    assert call(run) == 0
    views = seen[0]
    assert isinstance(views, list)
    assert len(views) == 60
    for name, camera in (views[0], views[17]):
        assert name.startswith("frame_")
        assert (camera.width, camera.height) == (8, 8)
        assert float(camera.center.norm()) == pytest.approx(4.0, abs=1e-3)
        assert float(camera.center[2]) == pytest.approx(4 * np.sin(0.4), abs=1e-3)


def test_an_orbit_of_a_larger_object_stands_farther_away(made: Made, tmp_path: Path) -> None:
    run, _, _ = made
    edit = write_edit(tmp_path / "large.json", {"type": "scale", "factor": 2})
    plain, large = tmp_path / "plain", tmp_path / "large"
    for out, options in ((plain, ()), (large, ("--edit", edit))):
        assert call(run, "--orbit", 1, "--raw", "-o", out, *options) == 0
    with np.load(plain / "frame_000.npz") as a, np.load(large / "frame_000.npz") as b:
        np.testing.assert_allclose(b["depth"], 2 * a["depth"], rtol=0.3)
        assert float(np.median(b["depth"] / a["depth"])) == pytest.approx(2, rel=0.02)


def test_a_bare_model_file_orbits_its_points(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, _, _ = made
    model = run / "model.safetensors"
    options = ("--orbit", 2, "--frames", "--raw", "--size", 24, 16, "--fov", 50)
    assert call(model, *options, "-o", tmp_path / "out") == 0
    assert "fitted to the points" in capsys.readouterr().out
    with np.load(tmp_path / "out" / "frame_001.npz") as raw:
        assert raw["alpha"].shape == (16, 24)


# --- what must not happen ------------------------------------------------------------------


def test_without_a_folder_each_time_has_its_own(made: Made) -> None:
    run, _, _ = made
    for _ in range(2):
        assert call(run, "--split", "test") == 0
    assert names(run / "renders") == ["test", "test-2"]
    assert names(run / "renders" / "test") == names(run / "renders" / "test-2")
    assert call(run, "--split", "test", "--overwrite") == 0
    assert names(run / "renders") == ["test", "test-2"]


def test_files_are_not_overwritten_unless_asked(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run, _, _ = made
    out = tmp_path / "out"
    out.mkdir()
    (out / "notes.txt").write_text("mine")
    (out / "r_0.png").write_text("mine")
    assert call(run, "--split", "test", "-o", out) == 2
    assert f"{out} holds files already (notes.txt, r_0.png)" in capsys.readouterr().err
    assert (out / "r_0.png").read_text() == "mine"
    assert call(run, "--split", "test", "-o", out, "--overwrite") == 0
    assert (out / "notes.txt").read_text() == "mine"
    assert size_of(out / "r_0.png") == (8, 8)
    assert call(run, "--split", "test", "-o", run, "--overwrite") == 2
    assert f"{run} holds a run" in capsys.readouterr().err
    assert call(run, "--split", "test", "-o", out / "notes.txt") == 2
    assert "is a file: expected a folder" in capsys.readouterr().err


def test_stopping_leaves_whole_files(
    made: Made, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run, _, _ = made
    calls: list[int] = []
    original = draw._write

    def stop(*args: object) -> list[Path]:
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return original(*args)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(draw, "_write", stop)
    assert call(run, "--orbit", 4, "--frames") == 130
    assert names(run / "renders" / "orbit") == ["frame_000.png"]
    said = capsys.readouterr().err
    assert "complete files: 1, in" in said
    assert "--overwrite begins again" in said


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (("--split", "test", "--orbit", "3"), "one of --cameras, --split and --orbit, got --split"),
        (("--split", "val"), "no split 'val'; it has train, test"),
        (("--split", "test", "--fov", "30"), "--fov is for orbits: leave out --split, or --fov"),
        (("--split", "test", "--frames"), "--frames is for orbits"),
        (
            ("--split", "test", "--size", "9", "8"),
            "expected the shape of the images, which are 8 x 8",
        ),
        (("--split", "test", "--scene", "absent"), "scene absent: no such folder"),
        (("--split", "test", "--threads", "0"), "--threads: expected a whole number of at least 1"),
        (("--orbit", "0"), "orbit: expected at least one camera, got 0"),
        (("--orbit", "2", "--fov", "190"), "--fov: expected degrees between 0 and 180, got 190"),
        (("--orbit", "2", "--elevation", "90"), "--elevation: expected degrees between -90 and 90"),
        (("--orbit", "2", "--size", "3", "9"), "at least 4 x 4 pixels, got 3 x 9"),
        (("--cameras", "absent.json"), "absent.json: no such file"),
        (("--edit", "absent.json"), "absent.json: edit file not found"),
        (("--factor", "0"), "factor: expected a whole number of at least 1, got 0"),
        (("--factor", "3"), "16 x 16 images cannot be divided by 3"),
    ],
)
def test_bad_options(
    made: Made,
    options: tuple[str, ...],
    message: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert call(made[0], *options) == 2
    assert message in capsys.readouterr().err


def test_a_folding_edit_is_refused(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edit = write_edit(tmp_path / "fold.json", {"type": "taper", "axis": "z", "factor": -9})
    assert call(made[0], "--split", "test", "--edit", edit) == 2
    said = capsys.readouterr().err
    assert "fold.json: edit 1 (taper)" in said
    assert "plain rays can draw it" in said
    assert not (made[0] / "renders").exists()
    # Nothing has to be undone for plain rays.
    assert call(made[0], "--split", "test", "--edit", edit, "--rays", "plain") == 0
    assert (made[0] / "renders" / "test-fold").is_dir()


def test_local_maps_that_were_replaced_are_said(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Points change places, which no map around a point can do."""
    run, _, cloud = made
    points = cloud.positions.detach()
    moved = next(
        points.roll(step, 0) for step in range(1, 40) if inside_out(points, points.roll(step, 0))
    )
    np.save(tmp_path / "rest.npy", points.numpy())
    np.save(tmp_path / "moved.npy", moved.numpy())
    edit = {"type": "displacement", "before": "rest.npy", "after": "moved.npy"}
    (tmp_path / "layers.json").write_text(json.dumps({"version": 2, "edits": [edit]}))
    count = inside_out(points, moved)
    assert call(run, "--split", "test", "--edit", tmp_path / "layers.json") == 0
    said = f"warning: edit 1 (displacement): at {count} of {len(points)} points"
    assert said in capsys.readouterr().out


def inside_out(rest: Tensor, moved: Tensor) -> int:
    """Number of points whose estimated map had to be replaced; 0 where the move is refused."""
    try:
        return len(estimated_maps(rest, moved).mended)
    except EditError:
        return 0


def test_cameras_without_a_size(
    made: Made, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cameras = write_cameras(tmp_path / "path.json", toy_cameras(1))
    write_run(tmp_path / "lost", scene="../gone")
    assert call(tmp_path / "lost", "--cameras", cameras) == 2
    assert "add 'w' and 'h' to it, or use --size W H" in capsys.readouterr().err
    assert call(made[0], "--cameras", cameras, "--size", 10, 6) == 0
    assert size_of(made[0] / "renders" / "path" / "r_0.png") == (10, 6)
    # Without a size anywhere else, that of the scene's images.
    assert call(made[0], "--cameras", cameras, "-o", tmp_path / "as-photos") == 0
    scene = load_scene(tmp_path / "ball")
    camera = scene.split("train")[0].camera
    found = size_of(tmp_path / "as-photos" / "r_0.png")
    assert found == (camera.width // 2, camera.height // 2)  # The run's factor is 2.


def test_a_run_whose_scene_is_elsewhere(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_run(tmp_path / "run", scene="../gone")
    assert call(tmp_path / "run", "--split", "test") == 2
    said = capsys.readouterr().err
    assert "the scene it was trained on (../gone) is not a folder here" in said
    write_scene(tmp_path / "ball")
    assert call(tmp_path / "run", "--split", "test", "--scene", tmp_path / "ball") == 0


def test_no_video_package(
    made: Made, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    assert call(made[0], "--orbit", 2) == 2
    assert "pip install 'pcore-edit[video]'" in capsys.readouterr().err
    assert not (made[0] / "renders").exists()


def test_no_gpu(
    made: Made, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert main(["render", str(made[0]), "--device", "cuda"]) == 2
    assert "--device cuda: expected a GPU that torch" in capsys.readouterr().err


def test_no_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert call(tmp_path) == 2
    assert f"no run at {tmp_path}" in capsys.readouterr().err
