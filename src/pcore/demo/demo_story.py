"""The demo's comparison: figures, pictures and videos of all methods on the sample."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import torch
from torch import Tensor

from pcore.asset.asset import Asset
from pcore.asset.content import RaysName
from pcore.data.pictures import to_bytes
from pcore.data.video import write_video
from pcore.demo.demo_folder import DemoFolder, stamp_of
from pcore.demo.demo_settings import DemoSettings
from pcore.evaluation.asset_method import AssetMethod
from pcore.evaluation.figures import png_bytes
from pcore.evaluation.methods import never_seen, open_subject
from pcore.evaluation.panels import depth_maps, object_window, renderings, strain_maps
from pcore.evaluation.protocol import load_perceptual
from pcore.evaluation.runner import Taken, evaluate
from pcore.evaluation.states import SceneStates, State, open_states
from pcore.evaluation.summary import gains, state_means
from pcore.evaluation.tables import SUMMARY_FILE, read_summary, summary_record, write_tables
from pcore.files.atomic import write_atomically
from pcore.files.gaussian_file import GAUSSIANS_FILE
from pcore.files.model_file import MODEL_FILE
from pcore.geometry.camera import Camera
from pcore.geometry.orbit import orbit_like

Tell = Callable[[int, int], None]
"""Told (done, total)."""

BASELINE, METHOD, AWARE, CARRIED = "PAPR", "P-CORE", "aware + P-CORE", "Gaussians affine"
METHODS = (BASELINE, METHOD, "aware", AWARE, CARRIED)
RUNS = {BASELINE: "papr", METHOD: "pcore", CARRIED: "gaussians"}
"""Run folders of the demo by the method that they are named by."""
STATES = ("twist60", "bend60", "stretch", "scale2x")
FILMED = (BASELINE, METHOD, AWARE, CARRIED)
CANONICAL_VIDEO, DEFORMED_VIDEO = "canonical.mp4", "deformed.mp4"
_FPS = 16


def models_of(folder: DemoFolder, device: str) -> dict[str, Asset]:
    """Open the runs: PAPR before and after fine-tuning, and Gaussians."""
    return {name: open_subject(folder.path / run, device=device) for name, run in RUNS.items()}


def evaluate_demo(
    folder: DemoFolder, settings: DemoSettings, models: dict[str, Asset], tell: Tell
) -> None:
    """Score the models on all states and keep the pictures that the report shows."""
    stamp = _stamp(folder, list(settings.shown), "strain")
    output = folder.path / "eval"
    if folder.done("evaluation", stamp) and (output / SUMMARY_FILE).is_file():
        return
    (output / "panels").mkdir(parents=True, exist_ok=True)
    states, perceptual = _states(folder), load_perceptual()
    methods = _methods(models, states)
    with folder.timed("evaluation", stamp):
        rows = evaluate(
            methods,
            states.select(STATES),
            perceptual=perceptual,
            progress=tell,
            show=lambda taken: _keep(taken, settings.shown, output / "panels"),
        )
        means = state_means(rows)
        about = {"run": "pcore", "baseline": "papr", "scene": "sample", "factor": 1}
        found = gains(means, BASELINE)
        write_tables(output, rows, summary_record(means, found, about=about, perceptual=perceptual))


def panel(output: Path, state: str, view: int, number: int) -> Path:
    """File of a picture: truth and METHODS (0 to 5), their depth maps, strain of METHOD (12)."""
    return output / f"{state}-{view}-{number}.png"


def film_demo(
    folder: DemoFolder, settings: DemoSettings, models: dict[str, Asset], tell: Tell
) -> None:
    """Write two videos: the object at rest; FILMED in the state that differs most."""
    stamp = _stamp(folder, settings.frames)
    videos = [folder.path / name for name in (CANONICAL_VIDEO, DEFORMED_VIDEO)]
    if folder.done("videos", stamp) and all(video.is_file() for video in videos):
        return
    states = _states(folder)
    canonical, deformed = states.select([filmed_state(folder.path / "eval")])
    methods = _methods(models, states)
    filmed = [one for one in methods if one.name in FILMED]
    stories = [(canonical, methods[-1:]), (deformed, filmed)]
    total = len(stories) * settings.frames
    with folder.timed("videos", stamp):
        for number, (video, (state, shown)) in enumerate(zip(videos, stories, strict=True)):
            cameras = _orbit(states, state, settings.frames)
            first = number * settings.frames
            frames = _frames(state, shown, cameras, lambda i, n=first: tell(n + i, total))
            write_video(video, frames, fps=_FPS)


def filmed_state(output: Path) -> str:
    """Deformed state in which the default closes most holes, by the summary in `output`."""
    means, _ = read_summary(output / SUMMARY_FILE)
    holes = {(one.state, one.method): one.scores.get("hole_rate") or 0.0 for one in means}
    states = dict.fromkeys(one.state for one in means if one.kind != "canonical")
    return max(states, key=lambda name: holes[name, BASELINE] - holes[name, AWARE])


def _methods(models: dict[str, Asset], states: SceneStates) -> list[AssetMethod]:
    """PAPR before and after fine-tuning with plain rays, both with aware ones, then Gaussians."""
    unseen = {name: never_seen(one.points, states.scene) for name, one in models.items()}
    drawn: list[tuple[str, RaysName]] = [
        (BASELINE, "plain"),
        (METHOD, "plain"),
        (BASELINE, "aware"),
        (METHOD, "aware"),
        (CARRIED, "aware"),
    ]
    return [
        AssetMethod(name=title, asset=models[run], rays=rays, unseen=unseen[run])
        for title, (run, rays) in zip(METHODS, drawn, strict=True)
    ]


def _states(folder: DemoFolder) -> SceneStates:
    return open_states(folder.path / "sample")


def _stamp(folder: DemoFolder, *settings: object) -> str:
    models = [folder.path / RUNS[name] / MODEL_FILE for name in (BASELINE, METHOD)]
    return stamp_of(*models, folder.path / RUNS[CARRIED] / GAUSSIANS_FILE, *settings)


def _keep(taken: Taken, shown: tuple[int, ...], output: Path) -> None:
    if taken.index not in shown:
        return
    names, window = METHODS, object_window(taken)
    strain = strain_maps(taken, [METHOD])[1:]
    pictures = [*renderings(taken, names), *depth_maps(taken, names), *strain]
    for number, pixels in enumerate(pictures):
        if pixels is not None:
            path = panel(output, taken.state, taken.index, number)
            write_atomically(path, png_bytes(pixels[window]))


def _orbit(states: SceneStates, state: State, count: int) -> list[Camera]:
    """Cameras like the state's own: a larger object gets a wider view, not a farther camera."""
    cameras = [shot.camera for shot in state.shots]
    return orbit_like(cameras, states.scene.center, count)


def _frames(
    state: State, methods: list[AssetMethod], cameras: list[Camera], told: Callable[[int], None]
) -> Iterator[Tensor]:
    poses = {one.name: one.pose(state) for one in methods}
    for index, camera in enumerate(cameras):
        pictures = [one.asset.render(poses[one.name], camera).rgb for one in methods]
        yield to_bytes(torch.cat(pictures, dim=1))
        told(index + 1)
