"""How every figure looks: sizes, fonts, and one line style for each policy, told apart in grey as well as in colour."""

import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

from matplotlib import rc_context
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from cellpilot.text import visible

PAGE_WIDTH_IN = 6.3
COLUMN_WIDTH_IN = 4.1

SETTINGS: Mapping[str, Any] = {
    "axes.axisbelow": True,
    "axes.grid": False,
    "axes.labelsize": 9,
    "axes.titlesize": 9,
    "figure.facecolor": "white",
    "figure.titlesize": 10,
    "font.family": ["DejaVu Sans"],
    "font.size": 9,
    "grid.color": "0.88",
    "grid.linewidth": 0.6,
    "hatch.linewidth": 0.5,
    "legend.fontsize": 8,
    "legend.framealpha": 0.9,
    "lines.linewidth": 1.6,
    # Type 42 keeps the text of a PDF selectable.
    "pdf.fonttype": 42,
    # Names inside an SVG follow from what they name: the same figure is the same file.
    "svg.hashsalt": "cellpilot",
    "xtick.labelsize": 8,
    "ytick.labelsize": 8,
}
"""Settings that hold while a figure is drawn and saved; nothing on paper is smaller than 8 pt."""

SINR_COLOURS = "viridis"
CHANCE_COLOURS = "cividis_r"
"""Light is good, dark is bad, on paper too."""
BLUE, VERMILION, PURPLE, GREEN, ORANGE = "#0072B2", "#D55E00", "#9A4C86", "#009E73", "#E69F00"
GREY = "0.35"


@contextmanager
def drawing_settings() -> Iterator[None]:
    """The settings, for as long as the `with` block lasts; nothing outside it changes."""
    settings: Any = dict(SETTINGS)
    with rc_context(settings), boxes_for_missing_letters():
        yield


@contextmanager
def boxes_for_missing_letters() -> Iterator[None]:
    """Letters that the font lacks are drawn as boxes, without a warning for each."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing from font")
        yield


class Line(NamedTuple):
    """How one curve is named and drawn."""

    label: str
    colour: str
    style: Any
    hatch: str = ""


POLICY_LINES = {
    "greedy": Line("greedy baseline", GREY, ":", ""),
    "optimal": Line("exact optimum", BLUE, "--", "////"),
    "optimal-undiscounted": Line("optimum, discount 1", GREEN, (0, (1, 1)), "\\\\\\\\"),
    "learned/argmax": Line("learned, arg max", VERMILION, "-", "xxx"),
}
BOLTZMANN = "learned/boltzmann-"
BOLTZMANN_LINE = Line("learned, Boltzmann", PURPLE, (0, (5, 1.5, 1, 1.5)), "...")
OTHER_LINES = (Line("", GREEN, (0, (1, 1)), "++"), Line("", ORANGE, (0, (3, 1, 1, 1, 1, 1)), "ooo"))


def as_drawn(name: str) -> str:
    """A name as text of a figure: no formula, and nothing that is not seen."""
    return visible(name).replace("$", r"\$")


def policy_line(name: str, others: Sequence[str] = ()) -> Line:
    """Line of a policy; `others` are all names without a line of their own, in order, so that each gets another one."""
    if name in POLICY_LINES:
        return POLICY_LINES[name]
    if name.startswith(BOLTZMANN):
        return BOLTZMANN_LINE._replace(label=f"{BOLTZMANN_LINE.label} {name.removeprefix(BOLTZMANN)}")
    index = list(others).index(name) if name in others else 0
    return OTHER_LINES[index % len(OTHER_LINES)]._replace(label=name)


def single_axes(width_in: float = COLUMN_WIDTH_IN, height_in: float = 2.9) -> tuple[Figure, Axes]:
    """A figure of one panel with a light grid."""
    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    axes = figure.add_subplot()
    axes.grid(True)
    return figure, axes


def legend_below(figure: Figure, handles: Sequence[Any], columns: int = 2) -> None:
    """One legend for all panels, below them."""
    if handles:
        figure.legend(handles=list(handles), loc="outside lower center", ncols=min(columns, len(handles)), frameon=False)
