"""Real trainings and pictures of what they give: steps of the loop itself, none made by hand."""

from __future__ import annotations

import statistics
import time
import warnings
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import torch

from benchmarks import scenes
from benchmarks.measure import peak_bytes, seconds
from benchmarks.metrics import Metric
from benchmarks.papr_workloads import fast_error, sharpened
from benchmarks.plan import Plan
from pcore.capture.load import load_scene
from pcore.data.scene import Scene
from pcore.geometry.point_cloud import PointCloud
from pcore.metrics.perceptual import find_weights
from pcore.model.papr import Papr
from pcore.render.picture import FAST_THRESHOLD
from pcore.training.config import PatchConfig, PretrainConfig
from pcore.training.events import Event, StepReport, ValidationReport
from pcore.training.presets import preset
from pcore.training.pretrain import pretrain
from pcore.training.trained import Trained

_WARM, _STEPS = 30, 100
"""Steps before those that count (compilation, the first kernels), and in all."""
_GOOD = 30.0
"""PSNR on held-out views that the `fast` preset is to reach, decibels."""
_CHECKS = 20
"""Validations of the long run; the time to a PSNR is known to one part in so many."""


@dataclass(kw_only=True)
class _Clock:
    """Listens to a training: when reports came, and how often the processor waited for the GPU.

    A report makes one transfer, which waits for all steps before it: times are those of the GPU.
    """

    device: torch.device
    begin: float = field(default_factory=time.perf_counter)
    reports: dict[int, float] = field(default_factory=dict[int, float])
    validations: dict[float, float] = field(default_factory=dict[float, float])
    waits: int | None = None

    def __post_init__(self) -> None:
        self._counting = ExitStack()

    def __call__(self, event: Event) -> None:
        """Take an event."""
        if isinstance(event, ValidationReport):
            self.validations[time.perf_counter() - self.begin] = event.psnr
        if isinstance(event, StepReport):
            self.reports[event.step] = time.perf_counter()
            if event.step == _WARM - 10 and self.device.type == "cuda":
                self._caught = self._counting.enter_context(warnings.catch_warnings(record=True))
                warnings.simplefilter("always")
                before = torch.cuda.get_sync_debug_mode()
                self._counting.callback(torch.cuda.set_sync_debug_mode, before)
                torch.cuda.set_sync_debug_mode("warn")
            if event.step == _WARM and self.device.type == "cuda":
                self.waits = sum("synchronizing" in str(one.message) for one in self._caught)
                self._counting.close()

    def step(self) -> float:
        """Median seconds of a step, of those that count."""
        times = [(at, when) for at, when in self.reports.items() if at >= _WARM]
        return statistics.median(
            (after - before) / (last - first) for (first, before), (last, after) in pairwise(times)
        )


def measure_loop(scene: Scene, name: str, plan: Plan) -> Iterator[tuple[str, Metric]]:
    """Milliseconds and waits of a step of a preset, with what draws and compares patches."""
    config = _config(name, plan)
    clock = _Clock(device=plan.device)
    peak = peak_bytes(
        lambda: pretrain(scene, config, listener=clock, device=str(plan.device)), plan.device
    )
    bar = 10.0 if name == "paper" and not plan.quick else None
    prefix = f"loop/{name}"
    yield f"{prefix}/milliseconds", _lower(1e3 * clock.step(), bar, " ms")
    yield f"{prefix}/lpips", _lower(config.lpips_weight, None, "")
    if clock.waits is not None:
        # The report at the end of the ten steps waits once; what else waits is in ADR 8.
        yield f"{prefix}/waits_in_10_steps", _lower(clock.waits, None, "")
    if peak is not None:
        yield f"{prefix}/memory", _lower(peak / 1e9, None, " GB")


def _config(name: str, plan: Plan) -> PretrainConfig:
    """The preset with the points of a trained model, and LPIPS where its weights are there."""
    config = preset("tiny" if plan.quick else name)  # type: ignore[arg-type]
    if config.lpips_weight > 0 and find_weights(config.lpips_trunk) is None:
        config = replace(config, lpips_weight=0.0)
    if plan.quick:
        config = replace(config, points=200, patch=PatchConfig(side=16))
    elif name == "paper":
        config = replace(config, points=30_000)
    return replace(
        config, steps=_STEPS, validate_every=10**9, save_every=10**9, prune=None, grow=None
    )


def measure_training(
    scene: Scene, budget: float, step: float, plan: Plan, trained: list[Trained]
) -> Iterator[tuple[str, Metric]]:
    """Train `fast` for so many seconds and hand the model over in `trained`.

    Args:
        scene: what is learned.
        budget: seconds; a tenth is left for validations.
        step: seconds of a warm step.
        plan: device and sizes.
        trained: takes the model.
    """
    config = _config("fast", plan)
    most = _STEPS if plan.quick else preset("fast").steps
    steps = max(10, min(most, int(0.9 * budget / step)))
    config = replace(config, steps=steps, validate_every=max(1, steps // _CHECKS))
    clock = _Clock(device=torch.device("cpu"))  # No waits are counted.
    trained.append(pretrain(scene, config, listener=clock, device=str(plan.device)))
    reached = [at for at, psnr in clock.validations.items() if psnr >= _GOOD]
    bars = (None, None) if plan.quick else (_GOOD, 300.0)
    yield "training/steps", _higher(steps, None, "")
    yield "training/seconds", _lower(time.perf_counter() - clock.begin, None, " s")
    yield "training/psnr", _higher([*clock.validations.values()][-1], bars[0], " dB")
    if reached:
        yield "training/seconds_to_30_db", _lower(reached[0], bars[1], " s")


def measure_pictures(model: Trained | None, plan: Plan) -> Iterator[tuple[str, Metric]]:
    """800 x 800 pictures a second, exact and fast: of a `paper`-sized model, and of a trained."""
    size, count = (16, 100) if plan.quick else (800, 30_000)
    config = preset("tiny" if plan.quick else "paper").model
    papr, cloud = scenes.papr(config, scenes.cloud(count), plan.device)
    crop = scenes.on_device(scenes.patch(size // 4, size), plan.device)
    sharp, _ = sharpened(papr, cloud, crop)
    yield from _pictures("paper", papr, sharp, size, plan, (15.0, 30.0))
    if model is not None:
        yield from _pictures("trained", model.papr, model.cloud, size, plan, (None, None))


def _pictures(
    name: str,
    papr: Papr,
    cloud: PointCloud,
    size: int,
    plan: Plan,
    bars: tuple[float | None, float | None],
) -> Iterator[tuple[str, Metric]]:
    camera, turns = scenes.camera(size), 2 if plan.quick else 8
    for kind, threshold, bar in zip(("exact", "fast"), (0.0, FAST_THRESHOLD), bars, strict=True):
        draw: Callable[[], object] = lambda threshold=threshold: scenes.picture(  # noqa: E731
            papr, cloud, camera, threshold
        )
        times = [seconds(draw) for _ in range(turns)]
        rate, promised = 1 / statistics.median(times[1:]), None if plan.quick else bar
        yield f"pictures/{name}/{kind}/per_second", _higher(rate, promised, "/s")
        peak = peak_bytes(draw, plan.device)
        if peak is not None:
            yield f"pictures/{name}/{kind}/memory", _lower(peak / 1e9, None, " GB")
    error = fast_error(papr, cloud, camera)
    yield f"pictures/{name}/fast/psnr", replace(error, bar=None) if plan.quick else error


def load(folder: Path, factor: int) -> Scene:
    """Load the scene; its images are read once, before anything is timed."""
    scene = load_scene(folder, factor=factor)
    for view in scene.split("train"):
        view.rgba()
    return scene


def _higher(value: float, bar: float | None, unit: str) -> Metric:
    return Metric(value=value, direction="higher", tolerance=0.3, bar=bar, unit=unit)


def _lower(value: float, bar: float | None, unit: str) -> Metric:
    return Metric(value=value, direction="lower", tolerance=0.3, bar=bar, unit=unit)
