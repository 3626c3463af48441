"""Evaluation results in the terminal."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.text import Text

from pcore.cli.layout import Sheet, print_lines, room, sheet_lines
from pcore.evaluation.protocol import PROTOCOLS, Perceptual
from pcore.evaluation.summary import Gain, StateMean
from pcore.evaluation.tables import shown

# Metric, title, digits, shown as percent. Foreground SSIM and the rest stand in the files.
_COLUMNS = (
    ("foreground_psnr", "fg\nPSNR", 2, False),
    ("psnr", "\nPSNR", 2, False),
    ("ssim", "\nSSIM", 3, False),
    ("lpips_alex", "LPIPS\nalex", 3, False),
    ("lpips_squeeze", "LPIPS\nsqueeze", 3, False),
    ("lpips_vgg", "LPIPS\nvgg", 3, False),
    ("hole_rate", "\nholes", 1, True),
    ("see_through_rate", "see-\nthrough", 1, True),
    ("depth_error_relative", "depth\nerror", 2, True),
    ("spill_to_object", "\nspill", 1, True),
)

_HEALTH = (
    ("strain_median", "strain\nmedian", 2, False),
    ("strain_99", "strain\n99 %", 2, False),
    ("strain_max", "strain\nmost", 2, False),
    ("self_intersection", "self-\nintersection", 1, True),
    ("unseen", "\nunseen", 1, True),
)

_HOLES = (
    ("hole_score", "hole\nscore", 1, True),
    ("hole_score_plain", "the same,\nplain rays", 1, True),
    ("anchors_disagree", "anchors\ndisagree", 1, True),
    ("without_handle", "no handle\nnear", 1, True),
)


def bar(console: Console) -> Progress:
    """A bar with how many are done and how long the rest takes; nothing without a terminal."""
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        disable=not console.is_terminal,
    )


@contextmanager
def counting(console: Console, title: str) -> Generator[Callable[[int, int], None]]:
    """Give a function (done, total) that moves a bar; one line at the end without a terminal."""
    progress = bar(console)
    task = progress.add_task(title, total=None)
    last = [0]

    def tell(done: int, total: int) -> None:
        last[0] = done
        progress.update(task, completed=done, total=total)

    with progress:
        yield tell
    if not console.is_terminal and last[0]:
        console.print(Text(f"{title}: {last[0]}"), soft_wrap=True)


def show_results(
    console: Console,
    means: Sequence[StateMean],
    gains: Sequence[Gain],
    *,
    perceptual: Perceptual | None,
    notes: Sequence[str] = (),
) -> None:
    """Print tables of every protocol and of the points, the gains, and why columns are missing."""
    for protocol in dict.fromkeys(one.protocol for one in means):
        chosen = [one for one in means if one.protocol == protocol]
        # A state that an edit file makes has true images only where it is scored against another.
        scored = [one for one in chosen if one.scores.get("psnr") is not None]
        sheet = _sheet(f"protocol {protocol}", scored, _COLUMNS)
        print_lines(console, sheet_lines(sheet, room(console)))
        console.print(Text(_caption(protocol, chosen), "dim"), soft_wrap=True)
        for gain in gains:
            if gain.protocol == protocol:
                console.print(Text(gain_text(gain)), soft_wrap=True)
        console.print()
    _show_health(console, means)
    for line in [*notes, *missing_lpips(perceptual)]:
        console.print(Text(f"note: {line}"), soft_wrap=True)


def missing_lpips(perceptual: Perceptual | None) -> list[str]:
    """Say why columns of LPIPS are empty; nothing where none is."""
    missing = ", ".join(perceptual.missing) if perceptual is not None else ""
    why = f"no LPIPS with {missing}: no weights; `pcore doctor --weights` says what goes where"
    return [why] if missing else []


def gain_text(gain: Gain) -> str:
    """One sentence per figure of a comparison, for people."""
    parts = [
        f"{gain.method} against {gain.baseline}, mean of the {gain.group} states "
        f"({', '.join(gain.states)}):",
        f"  foreground PSNR {_signed(gain.gain)} dB; {gain.baseline} loses "
        f"{shown(gain.lost)} dB there, recovered {shown(gain.recovered, 0, percent=True)}",
        f"  additional holes {shown(gain.baseline_holes, 1, percent=True)} -> "
        f"{shown(gain.method_holes, 1, percent=True)}, removed "
        f"{shown(gain.holes_removed, 0, percent=True)}",
        f"  canonical loss {shown(gain.canonical_loss)} dB foreground, "
        f"{shown(gain.canonical_loss_full)} dB whole image",
    ]
    return "\n".join(parts)


def _show_health(console: Console, means: Sequence[StateMean]) -> None:
    """The points themselves, which are the same under every protocol."""
    chosen = [one for one in means if one.protocol == means[0].protocol]
    if any(one.scores.get("strain_99") is not None for one in chosen):
        for title, known in (("points", _HEALTH), ("points, holes and handles", _HOLES)):
            sheet = _sheet(title, chosen, known)
            if sheet.columns:
                print_lines(console, sheet_lines(sheet, room(console)))
        said = "unseen: share of the object's pixels that show what no training view saw"
        console.print(Text(said, "dim"), soft_wrap=True)
        console.print()


def _sheet(
    title: str, means: Sequence[StateMean], known: Sequence[tuple[str, str, int, bool]]
) -> Sheet:
    columns = [c for c in known if any(one.scores.get(c[0]) is not None for one in means)]
    rows = tuple(
        (
            (one.state, one.method),
            tuple(shown(one.scores.get(key), n, percent=p) for key, _, n, p in columns),
        )
        for one in means
    )
    headings = tuple(heading for _, heading, _, _ in columns)
    return Sheet(title=title, keys=("state", "method"), columns=headings, rows=rows)


def _caption(protocol: str, means: Sequence[StateMean]) -> str:
    views = sorted({one.views for one in means})
    known = PROTOCOLS.get(protocol)
    count = " or ".join(map(str, views))
    return f"{known.description if known else protocol}; means over {count} test views"


def _signed(value: float | None) -> str:
    text = shown(value)
    return f"+{text}" if value is not None and value > 0 else text
