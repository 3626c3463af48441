"""True meshes, the motion of points near them, true depth; bad files."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
import torch

from pcore.deform.frame import axis_frame
from pcore.deform.simple import Twist, rigid
from pcore.errors import DependencyError, InputError, SceneError
from pcore.evaluation.ground_truth import DeformedTruth, load_truth
from pcore.evaluation.mesh_depth import mesh_depth
from pcore.geometry.camera import Camera

TWIST = {"type": "simple_deform", "method": "TWIST", "axis": "Z", "value": 1.0}
OBJECTS = ("spot", "knight", "robot")
ANALYTIC = ("twist60", "bend60", "stretch", "scale2x")


@pytest.fixture(scope="module")
def ball() -> tuple[np.ndarray, np.ndarray]:
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.creation.icosphere(subdivisions=3)
    return np.array(mesh.vertices, dtype=np.float64), np.array(mesh.faces, dtype=np.int64)


@pytest.fixture
def folder(ball, tmp_path) -> Path:
    """A ball, twisted, scaled and turned, in the layout of the evaluation sets."""
    vertices, faces = ball
    points = torch.from_numpy(vertices)
    twist = Twist(rotation=axis_frame("z"), origin=torch.zeros(3), extent=(-1.0, 1.0), value=1.0)
    turned = rigid("x", 0.7, (0.1, 0.2, 0.3))(points).numpy()
    states = {"twisted": twist(points).numpy(), "large": 2 * vertices, "turned": turned}
    np.savez(tmp_path / "meshes.npz", canonical=vertices, faces=faces, **states)
    records = {
        "twisted": {**TWIST, "driver_lo": -1.0, "driver_hi": 1.0, "lock": [0, 0, 0]},
        "large": {"type": "scale", "factor": 2.0, "origin": [0, 0, 0]},
        "turned": {"type": "animation", "action": "Turn"},
    }
    for name, record in records.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "deformation.json").write_text(json.dumps(record))
    return tmp_path


def looking_down(distance: float, size: int = 21) -> Camera:
    pose = torch.eye(4)
    pose[2, 3] = distance
    return Camera.from_fov(pose, width=size, height=size, angle_x=0.6)


def surface_samples(truth: DeformedTruth, state: str | None, count: int = 500) -> torch.Tensor:
    rng = np.random.default_rng(0)
    face = rng.integers(0, len(truth.faces), count)
    weights = rng.dirichlet(np.ones(3), count)
    corners = truth.vertices(state)[truth.faces[face]]
    return torch.from_numpy(np.einsum("nk,nkd->nd", weights, corners)).float()


@pytest.mark.parametrize("state", ["twisted", "large", "turned"])
def test_surface_points_land_exactly_on_the_state(folder, state):
    truth = load_truth(folder)
    moved = truth.carry(surface_samples(truth, None), state)
    assert moved.dtype == torch.float32
    assert torch.allclose(moved, surface_samples(truth, state), atol=1e-6)


def test_scaling_and_rigid_motion_are_exact_off_the_surface_too(folder):
    truth = load_truth(folder)
    points = 1.2 * torch.randn(300, 3)
    assert torch.allclose(truth.carry(points, "large"), 2 * points, atol=1e-5)
    expected = rigid("x", 0.7, (0.1, 0.2, 0.3))(points)
    assert torch.allclose(truth.carry(points, "turned"), expected, atol=1e-5)


def test_points_keep_their_distance_along_the_deformed_normal(ball, tmp_path):
    """A flat square that is folded up: a point above it ends beside it."""
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    upright = vertices[:, [0, 2, 1]]
    truth = DeformedTruth(
        root=tmp_path, canonical=vertices, faces=faces, states={"upright": upright}
    )
    moved = truth.carry(torch.tensor([[0.3, 0.6, 0.1]]), "upright")
    assert torch.allclose(moved, torch.tensor([[0.3, -0.1, 0.6]]), atol=1e-6)


def test_a_collapsed_triangle_gives_finite_points(tmp_path):
    vertices = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0]])
    truth = DeformedTruth(
        root=tmp_path,
        canonical=vertices,
        faces=np.array([[0, 1, 2]]),
        states={"point": np.ones((3, 3)), "line": vertices * [1, 0, 0]},
    )
    points = torch.tensor([[0.2, 0.2, 0.1], [2.0, 2.0, 1.0]])
    point, line = truth.carry(points, "point"), truth.carry(points, "line")
    assert torch.isfinite(line).all()
    assert ((point - 1).norm(dim=1) <= 0.25 * torch.tensor([0.1, 2.4])).all()


def test_one_search_serves_all_states(folder):
    truth = load_truth(folder)
    points = torch.randn(50, 3)
    anchors = truth.anchor(points)
    for state in truth.states:
        assert torch.equal(truth.follow(anchors, state), truth.carry(points, state))


def test_analytic_states(folder):
    truth = load_truth(folder)
    for state in ("twisted", "large"):
        deformation = truth.analytic(state)
        assert deformation is not None
        moved = deformation(torch.from_numpy(truth.canonical))
        assert np.abs(moved.numpy() - truth.states[state]).max() < 1e-9
    assert truth.analytic("turned") is None


def test_locked_axes_are_mapped_into_the_frame(folder):
    record = {**TWIST, "axis": "Y", "driver_lo": -1.0, "driver_hi": 1.0, "lock": [1, 0, 0]}
    (folder / "twisted" / "deformation.json").write_text(json.dumps(record))
    deformation = load_truth(folder).analytic("twisted")
    assert deformation is not None
    moved = deformation(torch.tensor([[0.5, 1.0, 0.0], [0.0, 1.0, 0.5]]))
    # x is locked: a point with x alone stays, its x does not leak into z.
    assert torch.allclose(moved[0], torch.tensor([0.5, 1.0, 0.0]), atol=1e-6)
    assert moved[1, 2] == pytest.approx(0.5 * np.cos(0.5), abs=1e-6)


@pytest.mark.parametrize("name", OBJECTS)
def test_formulas_agree_with_the_evaluation_sets(shared_data, name):
    truth = load_truth(shared_data / "deformed" / name)
    for state in ANALYTIC:
        deformation = truth.analytic(state)
        assert deformation is not None
        moved = deformation(torch.from_numpy(truth.canonical)).numpy()
        assert np.abs(moved - truth.states[state]).max() < 1e-5
    assert all(truth.analytic(s) is None for s in truth.states if s not in ANALYTIC)


@pytest.mark.parametrize(("name", "state"), [("spot", "bend60"), ("robot", "wave")])
def test_samples_of_the_evaluation_sets_land_on_their_state(shared_data, name, state):
    folder = shared_data / "deformed" / name
    truth = load_truth(folder)
    with np.load(folder / "meshes.npz") as file:
        face, weights = file["sample_face"][:4000], file["sample_barycentric"][:4000]
    before, after = (
        np.einsum("nk,nkd->nd", weights, vertices[truth.faces[face]])
        for vertices in (truth.canonical, truth.states[state])
    )
    moved = truth.carry(torch.from_numpy(before).float(), state).numpy()
    error = np.linalg.norm(moved - after, axis=1)
    # Where two sheets touch, a sample may belong to either: a handful, if any.
    assert np.mean(error < 1e-4) > 0.995


def test_carried_points_near_the_surface_follow_the_formula(shared_data):
    truth = load_truth(shared_data / "deformed" / "spot")
    deformation = truth.analytic("twist60")
    assert deformation is not None
    points = surface_samples(truth, None, 3000) + 0.005 * torch.randn(3000, 3)
    error = (truth.carry(points, "twist60") - deformation(points)).norm(dim=1)
    assert error.mean() < 1e-3


def test_depth_of_a_plane_is_the_same_everywhere():
    vertices = np.array([[-9.0, -9, 0.5], [9, -9, 0.5], [9, 9, 0.5], [-9, 9, 0.5]])
    depth = mesh_depth(vertices, np.array([[0, 1, 2], [0, 2, 3]]), looking_down(4.0))
    assert depth.shape == (21, 21)
    assert torch.allclose(depth, torch.full((21, 21), 3.5), atol=1e-6)


def test_depth_of_a_ball(ball):
    depth = mesh_depth(*ball, looking_down(4.0))
    assert depth[10, 10].item() == pytest.approx(3.0, abs=5e-3)
    assert torch.isinf(depth[0, 0])
    assert torch.isfinite(depth[:, 10]).sum() == torch.isfinite(depth[10, :]).sum()


def test_depth_beside_the_image_centre_is_camera_z():
    """A small square off the axis: upper right in space must be upper right in the picture."""
    square = np.array([[0.6, 0.6, 1.0], [0.9, 0.6, 1.0], [0.9, 0.9, 1.0], [0.6, 0.9, 1.0]])
    depth = mesh_depth(square, np.array([[0, 1, 2], [0, 2, 3]]), looking_down(4.0))
    rows, columns = torch.nonzero(torch.isfinite(depth), as_tuple=True)
    assert len(rows) > 0
    assert rows.max() < 10
    assert columns.min() > 10
    assert torch.allclose(depth[rows, columns], torch.full((len(rows),), 3.0), atol=1e-6)


def test_depth_agrees_with_blenders_silhouette(shared_data):
    Image = pytest.importorskip("PIL.Image")
    folder = shared_data / "deformed" / "knight"
    scene = json.loads((folder / "sit" / "transforms_test.json").read_text())
    frame = scene["frames"][3]
    image = next((folder / "sit").rglob(Path(frame["file_path"]).stem + "*.png"))
    alpha = np.asarray(Image.open(image))[..., 3] / 255
    camera = Camera.from_fov(
        torch.tensor(frame["transform_matrix"]),
        width=alpha.shape[1],
        height=alpha.shape[0],
        angle_x=scene["camera_angle_x"],
    )
    hit = torch.isfinite(load_truth(folder).depth("sit", camera)).numpy()
    assert not (hit & (alpha < 0.05)).any()
    assert not (~hit & (alpha > 0.95)).any()


def test_object_size_is_the_diagonal_of_the_state(folder):
    assert load_truth(folder).object_size() == pytest.approx(2 * np.sqrt(3), rel=0.02)


def test_missing_embree(monkeypatch, ball):
    monkeypatch.setitem(sys.modules, "trimesh.ray.ray_pyembree", None)
    with pytest.raises(DependencyError, match=r"pcore-edit\[sample\]"):
        mesh_depth(*ball, looking_down(4.0))


def test_bad_points(folder):
    truth = load_truth(folder)
    with pytest.raises(InputError, match="NaN or infinity in 1"):
        truth.carry(torch.tensor([[0.0, torch.nan, 0.0], [0.0, 0.0, 0.0]]), "large")
    with pytest.raises(InputError, match=r"expected points \(N, 3\), at least one, got \(4,\)"):
        truth.carry(torch.zeros(4), "large")
    with pytest.raises(InputError, match="no state 'jump'; it has twisted, large, turned"):
        truth.carry(torch.zeros(1, 3), "jump")


def rewrite(folder: Path, **changes: np.ndarray | None) -> None:
    with np.load(folder / "meshes.npz") as file:
        arrays = {**{k: file[k] for k in file.files}, **changes}
    np.savez(folder / "meshes.npz", **{k: v for k, v in arrays.items() if v is not None})


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"canonical": None}, r"vertices 'canonical' of shape \(V, 3\), got nothing"),
        ({"canonical": np.full((642, 3), np.nan)}, "finite vertices 'canonical'"),
        ({"large": np.zeros((7, 3))}, r"'large' of shape \(642, 3\), got float64 of shape \(7, 3"),
        ({"large": np.array(["x"])}, "expected vertices 'large'"),
        ({"faces": np.array([[0, 1, 642]])}, "corners from 0 to 641"),
        ({"faces": np.zeros((0, 3), dtype=int)}, "at least one triangle"),
        ({"faces": np.zeros((2, 3))}, "integer triangles 'faces'"),
        ({"faces": None}, "got nothing"),
        ({"../up": np.zeros((642, 3))}, "expected states named with letters"),
    ],
)
def test_bad_meshes(folder, changes, message):
    rewrite(folder, **changes)
    with pytest.raises(SceneError, match=message):
        load_truth(folder)


def test_missing_and_damaged_mesh_files(folder, tmp_path_factory):
    with pytest.raises(SceneError, match=r"meshes.npz: not found"):
        load_truth(tmp_path_factory.mktemp("empty"))
    path = folder / "meshes.npz"
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(SceneError, match="expected a NumPy archive of plain arrays"):
        load_truth(folder)
    np.save(folder / "one.npy", np.zeros(3))
    (folder / "one.npy").rename(path)
    with pytest.raises(SceneError, match="expected a NumPy archive of plain arrays"):
        load_truth(folder)


def test_pickled_meshes_are_refused(folder):
    rewrite(folder, large=np.array([{"a": 1}], dtype=object))
    with pytest.raises(SceneError, match="expected a NumPy archive of plain arrays"):
        load_truth(folder)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{", "expected JSON, got text that does not parse"),
        ("[]", "expected keys with values"),
        ('{"type": "simple_deform", "method": "MELT"}', "'method': "),
        ('{"type": "simple_deform", "method": "TWIST", "axis": "Z"}', "deform extent"),
        ('{"type": "scale", "factor": NaN}', "'factor': "),
        ('{"type": "scale", "factor": -1}', "scale factor: expected a positive finite number"),
    ],
)
def test_bad_descriptions(folder, text, message):
    (folder / "twisted" / "deformation.json").write_text(text)
    with pytest.raises(SceneError, match=message):
        load_truth(folder).analytic("twisted")


def test_missing_description(folder):
    (folder / "twisted" / "deformation.json").unlink()
    with pytest.raises(SceneError, match=r"deformation.json: no such file"):
        load_truth(folder).analytic("twisted")


def test_a_scaled_object_is_twice_the_size(folder):
    truth = load_truth(folder)
    assert truth.object_size("large") == pytest.approx(2 * truth.object_size())
