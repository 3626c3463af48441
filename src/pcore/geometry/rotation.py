"""Rotations by quaternion, and those that fit best to a matrix and to how neighbours moved."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

_FLATNESS = 1e-9


def rotations(quaternion: Tensor) -> Tensor:
    """Rotation matrices (..., 3, 3) of quaternions (..., 4) w, x, y, z of any length but 0.

    Columns are the axes. Differentiable.
    """
    w, x, y, z = torch.nn.functional.normalize(quaternion, dim=-1).unbind(dim=-1)
    entries = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(entries, dim=-1).unflatten(-1, (3, 3))


def nearest_rotation(matrices: Tensor) -> Tensor:
    """Rotations (..., 3, 3) nearest to matrices (..., 3, 3) in the Frobenius norm, det = +1.

    With matrix = U S V^T it is U diag(1, 1, det(U V^T)) V^T: the smallest singular direction is
    flipped where the nearest orthogonal matrix would be a mirror. Computed in float64, without a
    gradient.
    """
    # NumPy's batched SVD of small matrices takes half the time of torch's.
    left, _, right = np.linalg.svd(matrices.detach().cpu().double().numpy())
    left[..., 2] *= np.where(np.linalg.det(left @ right) < 0, -1.0, 1.0)[..., None]
    return torch.from_numpy(left @ right).to(matrices)


@torch.no_grad()
def procrustes(before: Tensor, after: Tensor, weights: Tensor) -> Tensor:
    """Rotations (..., 3, 3) that best turn offsets `before` into offsets `after`; no gradient.

    R minimises sum_k w_k |R before_k - after_k|^2 (Kabsch, Umeyama): the rotation nearest to
    sum_k w_k after_k before_k^T. Offsets along one line leave the turn about it open; a vanishing
    multiple of the identity in the matrix then chooses one.

    Args:
        before: (..., K, 3) offsets at rest.
        after: (..., K, 3) the same offsets now.
        weights: (..., K) not negative.
    """
    weighted = (weights.unsqueeze(-1) * after).double()
    matrix = weighted.transpose(-1, -2) @ before.double()
    size = (weights * before.square().sum(dim=-1)).sum(dim=-1).double()
    eye = torch.eye(3, dtype=torch.float64)
    # Relative to the offsets, so that units do not matter.
    matrix = matrix + _FLATNESS * size[..., None, None] * eye
    return nearest_rotation(matrix).to(before.dtype)
