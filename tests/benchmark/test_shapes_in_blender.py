"""Where Blender moves the vertices of what it exports, there we move those of the file.

PCORE_BPY names a Python that imports bpy, where this one does not; else this is skipped.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pcore.benchmark.model import read_model

BPY = os.environ.get("PCORE_BPY") or (sys.executable if importlib.util.find_spec("bpy") else None)
FRAMES_A_SECOND = 24
KEYS = {"1", "10", "20", "30"}
"""Frames. Between them Blender takes straight ways from quaternion to quaternion, glTF arcs."""


@pytest.mark.bpy
@pytest.mark.timeout(600)
@pytest.mark.skipif(BPY is None, reason="no Blender: set PCORE_BPY to a Python that imports bpy")
def test_skins_morphs_and_shared_meshes_move_as_in_blender(tmp_path: Path) -> None:
    script = Path(__file__).with_name("blender_shapes.py")
    subprocess.run([str(BPY), str(script), str(tmp_path)], check=True, capture_output=True)
    for kind, named in (("BEZIER", "CUBICSPLINE"), ("CONSTANT", "STEP"), ("LINEAR", "LINEAR")):
        model = read_model(tmp_path / f"{kind}.glb")
        (clip,) = model.clips
        assert named in {track.interpolation for track in clip.tracks}
        with np.load(tmp_path / f"{kind}.npz") as frames:
            for frame in KEYS if kind == "LINEAR" else frames.files:
                theirs = frames[frame]
                ours = model.at(clip, float(frame) / FRAMES_A_SECOND)
                # The exporter cuts vertices at seams: those of one place are one here.
                for some, others in ((ours, theirs), (theirs, ours)):
                    away, _ = cKDTree(some).query(others)
                    assert away.max() < 1e-6 * np.ptp(theirs, axis=0).max(), (kind, frame)
