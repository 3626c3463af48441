"""Lines of the table of bars: means over the right states, beside the right bars."""

from benchmarks.bars import LIT, mean_lines, state_lines

from pcore.evaluation.states import Kind
from pcore.evaluation.summary import StateMean


def one(state: str, kind: Kind, psnr: float, holes: float, method: str = LIT) -> StateMean:
    scores = {"foreground_psnr": psnr, "hole_rate": holes}
    return StateMean(
        method=method, state=state, kind=kind, protocol="standard", views=2, scores=scores
    )


MEANS = [
    one("canonical", "canonical", 36.0, 0.010),
    one("twist60", "analytic", 33.0, 0.012),
    one("bend60", "analytic", 32.0, 0.010),
    one("twist60", "analytic", 30.0, 0.012, "Gaussians affine"),
    one("sit", "skeletal", 27.0, 0.018),
]


def test_states_stand_beside_what_they_are_to_pass() -> None:
    lines = {line.split(" | ")[1]: line for line in state_lines("knight", MEANS)}
    assert lines["twist60"] == "| knight | twist60 | 30.00 | 33.00 | 31.61 | +0.2 | 0.5 |"
    assert lines["sit"].endswith("| 27.00 | 25.86 | +0.8 | 1.0 |")
    assert "nan" in lines["cheer"]  # Not scored.
    assert state_lines("lego", MEANS) == []


def test_means_leave_the_rest_state_and_other_methods_out() -> None:
    lines = mean_lines({"knight": MEANS, "lego": MEANS[:1]})
    assert lines == [
        "Mean of the analytic states: 32.50 (bar 32.0): knight 32.50",
        "Mean of the skeletal states: knight 27.00 (bar 28.4)",
    ]
