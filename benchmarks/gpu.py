"""`python -m benchmarks gpu DATA`: what a machine with a GPU and without network is asked.

Parity with the specification, speed, a training run on a scene, pictures in a loop: in under ten
minutes, into one JSON file. `--quick --device cpu` shows on any machine that it runs.
"""

from __future__ import annotations

import itertools
import json
import os
import statistics
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from unittest import mock

import torch
import tyro
from torch import Tensor

from benchmarks import scenes
from benchmarks.measure import machine, seconds
from benchmarks.plan import Plan
from benchmarks.workloads import WORKLOADS
from pcore.data.load import load_scene
from pcore.kernels import cpu_search, functional, reference
from pcore.kernels.backends import usable
from pcore.model.render import render
from pcore.training.config import PatchConfig
from pcore.training.events import Event, ValidationReport
from pcore.training.loop import autocast
from pcore.training.presets import preset
from pcore.training.pretrain import pretrain
from pcore.training.trainable import trainable
from pcore.training.trained import Trained

_TRIAL_STEPS = 30


@dataclass(frozen=True, kw_only=True)
class Gpu:
    """Parity, speed, a training run and a render loop on a GPU; one JSON file."""

    data: tyro.conf.Positional[Path]
    """Folder of a scene in a format that pcore knows; at most 60 MB travel well."""
    out: Path = Path("gpu.json")
    """Where the result is written, part by part."""
    device: str = "cuda"
    """cuda, or cpu with --quick."""
    factor: int = 2
    """Down-scaling of the scene's images (800 to 400 pixels)."""
    training_seconds: float = 240.0
    """About how long the `fast` preset trains; the number of steps follows from its speed."""
    quick: bool = False
    """Tiny sizes that only show that everything runs."""

    def run(self) -> int:
        """Measure part after part; return the exit status, 1 without parity."""
        device, begin = torch.device(self.device), time.perf_counter()
        result: dict[str, object] = {"machine": machine(device, torch.get_num_threads())}
        trained: list[Trained] = []
        parts = {
            "parity": lambda: parity(device, quick=self.quick),
            "speed": lambda: speed(device, quick=self.quick),
            "attention": lambda: attention(device, quick=self.quick),
            "step": lambda: training_step(device, quick=self.quick),
            "training": lambda: training(self, trained),
            "rendering": lambda: rendering(trained[0], quick=self.quick),
        }
        for name, part in parts.items():
            result[name] = part()
            result["seconds"] = round(time.perf_counter() - begin, 1)
            # A lease that ends early leaves the parts that were done.
            self.out.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
            print(f"{name}: {json.dumps(result[name])}", flush=True)
        return 0 if all(found == 1.0 for found in _shares(result["parity"])) else 1


def _shares(found: object) -> list[float]:
    return [share for name, share in dict(found).items() if name.startswith("same")]  # type: ignore[call-overload]


def parity(device: torch.device, *, quick: bool) -> dict[str, float]:
    """Compare the backend of the device with the search on the CPU and with the specification."""
    side, count = (8, 100) if quick else (64, 30_000)
    points = scenes.cloud(count)
    found: dict[str, float] = {}
    for name, rays, cloud in (
        ("camera", scenes.patch(side, 5 * side).flat(), points),
        ("near_surface", *scenes.near_surface(side, 5 * side, points)),
    ):
        origins, directions = rays.origins.contiguous(), rays.directions.contiguous()
        moved = (origins.to(device), directions.to(device), cloud.to(device))
        mine = functional.nearest_to_rays(*moved, 20)
        expected = cpu_search.nearest_to_rays(origins, directions, cloud, 20)
        found[f"same_as_cpu/{name}"] = _share(mine.cpu(), expected)
        # Sums in another order: points equally far within float32 may change places.
        dense = reference.nearest_to_rays(*moved, 20)
        found[f"as_reference/{name}"] = _share(mine.sort(-1).values, dense.sort(-1).values)
    return found | {"features": _features(device, points, quick=quick)}


def _share(found: Tensor, expected: Tensor) -> float:
    return float((found == expected).all(dim=-1).double().mean())


def _features(device: torch.device, points: Tensor, *, quick: bool) -> float:
    """Largest difference of the attention's features from those of the CPU, float32."""
    papr, cloud = scenes.papr(
        preset("tiny" if quick else "paper").model, points, torch.device("cpu")
    )
    rays = scenes.patch(8 if quick else 16, 80)
    with torch.no_grad():
        expected = papr(cloud, rays).features
        found = papr.to(device)(cloud.to(device), scenes.on_device(rays, device)).features.cpu()
    return float((found - expected).abs().max() / expected.abs().max())


def speed(device: torch.device, *, quick: bool) -> dict[str, object]:
    """Every workload of `python -m benchmarks speed` on the device."""
    plan = Plan(device=device, quick=quick, repeats=1 if quick else 3)
    return {
        name: asdict(metric) for measure in WORKLOADS.values() for name, metric in measure(plan)
    }


def training_step(device: torch.device, *, quick: bool) -> dict[str, float]:
    """Median milliseconds of a step of 160 x 160 rays, forward, backward and Adam.

    And how often such a step waits for the GPU.
    """
    name, side, count = ("tiny", 8, 100) if quick else ("paper", 160, 30_000)
    config = preset(name)
    work = trainable("pretrain", *scenes.papr(config.model, scenes.cloud(count), device), seed=0)
    rays = scenes.on_device(scenes.patch(side, 5 * side), device)

    def step() -> None:
        work.optimizer.zero_grad(set_to_none=True)
        with autocast(device, enabled=config.mixed_precision):
            rgb = work.papr(work.cloud, rays).rgb
        rgb.float().square().mean().backward()
        work.optimizer.step()

    times = [seconds(step) for _ in range(3 if quick else 20)]
    found = {"milliseconds": 1e3 * statistics.median(times[2:])}
    return found | {"waits": waits(step)} if device.type == "cuda" else found


def waits(step: Callable[[], None]) -> int:
    """How often a step makes the processor wait for the GPU, as torch counts it."""
    mode = torch.cuda.get_sync_debug_mode()
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            step()
        finally:
            torch.cuda.set_sync_debug_mode(mode)
    return sum("synchronizing" in str(one.message) for one in caught)


def attention(device: torch.device, *, quick: bool) -> dict[str, float]:
    """Milliseconds of attention, forward and with gradients, by every backend of the device.

    And the largest difference of the gradients from those of the specification in float32,
    relative to the largest of each parameter.
    """
    name, side, count = ("tiny", 8, 100) if quick else ("paper", 64, 30_000)
    papr, cloud = scenes.papr(preset(name).model, scenes.cloud(count), device)
    rays = scenes.on_device(scenes.patch(side, 5 * side).flat(), device)
    leaves = list(papr.attention.parameters())
    found: dict[str, float] = {}
    expected: list[Tensor] = []
    for kind, half in itertools.product(usable(device), (False, True)):

        def forward(half: bool = half) -> Tensor:
            with autocast(device, enabled=half):
                return papr.attend(cloud, rays)[0].features.float().square().mean()

        with mock.patch.dict(os.environ, PCORE_KERNELS=kind):
            gradients = torch.autograd.grad(forward(), leaves)
            label = f"{kind}/{'half' if half else 'single'}"
            with torch.no_grad():
                found[f"forward/{label}"] = 1e3 * min(seconds(forward) for _ in range(3))
            found[f"both/{label}"] = 1e3 * min(
                seconds(lambda: torch.autograd.grad(forward(), leaves)) for _ in range(3)
            )
        expected = expected or list(gradients)
        found[f"gradients/{label}"] = max(
            float((one - other).abs().max() / other.abs().max().clamp_min(1e-12))
            for one, other in zip(gradients, expected, strict=True)
        )
    return found


def training(wanted: Gpu, trained: list[Trained]) -> dict[str, object]:
    """Train the `fast` preset for about the wanted time; hand the model over in `trained`."""
    scene, device = load_scene(wanted.data, factor=wanted.factor), torch.device(wanted.device)
    config = replace(preset("fast"), validate_every=10**9, save_every=10**9)
    if wanted.quick:
        config = replace(preset("tiny"), points=200, patch=PatchConfig(side=16))
    trial = seconds(
        lambda: pretrain(scene, replace(config, steps=_TRIAL_STEPS), device=str(device))
    )
    steps = max(_TRIAL_STEPS, int(_TRIAL_STEPS * wanted.training_seconds / trial))
    validations: list[ValidationReport] = []

    def listen(event: Event) -> None:
        if isinstance(event, ValidationReport):
            validations.append(event)

    config = replace(config, steps=steps, validate_every=max(1, steps // 10))
    begin = time.perf_counter()
    trained.append(pretrain(scene, config, listener=listen, device=str(device)))
    return {
        "steps": steps,
        "seconds": time.perf_counter() - begin,
        "psnr": {event.step: event.psnr for event in validations},
    }


def rendering(model: Trained, *, quick: bool) -> dict[str, float]:
    """Pictures per second of the trained model."""
    size, count = (16, 2) if quick else (800, 20)
    camera = scenes.camera(size)
    times = [seconds(lambda: render(model.papr, model.cloud, camera)) for _ in range(count)]
    return {"size": size, "pictures_per_second": 1 / statistics.median(times[1:])}
