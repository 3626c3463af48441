import json
import struct

import numpy as np
import pytest
import torch
from tests.gaussians.some import some_gaussians

from pcore.data.splat_formats import glb_content
from pcore.gaussians.covariance import covariances
from pcore.gaussians.spherical_harmonics import basis

NAME = "KHR_gaussian_splatting"


def opened(content: bytes) -> tuple[dict, dict[str, np.ndarray]]:
    """JSON and attributes of a .glb, with its lengths checked."""
    magic, version, size = struct.unpack_from("<4sII", content)
    assert (magic, version, size) == (b"glTF", 2, len(content))
    length, kind = struct.unpack_from("<I4s", content, 12)
    assert kind == b"JSON"
    assert length % 4 == 0
    document = json.loads(content[20 : 20 + length])
    body_size, kind = struct.unpack_from("<I4s", content, 20 + length)
    assert kind == b"BIN\0"
    body = content[28 + length :]
    assert len(body) == body_size >= document["buffers"][0]["byteLength"]
    primitive = document["meshes"][0]["primitives"][0]
    arrays = {}
    for name, number in primitive["attributes"].items():
        accessor = document["accessors"][number]
        view = document["bufferViews"][accessor["bufferView"]]
        width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor["type"]]
        data = body[view["byteOffset"] : view["byteOffset"] + view["byteLength"]]
        arrays[name] = np.frombuffer(data, "<f4").reshape(accessor["count"], width)
    return document, arrays


def test_the_document_is_that_of_the_extension():
    document, arrays = opened(glb_content(some_gaussians(5, degree=3)))
    primitive = document["meshes"][0]["primitives"][0]
    assert primitive["mode"] == 0
    own = primitive["extensions"][NAME]
    assert own == {"kernel": "ellipse", "colorSpace": "srgb_rec709_display"}
    assert document["extensionsUsed"] == [NAME]
    assert sum("SH_DEGREE" in name for name in arrays) == 16
    box = document["accessors"][primitive["attributes"]["POSITION"]]
    np.testing.assert_array_equal(box["max"], arrays["POSITION"].max(axis=0))


def test_shapes_and_colours_are_turned_to_y_up():
    gaussians = some_gaussians(30, dtype=torch.float64)
    _, arrays = opened(glb_content(gaussians))
    up = torch.tensor([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]], dtype=torch.float64)
    np.testing.assert_allclose(arrays["POSITION"], gaussians.means @ up.T, rtol=1e-6)
    x, y, z, w = (torch.from_numpy(arrays[f"{NAME}:ROTATION"][:, k].copy()) for k in range(4))
    scales = torch.from_numpy(arrays[f"{NAME}:SCALE"].copy()).double()
    found = covariances(torch.stack([w, x, y, z], dim=1).double(), scales)
    expected = up @ covariances(gaussians.quats, gaussians.scales) @ up.T
    torch.testing.assert_close(found, expected, atol=1e-6, rtol=1e-5)
    np.testing.assert_allclose(arrays[f"{NAME}:OPACITY"][:, 0], gaussians.opacities, rtol=1e-6)
    bands = [(d, k) for d in range(4) for k in range(2 * d + 1)]
    sh = np.stack([arrays[f"{NAME}:SH_DEGREE_{d}_COEF_{k}"] for d, k in bands], axis=1)
    seen = torch.nn.functional.normalize(torch.randn(30, 3, dtype=torch.float64), dim=1)
    before = (basis(3, seen)[..., None] * gaussians.sh).sum(dim=1)
    after = (basis(3, seen @ up.T)[..., None] * torch.from_numpy(sh)).sum(dim=1)
    torch.testing.assert_close(after, before, atol=1e-5, rtol=0)


@pytest.mark.parametrize(("degree", "bands"), [(0, 1), (2, 9), (4, 16)])
def test_degrees_up_to_3_are_written(degree: int, bands: int):
    _, arrays = opened(glb_content(some_gaussians(3, degree=degree)))
    assert sum("SH_DEGREE" in name for name in arrays) == bands
