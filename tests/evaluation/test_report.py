"""The page that carries everything, and the pictures in it."""

import base64
import math
import re
from html.parser import HTMLParser

import numpy as np
import pytest
import torch

from pcore.errors import InputError
from pcore.evaluation.figures import (
    color_pixels,
    data_uri,
    depth_pixels,
    depth_range,
    png_bytes,
    sheet,
    truth_pixels,
)
from pcore.evaluation.report import (
    Command,
    Figure,
    Headline,
    Report,
    Section,
    Table,
    comparison_table,
    headlines,
    render_report,
)
from pcore.evaluation.summary import Gain, StateMean

TRUTH = Figure(source=data_uri(b"abc", "image/png"), title="truth")


class Reader(HTMLParser):
    """Collects tags, addresses and text, and checks that tags are closed."""

    VOID = ("meta", "img", "link", "br", "hr")

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []
        self.addresses: list[str] = []
        self.images: list[str] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        if tag not in self.VOID:
            self.open.append(tag)
        values = {name: value or "" for name, value in attrs}
        self.addresses += [values[n] for n in ("src", "href", "poster") if n in values]
        if tag == "img":
            self.images.append(values["alt"])

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.text += data


def means(**figures: float | None) -> list[StateMean]:
    return [
        StateMean(
            method=method,
            state="twist60",
            kind="analytic",
            protocol="standard",
            views=3,
            scores={"foreground_psnr": psnr, "hole_rate": 0.1, "lpips_alex": None},
        )
        for method, psnr in figures.items()
    ]


def report(**changes: object) -> Report:
    names = {"twist60": "Twist"}
    content = {
        "title": "A title",
        "lead": "What it is.",
        "headlines": (Headline(value="50 %", label="recovered", detail="of 2 dB"),),
        "videos": (Figure(source=data_uri(b"film", "video/mp4"), title="Around"),),
        "table": comparison_table(
            means(PAPR=20.0, PCORE=22.0), protocol="standard", names=names, caption="A caption."
        ),
        "sections": (Section(title="Twist", caption="Turned.", rows=((TRUTH,),)),),
        "commands": (Command(purpose="Go on", text="pcore train A && pcore finetune B"),),
        "facts": (("Steps", "1,200"),),
    }
    return Report(**{**content, **changes})  # type: ignore[arg-type]


def test_the_page_is_whole_and_needs_nothing_else() -> None:
    page = render_report(report())
    reader = Reader()
    reader.feed(page)
    assert reader.open == []
    assert len(reader.addresses) == 2
    assert all(address.startswith("data:") for address in reader.addresses)
    assert not re.search(r"https?://|@import|url\(|<script|<link", page)
    assert reader.images == ["truth"]
    for text in ("A title", "50 %", "Turned.", "20.00", "22.00", "Go on", "1,200", "A caption."):
        assert text in reader.text
    assert "prefers-color-scheme: dark" in page


def test_texts_are_escaped() -> None:
    page = render_report(report(title="<script>alert(1)</script> & more", notes=("a < b",)))
    assert "<script" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; more" in page
    assert "a &lt; b" in page


@pytest.mark.parametrize(("pictures", "columns"), [(10, 5), (4, 2), (1, 1)])
def test_depth_maps_stand_under_their_pictures(pictures: int, columns: int) -> None:
    section = Section(title="Twist", caption="", rows=((TRUTH,) * pictures,))
    assert f"--columns: {columns}" in render_report(report(sections=(section,)))


def test_without_videos_there_is_no_heading_for_them() -> None:
    assert "Once around" in render_report(report())
    assert "Once around" not in render_report(report(videos=()))


def test_the_table_marks_the_better_figure_and_drops_empty_columns() -> None:
    table = comparison_table(
        means(PAPR=20.0, PCORE=22.0), protocol="standard", names={}, caption=""
    )
    assert table.columns == ("PSNR, object", "Holes")
    assert [line.state for line in table.lines] == ["twist60", ""]
    assert [[cell.better for cell in line.cells] for line in table.lines] == [
        [False, False],
        [True, False],  # equal holes have no winner
    ]
    assert 'class="better">22.00' in render_report(report(table=table))


def test_no_winner_by_digits_that_nobody_sees_or_against_nothing() -> None:
    for psnr in (20.001, None):
        table: Table = comparison_table(
            means(PAPR=20.0, PCORE=psnr), protocol="standard", names={}, caption=""
        )
        assert not any(cell.better for line in table.lines for cell in line.cells)


def test_a_protocol_without_figures() -> None:
    with pytest.raises(InputError, match="expected figures of the protocol 'papr', got none"):
        comparison_table(means(PAPR=20.0), protocol="papr", names={}, caption="")


def test_headlines_say_the_figures() -> None:
    gain = Gain(
        method="P-CORE",
        baseline="PAPR",
        protocol="standard",
        group="analytic",
        states=("twist", "bend"),
        lost=8.0,
        gain=3.0,
        recovered=0.375,
        baseline_holes=0.15,
        method_holes=0.03,
        holes_removed=0.8,
        canonical_loss=-0.3,
        canonical_loss_full=None,
    )
    recovered, holes, canonical = headlines(gain)
    assert recovered.value in ("37 %", "38 %")
    assert "8.00 dB" in recovered.detail
    assert "mean of 2 states" in recovered.detail
    assert (holes.value, canonical.value) == ("80 %", "−0.30 dB")  # noqa: RUF001
    assert "15.0 %" in holes.detail


def test_pictures_on_white() -> None:
    rgba = torch.tensor([[[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.5]]])
    assert truth_pixels(rgba).tolist() == [[[255, 255, 255], [255, 0, 0], [128, 128, 128]]]
    assert color_pixels(torch.tensor([[[2.0, -1.0, 0.5]]])).tolist() == [[[255, 0, 128]]]


def test_depth_maps_share_a_scale_and_leave_holes_white() -> None:
    alpha = torch.tensor([[1.0, 1.0, 0.0, 1.0]])
    depth = torch.tensor([[1.0, 3.0, math.nan, math.inf]])
    span = depth_range([(alpha, depth)])
    assert span is not None
    assert span[0] == pytest.approx(1.0, abs=0.05)
    assert span[1] == pytest.approx(3.0, abs=0.05)
    pixels = depth_pixels(alpha, depth, span).astype(int)
    assert pixels[0, 2].tolist() == pixels[0, 3].tolist() == [255, 255, 255]
    assert pixels[0, 0].sum() > pixels[0, 1].sum() + 100  # near is brighter


def test_an_empty_depth_map_is_white() -> None:
    nothing = torch.zeros(4, 4)
    assert depth_range([(nothing, nothing)]) is None
    assert (depth_pixels(nothing, nothing, None) == 255).all()


def test_a_sheet_holds_every_picture_in_its_place() -> None:
    red, blue = (np.full((20, 20, 3), c, dtype=np.uint8) for c in ((255, 0, 0), (0, 0, 255)))
    page = sheet(["one", "two"], [("row", [red, blue]), ("next", [None, red])], cell=60)
    height, width, _ = page.shape
    assert width > 120
    assert height > 120
    assert page[height // 3, width // 3].tolist() == [255, 0, 0]
    assert page[height // 3, width - 20].tolist() == [0, 0, 255]
    assert page[height - 20, width // 3].tolist() == [255, 255, 255]
    assert (page[:20] != 255).any()  # the titles


def test_rows_of_a_sheet_fit_its_columns() -> None:
    with pytest.raises(InputError, match="expected 2 pictures in every row, got 1"):
        sheet(["one", "two"], [("row", [np.zeros((4, 4, 3), dtype=np.uint8)])])


def test_addresses_carry_their_content() -> None:
    content = png_bytes(np.zeros((2, 2, 3), dtype=np.uint8))
    address = data_uri(content, "image/png")
    head, code = address.split(",")
    assert head == "data:image/png;base64"
    assert base64.b64decode(code) == content
    assert content.startswith(b"\x89PNG")
