"""The law of the capture's frame: moved, turned and scaled by 1000, photos train to the same."""

import json
from pathlib import Path

import pytest
import torch

from pcore.capture.load import load_scene
from pcore.training.events import ValidationReport
from pcore.training.gaussian_config import DensityConfig, GaussianConfig
from pcore.training.gaussian_fit import fit_gaussians
from room_scene import moved_camera, similarity
from small_training import Heard
from tiny_scene import write_scene

BAR = 0.1
"""dB of held-out views."""


def moved_scene(folder: Path) -> Path:
    root = write_scene(folder, states=False)
    scene = load_scene(root)
    for split in scene.splits:
        path = root / f"transforms_{split}.json"
        content = json.loads(path.read_text())
        for frame, view in zip(content["frames"], scene.split(split), strict=True):
            there = moved_camera(view.camera, similarity())
            frame["transform_matrix"] = there.world_from_camera.tolist()
        path.write_text(json.dumps(content))
    return root


@pytest.mark.slow
def test_a_capture_elsewhere_is_the_same_to_a_tenth_of_a_decibel(tmp_path: Path) -> None:
    figures: list[float] = []
    for root in (write_scene(tmp_path / "here", states=False), moved_scene(tmp_path / "there")):
        heard = Heard()
        config = GaussianConfig(
            steps=600,
            points=600,
            density=DensityConfig(limit=800),
            validate_every=600,
            save_every=600,
            hold_out=3,
        )
        fit_gaussians(load_scene(root), config, listener=heard)
        figures.append(heard.of(ValidationReport)[-1].psnr)
    assert figures[0] > 25
    assert torch.tensor(figures).diff().abs().item() < BAR, figures
