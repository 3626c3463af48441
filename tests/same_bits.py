"""Whether the number of threads changes anything."""

from collections.abc import Callable, Mapping

import torch
from torch import Tensor


def assert_same_bits(compute: Callable[[], Mapping[str, Tensor]]) -> None:
    """Compute with one thread and with two."""
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(1)
        one = compute()
        torch.set_num_threads(2)
        two = compute()
    finally:
        torch.set_num_threads(before)
    assert one.keys() == two.keys()
    for name, tensor in one.items():
        assert torch.equal(tensor, two[name]), name
