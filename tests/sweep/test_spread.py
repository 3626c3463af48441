"""Means, spreads and paired differences against numpy and scipy."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import ttest_1samp

from pcore.sweep.spread import paired_differences, variant_means
from pcore.sweep.sweep_scores import Score

SCENES, SEEDS = ("knight", "robot"), (0, 1, 2)


def score(setting: str, method: str, scene: str, seed: int, psnr: float | None) -> Score:
    return Score(
        scene=scene,
        setting=setting,
        seed=seed,
        method=method,
        state="canonical",
        protocol="standard",
        scores={"psnr": psnr},
    )


def scores(
    value: Callable[[str, str, int], float], methods: tuple[str, ...] = ("PAPR", "aware")
) -> list[Score]:
    rng = np.random.default_rng(0)
    noise = {(scene, seed): rng.normal() for scene in SCENES for seed in SEEDS}
    return [
        score(setting, method, scene, seed, value(setting, scene, seed) + noise[scene, seed])
        for scene in SCENES
        for setting in ("small", "large")
        for seed in SEEDS
        for method in methods
    ]


def test_means_and_spreads_over_seeds() -> None:
    found = scores(lambda setting, scene, seed: 20.0 + 10 * (scene == "robot"))
    values = np.array(
        [
            [
                one.scores["psnr"]
                for one in found
                if (one.scene, one.setting, one.method) == (scene, "small", "PAPR")
            ]
            for scene in SCENES
        ]
    )
    means = {(m.setting, m.method, m.scene): m.figures["psnr"] for m in variant_means(found)}
    assert len(means) == 2 * 2 * 3
    for row, scene in zip(values, SCENES, strict=True):
        one = means["small", "PAPR", scene]
        assert one.mean == pytest.approx(row.mean())
        assert one.spread == pytest.approx(row.std(ddof=1))
    both = means["small", "PAPR", "all"]
    assert both.mean == pytest.approx(values.mean())
    # Over seeds, not over scenes, which differ by 10 dB.
    assert both.spread == pytest.approx(values.mean(axis=0).std(ddof=1))
    assert both.count == len(SEEDS)


def test_differences_are_paired() -> None:
    """What scene and seed do to both sides falls out."""
    gain = {("large", s, k): 0.5 + 0.1 * k for s in SCENES for k in SEEDS}
    found = scores(lambda *key: gain.get(key, 0.0))
    pairs = {(d.setting, d.method): d for d in paired_differences(found)}
    assert {key: one.against for key, one in pairs.items()} == {
        ("small", "aware"): ("small", "PAPR"),
        ("large", "PAPR"): ("small", "PAPR"),
        ("large", "aware"): ("small", "aware"),
    }
    one = pairs["large", "PAPR"].figures["psnr"]
    expected = np.array([*gain.values()])
    assert one.count == 6
    assert one.mean == pytest.approx(expected.mean())
    assert one.spread == pytest.approx(expected.std(ddof=1))
    interval = ttest_1samp(expected, 0.0).confidence_interval(0.95)
    assert one.interval() == pytest.approx((interval.low, interval.high))


def test_only_like_is_compared_with_like() -> None:
    """A trial that failed leaves its pair out, and the mean over scenes where a scene has none."""
    found = scores(lambda *key: 0.0, methods=("PAPR",))
    without = [one for one in found if (one.setting, one.scene) != ("large", "robot")]
    means = {(m.setting, m.scene) for m in variant_means(without)}
    assert means == {
        ("small", "knight"),
        ("small", "robot"),
        ("small", "all"),
        ("large", "knight"),
    }
    assert [d.figures["psnr"].count for d in paired_differences(without)] == [len(SEEDS)]


def test_infinity_and_what_is_not_known_are_left_out() -> None:
    found = [
        score("small", "PAPR", "knight", 0, math.inf),
        score("small", "PAPR", "knight", 1, None),
        score("small", "PAPR", "knight", 2, 30.0),
        score("large", "Gaussians", "knight", 2, 31.0),
    ]
    means = variant_means(found)
    assert means[0].figures["psnr"].count == 1
    assert means[0].figures["psnr"].spread is None
    (one,) = paired_differences(found)
    # The first setting has no such method: its first one stands for it.
    assert one.against == ("small", "PAPR")
    assert one.figures["psnr"].mean == 1.0
    assert one.figures["psnr"].interval() is None
    assert paired_differences([]) == []
