"""What a tab is sent, by a client that only notes it."""

from types import SimpleNamespace
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch

from pcore.gaussians.splats import Splats
from pcore.studio.page_frame import PageFrame

pytest.importorskip("viser", reason="the extra studio is not installed")
from pcore.studio.viewport import Viewport


def test_marks_stand_before_points_as_large() -> None:
    points = torch.rand(50, 3)
    client = MagicMock()
    client.camera.position = np.array([0.0, -30.0, 0.0])
    client.scene.add_point_cloud = lambda name, **given: SimpleNamespace(**given)
    viewport = Viewport(client, PageFrame.around(points), (1.0, 1.0, 1.0))
    flat = {"covariances": np.zeros((50, 3, 3)), "opacities": np.ones(50)}
    splats = Splats(centers=points.numpy(), rgb=np.ones((50, 3), np.float32), **flat)
    viewport.show_points(splats, 0.1)
    viewport.show_dots(points, torch.zeros(50, 3, dtype=torch.uint8), points[:3])
    nearer = viewport._points.points - viewport._dots.points
    assert nearer[:, 1] == pytest.approx(viewport._points.point_size, rel=0.1)
    # Where space folds has another shape and size than what is merely marked.
    dots, folds = viewport._dots, viewport._folds
    assert folds.point_shape != dots.point_shape
    assert folds.point_size > 2 * dots.point_size
    assert len(folds.points) == 3


def test_walls_of_a_room_have_shapes_on_the_page_of_a_small_object() -> None:
    """They are huge there, and half precision has no number for them."""
    client, points = MagicMock(), torch.rand(5, 3)
    viewport = Viewport(client, PageFrame.around(points), (1.0, 1.0, 1.0))
    shapes = np.full((5, 3, 3), 1e6, np.float32)
    colors = {"rgb": np.ones((5, 3), np.float32), "opacities": np.ones(5)}
    viewport.show_splats(Splats(centers=points.numpy(), covariances=shapes, **colors))
    given = client.scene.add_gaussian_splats.call_args.kwargs["covariances"]
    assert np.isfinite(given.astype(np.float16)).all()
