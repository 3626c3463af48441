"""What the demo's page says, put together from the files of the earlier stages."""

from __future__ import annotations

import platform
from pathlib import Path

import torch

from pcore.asset.asset_summary import summarize
from pcore.demo.demo_folder import DemoFolder
from pcore.demo.demo_settings import DemoSettings
from pcore.demo.demo_story import (
    AWARE,
    BASELINE,
    CANONICAL_VIDEO,
    CARRIED,
    DEFORMED_VIDEO,
    FILMED,
    METHOD,
    METHODS,
    RUNS,
    filmed_state,
    panel,
)
from pcore.demo.machine import clock, usable_cores
from pcore.evaluation.figures import data_uri
from pcore.evaluation.protocol import STANDARD
from pcore.evaluation.report import (
    Command,
    Figure,
    Headline,
    Report,
    Section,
    comparison_table,
    headlines,
)
from pcore.evaluation.runner import Value, mean
from pcore.evaluation.states import CANONICAL
from pcore.evaluation.summary import Gain, StateMean
from pcore.evaluation.tables import SUMMARY_FILE, read_summary, shown
from pcore.files.provenance import pcore_version

_NAMES = {
    "canonical": "Canonical",
    "twist60": "Twist, 60°",
    "bend60": "Bend, 60°",
    "stretch": "Stretch",
    "scale2x": "Scale, 2×",  # noqa: RUF001
}
_ABOUT = {
    "canonical": "The object as it was photographed.",
    "twist60": "Turned about its long axis, 60 degrees from end to end.",
    "bend60": "Bent into an arc of 60 degrees.",
    "stretch": "Drawn out along its long axis; the middle gets thinner, as clay does.",
    "scale2x": "Twice the size, seen with a wider field of view: points lie twice as far apart.",
}
_TITLES = (
    *("truth", *METHODS),
    *("depth, truth", *(f"depth, {name}" for name in METHODS)),
    f"strain, {METHOD}",
)
_COMMANDS = (
    Command(
        purpose="Train on your own scene (docs/guide/scenes.md); --model papr makes the paper's "
        "points, and pcore finetune makes these safe to deform under plain rays:",
        text="pcore train MY_SCENE -o my-run",
    ),
    Command(
        purpose="Deform it with an edit file (docs/guide/edit-files.md) and go once around it:",
        text='echo \'{"version": 2, "edits": [{"type": "twist", "axis": "z", '
        '"angle_deg": 60}]}\' > edit.json\n'
        "pcore render my-run --edit edit.json --orbit 60",
    ),
    Command(
        purpose="Measure it; a uniform scale has an exact truth on any scene:",
        text="pcore eval my-run --state scale:2 --pictures",
    ),
)


def build_report(folder: DemoFolder, settings: DemoSettings) -> Report:
    """Put the page together from `eval`, the videos and `demo.json`."""
    means, gain = _read(folder.path / "eval" / SUMMARY_FILE)
    caption = (
        f"Means over {settings.test_views} test views, protocol “{STANDARD.name}” "
        f"({STANDARD.description}); PSNR in dB. “Object” is over pixels of the object only. Holes: "
        "share of the object's pixels that are see-through or whose depth is off by more than 5 % "
        "of its size. Spill: wrongly covered background, relative to the object's pixels. Strain: "
        "growth of the distance to a neighbouring point, at 99 % of the points; in the pictures "
        "grey is calm, red stretched to twice, blue squeezed to half, violet meets itself. "
        "Unseen: share of the object's pixels that show what no training view saw."
    )
    return Report(
        title="Deformed, and still in one piece",
        lead=(
            f"An object learned from {settings.train_views} pictures, then twisted, bent, "
            f"stretched and scaled. {CARRIED} is what pcore train makes: 3D Gaussians whose shapes "
            f"the edit carries along. The paper's method beside it: {BASELINE} is its cloud of "
            f"neural points; {METHOD} the same after self-supervised fine-tuning, which has seen "
            f"no picture of any deformed state; {AWARE} draws that with rays that know of the "
            "deformation. The truth is ray-traced from the deformed mesh."
        ),
        headlines=(
            _carried(means),
            *headlines(gain[METHOD]),
            *headlines(gain[AWARE]),
            _cost(folder),
        ),
        videos=_videos(folder.path),
        table=comparison_table(means, protocol=STANDARD.name, names=_NAMES, caption=caption),
        sections=_sections(folder.path / "eval" / "panels", means, settings.shown),
        commands=_COMMANDS,
        facts=_facts(folder, settings),
    )


def summary_lines(folder: DemoFolder) -> list[str]:
    """Lines for the terminal at the end."""
    means, found = _read(folder.path / "eval" / SUMMARY_FILE)
    cost, carried = _cost(folder), _carried(means)
    return [
        f"{carried.value} {carried.label}. {carried.detail}",
        *(
            f"{gain.method} recovers {shown(gain.recovered, 0, percent=True)} of the "
            f"{shown(gain.lost)} dB that deformation costs {gain.baseline}, closes "
            f"{shown(gain.holes_removed, 0, percent=True)} of the additional holes, and pays "
            f"{shown(gain.canonical_loss)} dB on the undeformed object."
            for gain in found.values()
            if gain.method != CARRIED
        ),
        f"Time {cost.value}. {cost.detail}",
    ]


def _read(path: Path) -> tuple[list[StateMean], dict[str, Gain]]:
    """Means, and gains on the analytic states by method."""
    means, found = read_summary(path)
    wanted = [g for g in found if g.protocol == STANDARD.name and g.group == "analytic"]
    return means, {gain.method: gain for gain in wanted}


def _carried(means: list[StateMean]) -> Headline:
    """How good the default is, edited and at rest, beside the paper's method."""
    rest, edited = (
        {name: shown(_object_psnr(means, name, at_rest=at_rest)) for name in (CARRIED, AWARE)}
        for at_rest in (True, False)
    )
    return Headline(
        value=f"{edited[CARRIED]} dB",
        label=f"on the edited object by {CARRIED}",
        detail=(
            f"Mean PSNR of the object in its deformed states; {AWARE}: {edited[AWARE]} dB. At "
            f"rest {rest[CARRIED]} dB; {AWARE}: {rest[AWARE]} dB."
        ),
    )


def _object_psnr(means: list[StateMean], method: str, *, at_rest: bool) -> Value:
    return mean(
        [
            one.scores["foreground_psnr"]
            for one in means
            if (one.method, one.protocol) == (method, STANDARD.name)
            and (one.kind == "canonical") == at_rest
        ]
    )


def _cost(folder: DemoFolder) -> Headline:
    seconds = sum(folder.seconds.values())
    peak = folder.peak_memory
    memory = "" if peak is None else f" At most {peak / 1e9:.1f} GB of memory."
    return Headline(
        value=clock(seconds),
        label="minutes from nothing to this page",
        detail=f"{usable_cores()} CPU cores.{memory}",
    )


def _videos(path: Path) -> tuple[Figure, ...]:
    state = filmed_state(path / "eval")
    name = _NAMES.get(state, state)
    titles = {
        CANONICAL_VIDEO: f"Canonical, {METHODS[-1]}",
        DEFORMED_VIDEO: f"{name}: {', '.join(FILMED)} from left to right",
    }
    return tuple(
        Figure(
            source=data_uri((path / file).read_bytes(), "video/mp4"),
            title=title,
            alternative=f"Video once around the object. {title}",
        )
        for file, title in titles.items()
    )


def _sections(panels: Path, means: list[StateMean], views: tuple[int, ...]) -> tuple[Section, ...]:
    return tuple(
        Section(
            title=_NAMES.get(state, state),
            caption=" ".join([_ABOUT.get(state, ""), _outcome(state, means)]).strip(),
            rows=tuple(
                # At rest nothing is strained.
                tuple(
                    _figure(panel(panels, state, view, n), n, state)
                    for n in range(len(_TITLES) - (state == CANONICAL))
                )
                for view in views
                if panel(panels, state, view, 0).is_file()
            ),
        )
        for state in dict.fromkeys(one.state for one in means)
    )


def _figure(path: Path, number: int, state: str) -> Figure:
    title = _TITLES[number]
    return Figure(
        source=data_uri(path.read_bytes(), "image/png"),
        title=title,
        alternative=f"{_NAMES.get(state, state)}: {title}",
    )


def _outcome(state: str, means: list[StateMean]) -> str:
    scores = {
        one.method: one.scores
        for one in means
        if one.state == state and one.protocol == STANDARD.name
    }
    psnr = [f"{shown(scores[n]['foreground_psnr'])} dB with {n}" for n in METHODS]
    holes = [shown(scores[n]["hole_rate"], 1, percent=True) for n in METHODS]
    text = f"PSNR of the object {', '.join(psnr)}; holes {', '.join(holes)}."
    # A line does not break between a number and its unit.
    return text.replace(" dB", "\u00a0dB").replace(" %", "\u00a0%")


def _facts(folder: DemoFolder, settings: DemoSettings) -> tuple[tuple[str, str], ...]:
    model = summarize(folder.path / RUNS[METHOD]).model
    made = summarize(folder.path / RUNS[CARRIED]).gaussians
    points = 0 if model is None else model.points
    gaussians = 0 if made is None else made.count
    times = ", ".join(f"{name} {clock(spent)}" for name, spent in folder.seconds.items())
    return (
        (
            "Models",
            f"{gaussians:,} Gaussians; {points:,} points; {settings.resolution} x "
            f"{settings.resolution} pixels",
        ),
        (
            "Training",
            f"steps: {settings.gaussians.steps:,} Gaussians, {settings.pretrain.steps:,} PAPR, "
            f"{settings.finetune.steps:,} P-CORE",
        ),
        ("Minutes", times),
        ("Made by", f"pcore {pcore_version()}, torch {torch.__version__}, {platform.machine()}"),
        (
            "Files",
            f"{folder.path.name}: runs gaussians, papr, pcore; eval/images.csv, eval/summary.json",
        ),
    )
