"""All figures of a report in one table, and how one is drawn and saved. Another figure is one function and one line."""

import base64
import io
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import xarray as xr
from matplotlib.figure import Figure

from cellpilot.errors import InputError
from cellpilot.report.adaptation import draw_adapt
from cellpilot.report.distributions import draw_altitude, draw_path_ratio_cdf, draw_return_cdf, draw_sinr_cdf
from cellpilot.report.learning import draw_ablation, draw_sensitivity, draw_training
from cellpilot.report.maps import draw_deployment, draw_low_probability, draw_sinr
from cellpilot.report.policies import draw_high_goal, draw_low_goal
from cellpilot.report.style import boxes_for_missing_letters, drawing_settings
from cellpilot.runs.content import Content
from cellpilot.storage import write_atomically

DPI = 150
PAD_IN = 0.05
PNG_SIZE_AT = (16, 20)
"""Bytes at which a PNG file keeps its width and height."""


class Entry(NamedTuple):
    """A figure of the report: what draws it (None where the run has nothing to show), its caption, the thesis's number."""

    draw: Callable[[Content], Figure | None]
    caption: str
    thesis_figure: str


FIGURES: dict[str, Entry] = {
    "deployment": Entry(
        draw_deployment,
        "Sites, the boresights of their sectors, and the area in which the drone flies.",
        "4.1",
    ),
    "sinr_map": Entry(
        draw_sinr,
        "Mean SINR of every cell at each height. Hatched and outlined: below the threshold, which a black line marks on the "
        "colour bar.",
        "4.2 and 4.3",
    ),
    "low_probability": Entry(
        draw_low_probability,
        "Chance that one measurement in a cell falls below the threshold. Noise makes it a matter of degree.",
        "4.5 and 4.6",
    ),
    "cdf_sinr": Entry(
        draw_sinr_cdf,
        "Distribution of the SINR measured in all steps of the sampled flights. Where a curve crosses "
        "the threshold (dashed) it shows the share of steps below it. Lower is better.",
        "5.1, 5.8 and 5.15",
    ),
    "cdf_path_ratio": Entry(
        draw_path_ratio_cdf,
        "Distribution of the steps flown over the steps of the shortest allowed path. A flight that fails counts as infinitely "
        "long, so a curve levels off at the share of flights that reach the goal. The axis may end before the longest flights.",
        "5.2, 5.9 and 5.16",
    ),
    "cdf_return": Entry(
        draw_return_cdf,
        "Distribution of the undiscounted return of the sampled flights. Further right is better. A curve that starts above 0 at "
        "the left has so many flights with a return below the axis.",
        "5.3, 5.10 and 5.17",
    ),
    "policy_low_goal": Entry(
        draw_low_goal,
        "Action and value of every cell towards a goal (green star) amid low SINR. Shaded: where SINR is likely below the "
        "threshold; the outline on the right marks the same area.",
        "5.4 and 5.5",
    ),
    "policy_high_goal": Entry(
        draw_high_goal,
        "Action and value of every cell towards a goal (green star) amid high SINR, drawn as the figure before.",
        "5.6 and 5.7",
    ),
    "altitude": Entry(
        draw_altitude,
        "Share of steps flown at each height.",
        "5.18",
    ),
    "training": Entry(
        draw_training,
        "Training of this run: return of the training flights, share that reached the goal, and how strongly the agent explored. "
        "A round stands for the mean of the flights that ended in it, or in the last round in which one did.",
        "",
    ),
    "ablation": Entry(
        lambda run: None if run.ablation is None else draw_ablation(run.ablation),
        "What double learning (DDQN) and hindsight (HER) contribute: return during training, averaged over a moving "
        "window and then over seeds; the band is one standard deviation.",
        "5.19",
    ),
    "sensitivity": Entry(
        lambda run: None if run.sensitivity is None else draw_sensitivity(run.sensitivity),
        "How the weights of the reward change the routes: steps below the threshold, detour, and share of goals reached.",
        "",
    ),
}


class Picture(NamedTuple):
    """A drawn figure, ready for the page."""

    png_base64: str
    width_in: float
    height_in: float


def draw_figures(run: Content, folder: Path) -> dict[str, Picture]:
    """Draw every figure the run has, save each as PNG and PDF in `folder`, and return the pictures by stem.

    Files of figures that the run no longer has are removed: an old picture beside a new report misleads.
    """
    pictures = {}
    for stem, entry in FIGURES.items():
        with drawing_settings():
            figure = entry.draw(run)
            if figure is None:
                for suffix in (".png", ".pdf"):
                    (folder / f"{stem}{suffix}").unlink(missing_ok=True)
                continue
            pictures[stem] = _save(figure, folder, stem)
    return pictures


STUDIES: dict[str, Callable[[xr.Dataset], Figure]] = {
    "ablation": draw_ablation,
    "adapt": draw_adapt,
    "sensitivity": draw_sensitivity,
}
"""Figures that need nothing of a run but one dataset, `STEM.nc`."""


def draw_study(folder: Path, stem: str) -> Path:
    """Draw one study of a folder as `figures/STEM.png` and `.pdf`; returns the path of the PNG."""
    with xr.open_dataset(folder / f"{stem}.nc", engine="h5netcdf") as data, drawing_settings():
        _save(STUDIES[stem](data.load()), folder / "figures", stem)
    return folder / "figures" / f"{stem}.png"


FIGURE_FORMATS: dict[str, tuple[int, dict[str, None]]] = {
    ".png": (DPI, {"Software": None}),
    ".pdf": (2 * DPI, {"CreationDate": None}),
    ".svg": (DPI, {"Date": None}),
}
"""Suffix of a picture -> resolution [dots per inch] and metadata: without a date, the same run gives the same file."""


def check_picture_name(path: Path) -> None:
    """`InputError` for a name that `save_figure` will refuse: to be called before the work that the picture shows."""
    if path.suffix not in FIGURE_FORMATS:
        raise InputError(f"{path}: expected a picture's name ending in {', '.join(FIGURE_FORMATS)}")


def save_figure(figure: Figure, path: Path) -> bytes:
    """Save a figure atomically in the format of its suffix (png, pdf or svg) and return the bytes; else `InputError`."""
    check_picture_name(path)
    dpi, metadata = FIGURE_FORMATS[path.suffix]
    picture = io.BytesIO()
    with boxes_for_missing_letters():
        figure.savefig(picture, format=path.suffix[1:], dpi=dpi, bbox_inches="tight", pad_inches=PAD_IN, metadata=metadata)
    write_atomically(path, picture.getvalue())
    return picture.getvalue()


def _save(figure: Figure, folder: Path, stem: str) -> Picture:
    png = save_figure(figure, folder / f"{stem}.png")
    save_figure(figure, folder / f"{stem}.pdf")
    width_px, height_px = (int.from_bytes(png[i : i + 4]) for i in PNG_SIZE_AT)
    return Picture(base64.b64encode(png).decode("ascii"), width_px / DPI, height_px / DPI)
