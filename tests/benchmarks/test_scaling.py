"""`python -m benchmarks scaling`: the exponent is that of a power, and every series runs."""

from __future__ import annotations

import math

import pytest

from benchmarks import scaling


def test_exponents_of_powers() -> None:
    sizes = [10, 100, 1000]
    assert scaling.exponent(sizes, [3 * n**1.5 for n in sizes]) == pytest.approx(1.5)


@pytest.mark.parametrize("name", ["PAPR", "Gaussians"])
def test_a_row_of_each_kind(name: str) -> None:
    chosen = next(one for one in scaling.series() if one.name.startswith(name))
    cells = scaling.row(chosen, (200, 400), 1).split("|")
    assert cells[1].strip() == chosen.name
    assert "200, 400" in cells[2]
    seconds, memory = ([float(one) for one in cells[k].split(",")] for k in (3, 4))
    told = [float(one) for one in cells[5:9]]
    for values, both in ((seconds, told[:2]), (memory, told[2:])):
        expected = math.log2(values[1] / values[0])  # Of two sizes both are the same.
        assert both == pytest.approx([expected, expected], abs=0.15)  # Digits are rounded.
    assert len(cells) == 10
