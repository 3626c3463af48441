"""Files of captures that went wrong in many ways each: a scene or a PcoreError, never else."""

from pathlib import Path
from random import Random

import pytest
from tests.fuzz.mutations import bytes_mutated, json_mutated, text_mutated

from capture_files import (
    write_camera_list,
    write_colmap,
    write_idr,
    write_llff,
    write_ngp,
    write_nsvf,
)
from pcore.capture.load import load_scene
from pcore.errors import PcoreError

TIMES = 60
BOX = [[0, 0, 0], [1, 1, 1]]
CASES = {
    "sparse/0/cameras.bin": (write_colmap, bytes_mutated, {}),
    "sparse/0/images.bin": (write_colmap, bytes_mutated, {}),
    "sparse/0/points3D.bin": (write_colmap, bytes_mutated, {}),
    "sparse/0/cameras.txt": (write_colmap, text_mutated, {"text": True}),
    "sparse/0/images.txt": (write_colmap, text_mutated, {"text": True}),
    "sparse/0/points3D.txt": (write_colmap, text_mutated, {"text": True}),
    "transforms.json": (write_ngp, json_mutated, {"aabb": BOX, "k1": 0.1}),
    "cameras_sphere.npz": (write_idr, bytes_mutated, {}),
    "poses_bounds.npy": (write_llff, bytes_mutated, {}),
    "intrinsics.txt": (write_nsvf, text_mutated, {}),
    "pose/0_0001.txt": (write_nsvf, text_mutated, {}),
    "bbox.txt": (write_nsvf, text_mutated, {}),
    "cameras.json": (write_camera_list, json_mutated, {}),
}


@pytest.mark.parametrize("file", CASES)
def test_harmed(file: str, tmp_path: Path) -> None:
    write, mutate, options = CASES[file]
    write(tmp_path, **options)
    whole, outcomes = (tmp_path / file).read_bytes(), set()
    for number in range(TIMES):
        (tmp_path / file).write_bytes(mutate(whole, Random(number)))
        try:
            view = load_scene(tmp_path).split("train")[0]
            outcomes.add(view.rgba().shape[-1] == 4)
        except PcoreError:
            outcomes.add("refused")
    assert outcomes == {True, "refused"}
