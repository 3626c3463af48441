import zlib

import numpy as np
import pytest
import torch
from objects import TWIST, demo

from pcore.editing.animation import Animation
from pcore.studio.packing import Packed, pack
from pcore.studio.recording import Recording, record

PLENTY = 10**8


@pytest.fixture(scope="module")
def recording() -> Recording:
    asset, animation = demo(), Animation(TWIST)
    return record(asset, [asset.pose(animation, time=t) for t in (0.0, 0.4, 0.7, 1.0)])


def arrays(packed: Packed) -> dict[str, np.ndarray]:
    data = zlib.decompress(packed.data)
    return {
        name: np.frombuffer(data, place["type"], place["length"], place["from"])
        for name, place in packed.head["arrays"].items()
    }


def test_means_and_shapes_come_back(recording: Recording) -> None:
    packed = pack(recording, PLENTY)
    found, count = arrays(packed), len(recording)
    assert packed.notes == ()
    low, high = (np.array(corner) for corner in packed.head["box"])
    means = found["means"].reshape(-1, 3, count).swapaxes(1, 2) / 65535 * (high - low) + low
    small, large = packed.head["sizes"]
    sizes = np.exp(small + (large - small) * found["scales"].reshape(-1, count, 1) / 65535)
    entries = found["factors"].reshape(-1, 6, count).swapaxes(1, 2) / 127 * sizes
    for t, moment in enumerate(recording.moments):
        assert np.abs(means[t] - moment.means.numpy()).max() < 2e-5 * (high - low).max()
        factor = np.zeros((count, 3, 3))
        factor[:, *np.tril_indices(3)] = entries[t]
        spread, true = factor @ factor.swapaxes(1, 2), moment.covariances.numpy()
        largest = np.trace(true, axis1=1, axis2=2)
        assert (np.abs(spread - true).max(axis=(1, 2)) < 0.02 * largest + 1e-12).all()


def test_turns_and_gains_come_back(recording: Recording) -> None:
    packed = pack(recording, PLENTY)
    found, last = arrays(packed), recording.moments[-1]
    turns = found["turns"].reshape(4, 4, -1)[-1].T / 127
    assert np.abs(turns - last.turns.numpy()).max() < 0.005
    gains = 2 ** ((found["gains"].reshape(4, -1)[-1].astype(float) - 128) / packed.head["gain"])
    assert np.abs(gains / last.gains.numpy() - 1).max() < 0.02
    assert last.gains.min() < 0.95, "the twist changes the light"


def test_what_does_not_fit_is_left_out_and_said(recording: Recording) -> None:
    whole = pack(recording, PLENTY)
    for share in (0.8, 0.4, 0.05):
        limit = int(share * len(whole.data))
        packed = pack(recording, limit)
        assert len(packed.data) <= limit
        assert packed.notes
    assert "splats that show most" in packed.notes[-1]
    assert packed.head["count"] < len(recording)


def test_one_splat_of_no_thickness_is_packed() -> None:
    asset = demo()
    rest = record(asset, [asset.pose()])
    one = torch.zeros(1, dtype=torch.int64)
    moment = rest.moments[0]
    moments = (
        type(moment)(
            means=moment.means[one],
            covariances=torch.zeros(1, 3, 3),
            turns=moment.turns[one],
            gains=moment.gains[one],
        ),
    )
    single = Recording(
        moments=moments,
        opacities=rest.opacities[one],
        sh=rest.sh[one],
        footprint=rest.footprint,
        background=rest.background,
        body=rest.body[one],
        axes=rest.axes,
    )
    assert pack(single, PLENTY).head["count"] == 1
