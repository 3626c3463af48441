"""Points in files: what is kept, and what is refused."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh

from pcore.data.points import load_points, read_point_file, save_point_glb, save_points
from pcore.errors import InputError

POINTS = torch.tensor([[0.0, 1.0, 2.0], [-1.5, 1e-3, 4.0], [7.0, 8.0, 9.0], [0.1, 0.2, 0.3]])
COLORS = torch.tensor([[1, 2, 3], [4, 5, 6], [7, 8, 255], [0, 0, 0]], dtype=torch.uint8)
FACES = torch.tensor([[0, 1, 2], [2, 3, 0]])
HEADER = (
    "ply\nformat ascii 1.0\nelement vertex 4\n"
    "property double x\nproperty double y\nproperty double z\n"
)


def refusal(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_points(path)
    text = str(caught.value)
    assert text.startswith(f"{path}: ")
    return text


@pytest.mark.parametrize("name", ["points.npy", "points.ply", "POINTS.PLY"])
def test_round_trip(tmp_path: Path, name: str):
    save_points(tmp_path / name, POINTS)
    assert torch.equal(load_points(tmp_path / name), POINTS)
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_an_existing_file_is_replaced(tmp_path: Path):
    for points in (POINTS, POINTS[:2]):
        save_points(tmp_path / "a.ply", points)
    assert torch.equal(load_points(tmp_path / "a.ply"), POINTS[:2])


@pytest.mark.parametrize(
    ("dtype", "kept"),
    [
        (np.float64, torch.float64),
        (np.float32, torch.float32),
        (np.float16, torch.float32),
        (np.int32, torch.float32),
        (">f4", torch.float32),
    ],
)
def test_number_types(tmp_path: Path, dtype, kept: torch.dtype):
    np.save(tmp_path / "a.npy", np.arange(12).reshape(4, 3).astype(dtype))
    assert read_point_file(tmp_path / "a.npy").positions.dtype == kept
    loaded = load_points(tmp_path / "a.npy")
    assert loaded.dtype == torch.float32
    assert torch.equal(loaded, torch.arange(12.0).reshape(4, 3))


def test_double_precision_survives_npy(tmp_path: Path):
    exact = POINTS.double() / 3
    save_points(tmp_path / "a.npy", exact)
    assert torch.equal(read_point_file(tmp_path / "a.npy").positions, exact)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("faces", [None, FACES])
def test_ply_keeps_colours_and_faces(tmp_path: Path, channels: int, faces):
    colors = torch.cat([COLORS, COLORS[:, :1]], dim=1)[:, :channels]
    save_points(tmp_path / "a.ply", POINTS, colors, faces)
    kept = read_point_file(tmp_path / "a.ply")
    assert torch.equal(kept.positions, POINTS)
    assert torch.equal(kept.colors[:, :channels], colors)
    assert kept.faces is None if faces is None else torch.equal(kept.faces, faces)


def test_mesh_vertices_are_neither_merged_nor_reordered(tmp_path: Path):
    doubled = torch.cat([POINTS, POINTS])
    mesh = trimesh.Trimesh(doubled.numpy(), [[0, 1, 2], [4, 5, 6]], process=False)
    mesh.export(tmp_path / "a.ply")
    assert torch.equal(load_points(tmp_path / "a.ply"), doubled)


def test_quads_are_split_and_colours_without_alpha_read(tmp_path: Path):
    colors = "property uchar red\nproperty uchar green\nproperty uchar blue\n"
    rows = "0 0 0 1 2 3\n1 0 0 1 2 3\n1 1 0 1 2 3\n0 1 0.1234567890123 9 8 7\n"
    (tmp_path / "a.ply").write_text(
        HEADER + colors + "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        f"{rows}4 0 1 2 3\n"
    )
    kept = read_point_file(tmp_path / "a.ply")
    assert kept.positions.dtype == torch.float64
    assert kept.positions[3, 2].item() == 0.1234567890123
    assert kept.faces.shape == (2, 3)
    assert set(kept.faces.flatten().tolist()) == {0, 1, 2, 3}
    assert kept.colors[3].tolist() == [9, 8, 7]


@pytest.mark.parametrize("name", ["points.xyz", "points", "points.npz"])
def test_other_endings(tmp_path: Path, name: str):
    ending = Path(name).suffix or "no ending"
    expected = f"expected a file of points that ends in .npy or .ply, got '{ending}'"
    assert expected in refusal(tmp_path / name)
    with pytest.raises(InputError, match=r"ends in \.npy or \.ply"):
        save_points(tmp_path / name, POINTS)


def test_missing_files_and_folders(tmp_path: Path):
    assert "no such file; expected a .npy or .ply" in refusal(tmp_path / "none.npy")
    (tmp_path / "folder.ply").mkdir()
    assert "cannot read a .npy or .ply of points" in refusal(tmp_path / "folder.ply")
    with pytest.raises(InputError, match="expected an existing folder to write to"):
        save_points(tmp_path / "none" / "a.npy", POINTS)
    with pytest.raises(InputError, match="cannot write the points"):
        save_points(tmp_path / "folder.ply", POINTS)
    assert [path.name for path in tmp_path.iterdir()] == ["folder.ply"]


@pytest.mark.parametrize(
    ("array", "expected"),
    [
        (np.zeros((4, 2)), "expected points of shape (N, 3), got shape (4, 2)"),
        (np.zeros(3), "expected points of shape (N, 3), got shape (3,)"),
        (np.zeros((2, 4, 3)), "expected points of shape (N, 3), got shape (2, 4, 3)"),
        (np.zeros((0, 3)), "expected at least one point, got none"),
        (np.full((4, 3), "a"), "expected real numbers, got the type <U1"),
        (np.zeros((4, 3), dtype=complex), "expected real numbers, got the type complex128"),
        (
            np.array([[0, 0, np.nan], [0, 1, 2], [np.inf, 0, 0]]),
            "expected finite coordinates, got NaN or infinity in 2 of 3 points",
        ),
        (np.full((1, 3), 10**30, dtype=np.float64) ** 2, None),
    ],
)
def test_bad_arrays(tmp_path: Path, array: np.ndarray, expected: str | None):
    np.save(tmp_path / "a.npy", array)
    if expected is None:
        assert "too large for single precision" in refusal(tmp_path / "a.npy")
    else:
        assert expected in refusal(tmp_path / "a.npy")


class Trap:
    """Leaves a file behind when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


@pytest.mark.parametrize("inside_array", [True, False])
def test_pickles_are_never_executed(tmp_path: Path, inside_array: bool):
    path, sprung = tmp_path / "a.npy", tmp_path / "sprung"
    if inside_array:
        np.save(path, np.array([Trap(sprung)] * 3, dtype=object), allow_pickle=True)
    else:
        path.write_bytes(pickle.dumps(Trap(sprung)))
    assert "expected a NumPy array of numbers (pickles are never read)" in refusal(path)
    assert not sprung.exists()


def test_damaged_arrays(tmp_path: Path):
    path = tmp_path / "a.npy"
    save_points(path, POINTS)
    whole = path.read_bytes()
    for content in (whole[:-5], whole[:20], b"not numpy"):
        path.write_bytes(content)
        assert "damaged or holds something else; write it again" in refusal(path)
    for content, known in ((b"", "an empty file"), (b"ply\n", "a PLY file"), (b"{}", "JSON text")):
        path.write_bytes(content)
        assert f"(pickles are never read), got {known}; write it" in refusal(path)
    np.savez(tmp_path / "b.npz", points=POINTS.numpy())
    (tmp_path / "b.npz").rename(path)
    assert "expected one NumPy array (N, 3), got an archive (.npz) of them" in refusal(path)


def test_damaged_plys(tmp_path: Path):
    path = tmp_path / "a.ply"
    save_points(path, POINTS, COLORS, FACES)
    whole = path.read_bytes()
    for content, said in (
        (whole[:-5], "expected 2 of the PLY element 'face' as its header says, got 1"),
        (whole[: len(whole) // 2], "whose header has no end; the file is cut short"),
        (b"", "expected a PLY with vertices x, y, z, got an empty file"),
        (b"ply", "expected a PLY with vertices x, y, z"),
        (b"not a ply", "got a file that does not begin with a line 'ply'"),
    ):
        path.write_bytes(content)
        assert said in refusal(path)


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        (
            "end_header\n0 0 0\n1 0 0\n",
            "expected 4 of the PLY element 'vertex' as its header says, got 2",
        ),
        ("end_header\n0 0 0\n1 0 0\n1 0 nan\n1 2 3\n", "NaN or infinity in 1 of 4 points"),
        (
            "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
            "0 0 0\n1 0 0\n1 0 1\n1 2 3\n3 0 1 9\n",
            "expected faces that refer to vertices 0 to 3, got 0 to 9",
        ),
    ],
)
def test_bad_text_plys(tmp_path: Path, body: str, expected: str):
    (tmp_path / "a.ply").write_text(HEADER + body)
    assert expected in refusal(tmp_path / "a.ply")


def test_plys_without_points(tmp_path: Path):
    path = tmp_path / "a.ply"
    path.write_text(HEADER.replace("vertex 4", "vertex 0") + "end_header\n")
    assert "expected at least one point, got none" in refusal(path)
    path.write_text(HEADER.replace(" x\n", " a\n") + "end_header\n" + "0 0 0\n" * 4)
    assert "expected a PLY with vertices x, y, z" in refusal(path)


@pytest.mark.parametrize("colors", [COLORS[:2], COLORS.float()])
def test_bad_colours(tmp_path: Path, colors: torch.Tensor):
    with pytest.raises(InputError, match=r"expected colours \(N, 3\) or \(N, 4\) uint8 for 4"):
        save_points(tmp_path / "a.ply", POINTS, colors)
    assert list(tmp_path.iterdir()) == []


def test_bad_points_are_not_written(tmp_path: Path):
    for points in (POINTS[:, :2], POINTS / 0, POINTS[:0]):
        with pytest.raises(InputError, match=r"a.npy: expected"):
            save_points(tmp_path / "a.npy", points)
    assert list(tmp_path.iterdir()) == []


def test_binary_gltf_reads_back_with_y_up(tmp_path: Path):
    save_point_glb(tmp_path / "a.glb", POINTS, COLORS)
    assert [path.name for path in tmp_path.iterdir()] == ["a.glb"]
    (cloud,) = trimesh.load_scene(tmp_path / "a.glb").geometry.values()
    assert isinstance(cloud, trimesh.PointCloud)
    x, y, z = POINTS.unbind(dim=1)
    np.testing.assert_array_equal(cloud.vertices, torch.stack([x, z, -y], dim=1).numpy())
    np.testing.assert_array_equal(cloud.colors[:, :3], COLORS.numpy())
    save_point_glb(tmp_path / "a.glb", POINTS[:2])
    (cloud,) = trimesh.load_scene(tmp_path / "a.glb").geometry.values()
    assert len(cloud.vertices) == 2


@pytest.mark.parametrize(
    ("name", "points", "colors", "message"),
    [
        ("a.gltf", POINTS, None, "expected a file of points that ends in .glb"),
        ("a.glb", POINTS * torch.nan, None, "NaN or infinity in 4 of 4 points"),
        ("a.glb", POINTS, COLORS[:2], "expected colours (N, 3) or (N, 4) uint8 for 4 points"),
        ("none/a.glb", POINTS, None, "expected an existing folder to write to"),
    ],
)
def test_bad_binary_gltf(tmp_path: Path, name: str, points, colors, message: str):
    with pytest.raises(InputError) as caught:
        save_point_glb(tmp_path / name, points, colors)
    assert message in str(caught.value)
    assert not (tmp_path / name).exists()
