import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
import torch
from PIL import Image

from pcore.capture.load import load_scene, load_state
from pcore.errors import DependencyError, InputError, SceneError
from pcore.sample.sample import MANIFEST, make_sample
from pcore.sample.sample_mesh import snail
from pcore.sample.sample_states import deformed_states

SMALL = {"resolution": 32, "train_views": 6, "test_views": 3}
STATES = ("bend60", "scale2x", "stretch", "twist60")


@pytest.fixture(scope="module")
def sample(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Small pictures of a mesh as coarse as they are: the fine one takes most of the time."""
    pytest.importorskip("embreex", reason="the extra `sample` is not installed")
    with coarse_snail():
        return make_sample(tmp_path_factory.mktemp("sample") / "snail", **SMALL)


@contextmanager
def coarse_snail(step: float = 0.03) -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pcore.sample.sample.snail", lambda: snail(step=step))
        yield


def test_mesh_is_closed_fine_and_normalised() -> None:
    mesh = snail(step=0.03)
    edges = mesh.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    _, counts = np.unique(np.sort(edges, axis=1), axis=0, return_counts=True)
    assert (counts % 2 == 0).all()
    assert np.linalg.norm(mesh.vertices, axis=1).max() == pytest.approx(1.0)
    assert mesh.colors.min() >= 0
    assert mesh.colors.max() <= 1
    corners = mesh.vertices[mesh.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # Faces turn their front outwards, so the enclosed volume is positive.
    assert np.einsum("fc,fc->", normal, corners[:, 0]) / 6 > 0.1
    assert (np.einsum("fc,fc->f", normal, mesh.normals[mesh.faces[:, 0]]) > 0).mean() > 0.98


def test_default_mesh_is_fine_enough_for_vertex_deformation() -> None:
    mesh = snail()
    corners = mesh.vertices[mesh.faces]
    assert np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() < 0.03


def test_is_a_scene_with_states(sample: Path) -> None:
    loaded = load_scene(sample)
    assert loaded.states == STATES
    assert [len(loaded.split(s)) for s in ("train", "test")] == [6, 3]
    assert loaded.radius == pytest.approx(4 * np.sin(np.arctan(0.36)), abs=1e-3)
    for name in STATES:
        views = load_state(sample, name).split("test")
        assert len(views) == 3
        wanted = 1.2480 if name == "scale2x" else 0.6911
        angle = 2 * np.arctan(0.5 * views[0].camera.width / views[0].camera.fx)
        assert angle == pytest.approx(wanted, abs=1e-4)
        assert json.loads((sample / name / "deformation.json").read_text())["name"] == name


def test_object_is_colourful_and_whole_in_every_view(sample: Path) -> None:
    views = [*load_scene(sample).split("train")]
    views += [v for name in STATES for v in load_state(sample, name).split("test")]
    for view in views:
        alpha = view.alpha()
        border = torch.cat([alpha[0], alpha[-1], alpha[:, 0], alpha[:, -1]])
        assert border.max() == 0
        assert 0.03 < alpha.mean() < 0.3
        assert view.rgba()[..., :3][alpha > 0.9].std(dim=0).min() > 0.05
    assert len({float(view.alpha().mean()) for view in views}) > len(views) // 2


def test_edges_are_anti_aliased(sample: Path) -> None:
    alpha = load_scene(sample).split("train")[0].alpha()
    assert ((alpha > 0) & (alpha < 1)).sum() > 10


def test_projected_surface_fills_the_masks(sample: Path) -> None:
    arrays = np.load(sample / "meshes.npz")
    for name in (None, *STATES):
        scene = load_scene(sample) if name is None else load_state(sample, name)
        points = torch.from_numpy(arrays[name or "canonical"])
        for view in scene.split("test"):
            camera = view.camera
            local = (points - camera.center) @ camera.world_from_camera[:3, :3]
            x = (camera.fx * local[:, 0] / -local[:, 2] + camera.cx).long()
            y = (-camera.fy * local[:, 1] / -local[:, 2] + camera.cy).long()
            drawn = torch.zeros_like(view.alpha())
            drawn[y, x] = 1.0
            assert ((view.alpha() > 0.5) <= (drawn > 0)).float().mean() > 0.995
            # Vertices on the silhouette may fall between the rays of a pixel.
            assert ((view.alpha() > 0) >= (drawn > 0)).float().mean() > 0.98


def test_meshes_are_the_true_deformations(sample: Path) -> None:
    arrays = np.load(sample / "meshes.npz")
    canonical = arrays["canonical"].astype(np.float64)
    for name, state in deformed_states(canonical).items():
        assert arrays[name].shape == canonical.shape
        moved = state.deformation(torch.from_numpy(canonical)).numpy()
        assert np.allclose(arrays[name], moved, atol=1e-5)
    assert np.allclose(arrays["scale2x"], 2 * canonical, atol=1e-6)


def test_samples_lie_on_the_surface_and_most_are_seen(sample: Path) -> None:
    arrays = np.load(sample / "meshes.npz")
    assert arrays["sample_face"].shape == arrays["sample_visible"].shape == (20_000,)
    assert np.allclose(arrays["sample_barycentric"].sum(axis=1), 1.0, atol=1e-5)
    assert arrays["sample_face"].max() < len(arrays["faces"])
    assert arrays["sample_visible"].dtype == bool
    assert 0.8 < arrays["sample_visible"].mean() < 1.0


def test_colour_turns_with_the_surface(sample: Path) -> None:
    """The wider field of view shows the scaled object in its canonical colours."""
    canonical = load_scene(sample).split("test")[0].rgba()
    scaled = load_state(sample, "scale2x").split("test")[0].rgba()
    mean = [image[..., :3][image[..., 3] > 0.9].mean(dim=0) for image in (canonical, scaled)]
    assert torch.allclose(mean[0], mean[1], atol=0.06)


def test_existing_sample_is_kept_and_two_runs_agree(sample: Path, tmp_path: Path) -> None:
    before = (sample / MANIFEST).stat().st_mtime_ns
    assert make_sample(sample, **SMALL) == sample
    assert (sample / MANIFEST).stat().st_mtime_ns == before
    seen: list[tuple[int, int]] = []
    (tmp_path / "again").mkdir()  # an empty folder is a free place
    with coarse_snail():
        again = make_sample(tmp_path / "again", **SMALL, progress=lambda i, n: seen.append((i, n)))
    assert seen == [(i + 1, 21) for i in range(21)]
    assert [p.name for p in tmp_path.iterdir()] == ["again"]
    files = sorted(p.relative_to(sample) for p in sample.rglob("*.png"))
    assert files == sorted(p.relative_to(again) for p in again.rglob("*.png"))
    for file in files:
        with Image.open(sample / file) as a, Image.open(again / file) as b:
            assert np.array_equal(np.asarray(a), np.asarray(b))


def test_folder_with_something_else_is_left_alone(tmp_path: Path, sample: Path) -> None:
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(SceneError, match=r"expected an empty place .* got other files; choose"):
        make_sample(tmp_path, **SMALL)
    assert [p.name for p in tmp_path.iterdir()] == ["thesis.txt"]
    with pytest.raises(SceneError, match=r"'resolution': 40.* got .*'resolution': 32"):
        make_sample(sample, resolution=40, train_views=6, test_views=3)


def test_interrupted_run_leaves_nothing(tmp_path: Path) -> None:
    pytest.importorskip("embreex", reason="the extra `sample` is not installed")

    def stop(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), coarse_snail(0.05):
        make_sample(tmp_path / "snail", **SMALL, progress=stop)
    assert list(tmp_path.iterdir()) == []


def test_missing_ray_caster_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [n for n in sys.modules if n.startswith(("embreex", "trimesh.ray.ray_pyembree"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "embreex", None)
    with pytest.raises(DependencyError, match=r"pcore-edit\[sample\]"):
        make_sample(tmp_path / "snail", **SMALL)
    assert list(tmp_path.iterdir()) == []


def test_bad_sizes(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match="resolution: expected a whole number of at least 8, got 4"
    ):
        make_sample(tmp_path / "snail", resolution=4)
    with pytest.raises(InputError, match=r"training views: expected .* at least 2, got 1"):
        make_sample(tmp_path / "snail", train_views=1)
