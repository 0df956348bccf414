"""Pictures of maps and antennas: what is drawn where, and that every figure can be read without its caption."""

import io
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.contour import QuadContourSet
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.text import Annotation, Text
from report_runs import small_map
from scipy.stats import norm

from cellpilot.errors import InputError
from cellpilot.maps import RadioMap, make_map, simulate_map
from cellpilot.maps.reasons import blocked_cells
from cellpilot.radio import ColumnAntenna, PatternAntenna, hexagonal_deployment
from cellpilot.report.antenna import draw_antenna
from cellpilot.report.comparison import draw_comparison
from cellpilot.report.map_marks import round_length_m
from cellpilot.report.map_views import draw_map, heights_left_out
from cellpilot.report.serving import SECTOR_COLOURS

CELLS = ("sinr", "probability", "serving", "spread", "uncertainty", "count")
UNITS = {"sinr": "[dB]", "probability": "[1]", "spread": "[dB]", "uncertainty": "[dB]", "count": "[1]"}


@pytest.fixture(scope="module")
def simulated() -> RadioMap:
    """Two heights over two whole sites and parts of others; a block of cells of the lower height may not be entered."""
    radio_map = simulate_map(
        hexagonal_deployment(),
        x_range_m=(-300.0, 600.0),
        y_range_m=(-200.0, 250.0),
        heights_m=(30.0, 100.0),
        bin_m=50.0,
        points_per_side=2,
    )
    rng = np.random.default_rng(0)
    radio_map["sinr_std_db"].values = rng.uniform(0.5, 4.0, radio_map["sinr_db"].shape).astype(np.float32)
    radio_map["count"].values = rng.integers(1, 9, radio_map["sinr_db"].shape).astype(np.int32)
    radio_map["blocked_reason"].values[0, 3:5, 2:4] = 1
    return radio_map


def rendered(figure: Figure) -> Figure:
    figure.savefig(io.BytesIO(), format="png", dpi=30)
    return figure


def panels(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.get_label() != "<colorbar>"]


def bars(figure: Figure) -> list[Axes]:
    return [axes for axes in figure.axes if axes.get_label() == "<colorbar>"]


def mesh_of(axes: Axes) -> QuadMesh:
    (mesh,) = (each for each in axes.collections if isinstance(each, QuadMesh))
    return mesh


def shown(axes: Axes) -> np.ndarray:
    """Values of the coloured cells `[y, x]`, NaN where the paper is white."""
    return np.ma.filled(np.ma.asarray(mesh_of(axes).get_array(), dtype=float), np.nan)


def markers(axes: Axes) -> list[tuple[float, float]]:
    return [tuple(p) for line in axes.lines if line.get_marker() == "^" for p in np.transpose(line.get_data()).tolist()]


def legend_texts(figure: Figure) -> list[str]:
    return [text.get_text() for legend in figure.legends for text in legend.get_texts()]


@pytest.mark.parametrize("what", CELLS)
def test_every_panel_says_its_height_and_axes_and_every_bar_its_unit(simulated: RadioMap, what: str) -> None:
    figure = rendered(draw_map(simulated, what, 3.0, 1.0))
    low, high = panels(figure)
    assert re.match(r"30 m(:|$)", low.get_title())
    assert re.match(r"100 m(:|$)", high.get_title())
    assert (low.get_xlabel(), high.get_xlabel()) == ("x, east [m]",) * 2
    # The right panel shares the ticks of the left one.
    assert (low.get_ylabel(), high.get_ylabel()) == ("y, north [m]", "")
    assert not any(tick.label1.get_visible() for tick in high.yaxis.get_major_ticks())
    labels = [bar.get_ylabel() for bar in bars(figure)]
    assert [label.split()[-1] for label in labels] == ([UNITS[what]] if what in UNITS else [])
    assert low.get_aspect() == 1
    assert (low.get_xlim(), low.get_ylim()) == ((-300.0, 600.0), (-200.0, 250.0))


@pytest.mark.parametrize("what", [*CELLS, "cdf"])
def test_no_text_is_tiny(simulated: RadioMap, what: str) -> None:
    tiny = [
        text.get_text() for text in draw_map(simulated, what, 3.0).findobj(Text) if text.get_text() and text.get_fontsize() < 8
    ]
    assert not tiny


@pytest.mark.parametrize(
    ("what", "variable"), [("sinr", "sinr_db"), ("spread", "sinr_spread_db"), ("uncertainty", "sinr_std_db"), ("count", "count")]
)
def test_the_cells_show_their_values_where_they_lie(simulated: RadioMap, what: str, variable: str) -> None:
    figure = draw_map(simulated, what, 3.0)
    for iz, axes in enumerate(panels(figure)):
        np.testing.assert_allclose(shown(axes), simulated[variable].values[iz])
        corners_m = mesh_of(axes).get_coordinates()
        assert corners_m[0, 0].tolist() == [-300.0, -200.0]
        assert corners_m[-1, -1].tolist() == [600.0, 250.0]
    # One scale for all heights.
    assert len({mesh_of(axes).get_clim() for axes in panels(figure)}) == 1


def test_the_probability_counts_noise_and_uncertainty(simulated: RadioMap) -> None:
    for iz, axes in enumerate(panels(draw_map(simulated, "probability", 3.0, 2.0))):
        level = simulated.isel(z=iz)
        spread_db = np.hypot(2.0, level["sinr_std_db"].values)
        np.testing.assert_allclose(shown(axes), norm.cdf((3.0 - level["sinr_db"].values) / spread_db), atol=1e-5)
        assert mesh_of(axes).get_clim() == (0.0, 1.0)


def test_unknown_cells_are_white_and_named() -> None:
    radio_map = small_map(special=True)
    radio_map["sinr_std_db"].values[0, 0, 0] = 1.0
    figure = draw_map(radio_map, "uncertainty", 3.0)
    assert np.isnan(shown(panels(figure)[0])).sum() == 1
    assert legend_texts(figure) == ["site", "blocked: inside a building", "blocked: no ray arrives"]


@pytest.mark.parametrize("what", CELLS)
def test_sites_within_the_area_are_marked(simulated: RadioMap, what: str) -> None:
    figure = draw_map(simulated, what, 3.0)
    for axes in panels(figure):
        assert sorted(markers(axes)) == [(0.0, 0.0), (500.0, 0.0)]
    assert "site" in legend_texts(figure)


@pytest.mark.parametrize("what", ["sinr", "serving"])
def test_boresights_lead_from_the_sites_where_the_sectors_look(simulated: RadioMap, what: str) -> None:
    """30, 150 and 270 degrees counter-clockwise from east."""
    axes = panels(draw_map(simulated, what, 3.0))[0]
    from_centre = [line for line in axes.lines if line.get_marker() != "^" and tuple(line.get_xydata()[0]) == (0.0, 0.0)]
    ends_m = [np.diff(line.get_xydata(), axis=0)[0] for line in from_centre]
    angles_deg = sorted(np.degrees(np.arctan2(end[1], end[0])) % 360 for end in ends_m)
    assert angles_deg == pytest.approx([30.0, 150.0, 270.0])


@pytest.mark.parametrize("what", ["sinr", "probability", "uncertainty"])
def test_a_map_without_sectors_has_no_sites(what: str) -> None:
    radio_map = small_map(2, sectors=False)
    radio_map["sinr_std_db"].values[0, 0, 0] = 1.0
    figure = draw_map(radio_map, what, 3.0)
    assert not any(markers(axes) for axes in panels(figure))
    assert "site" not in legend_texts(figure)


def check_scale_and_north(axes: Axes) -> None:
    """A bar as long as it says, inside the panel, and an arrow from its N straight up."""
    (north,) = (text for text in axes.texts if isinstance(text, Annotation))
    assert north.get_text() == "N"
    assert north.xy[0] == north.get_position()[0]
    assert north.xy[1] > north.get_position()[1]
    # A black arrow on a dark map needs a light rim.
    assert north.arrow_patch.get_path_effects()
    (label,) = (text.get_text() for text in axes.texts if re.fullmatch(r"[\d.]+ k?m", text.get_text()))
    number, unit = label.split()
    length_m = float(number) * {"m": 1.0, "km": 1000.0}[unit]
    (bar,) = (
        line for line in axes.lines if np.ptp(line.get_ydata()) == 0 and np.ptp(line.get_xdata()) == pytest.approx(length_m)
    )
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    assert left < min(bar.get_xdata()) < max(bar.get_xdata()) < (left + right) / 2
    assert bottom < bar.get_ydata()[0] < (bottom + top) / 2


@pytest.mark.parametrize("what", CELLS)
def test_the_first_panel_has_scale_bar_and_north_arrow(simulated: RadioMap, what: str) -> None:
    first, *others = panels(draw_map(simulated, what, 3.0))
    check_scale_and_north(first)
    assert not any(isinstance(text, Annotation) for axes in others for text in axes.texts)


def test_large_maps_have_their_scale_in_kilometres() -> None:
    axes_m = {"x_m": 500.0 * np.arange(20), "y_m": 500.0 * np.arange(9), "z_m": [30.0]}
    figure = draw_map(make_map(np.arange(180.0).reshape(1, 9, 20), **axes_m, source="test"), "sinr", 3.0)  # type: ignore[arg-type]
    check_scale_and_north(panels(figure)[0])
    assert "2 km" in [text.get_text() for text in panels(figure)[0].texts]


POWERS = [10.0**k for k in range(-3, 8)]


@given(st.floats(1e-3, 1e8) | st.sampled_from([*POWERS, *np.nextafter(POWERS, 0.0).tolist()]))
def test_round_lengths_are_one_two_and_five(about_m: float) -> None:
    length_m = round_length_m(about_m)
    assert length_m <= about_m * (1 + 2e-9) < 2.5 * length_m * (1 + 4e-9)
    assert f"{length_m:e}"[:8] in ("1.000000", "2.000000", "5.000000")


def contours(axes: Axes) -> list[QuadContourSet]:
    return [each for each in axes.collections if isinstance(each, QuadContourSet) and not each.filled]


def outlined_m2(axes: Axes) -> float:
    """Area within the closed outlines."""
    (outline,) = contours(axes)
    rings = [path.vertices for whole in outline.get_paths() for path in whole._iter_connected_components()]
    crosses = [x[:-1] @ y[1:] - x[1:] @ y[:-1] for x, y in (ring.T for ring in rings)]
    return abs(sum(crosses)) / 2


def test_the_threshold_is_outlined_along_the_cells_and_marked_on_the_bar() -> None:
    sinr_db = np.full((1, 6, 7), 9.0)
    sinr_db[0, 1:4, 2:5] = -2.0
    sinr_db[0, 2, 3] = 9.0
    radio_map = make_map(sinr_db, x_m=20.0 * np.arange(7), y_m=20.0 * np.arange(6), z_m=[30.0], source="test")
    figure = draw_map(radio_map, "sinr", 3.0)
    (axes,) = panels(figure)
    assert outlined_m2(axes) == pytest.approx(8 * 400.0)
    assert axes.get_title() == "30 m: 19 % below"
    assert {tuple(line.get_ydata()) for line in bars(figure)[0].lines} == {(3.0, 3.0)}
    assert {"SINR below 3 dB", "threshold 3 dB"} <= set(legend_texts(figure))


def test_serving_sectors_are_coloured_numbered_and_counted(simulated: RadioMap) -> None:
    radio_map = simulated.copy(deep=True)
    radio_map["serving_sector"].values[0, 0, 0] = -1
    for iz, axes in enumerate(panels(draw_map(radio_map, "serving", 3.0))):
        serving = radio_map["serving_sector"].values[iz]
        expected = np.where(serving < 0, np.nan, serving % len(SECTOR_COLOURS))
        np.testing.assert_array_equal(shown(axes), expected)
        assert axes.get_title().endswith(f"m: {len(set(serving[serving >= 0].tolist()))} serving sectors")
        numbers = [text for text in axes.texts if text.get_text().isdigit()]
        assert len(numbers) >= 4
        for text in numbers:
            x_m, y_m = text.get_position()
            assert radio_map["serving_sector"].isel(z=iz).sel(x=x_m, y=y_m).item() == int(text.get_text())


@pytest.mark.parametrize(("longest", "written"), [("A/1234/9", True), ("A/1234/90", False)])
def test_short_names_of_sectors_take_the_place_of_numbers(simulated: RadioMap, longest: str, written: bool) -> None:
    names = [longest[:-2] + f"/{i}" if i < 10 else longest[:-3] + f"/{i}" for i in range(simulated.sizes["sector"])]
    names[0] = longest
    radio_map = simulated.assign_coords(sector_name=("sector", np.array(names)))
    figure = rendered(draw_map(radio_map, "serving", 3.0))
    labels = [text for axes in panels(figure) for text in axes.texts if text.get_bbox_patch() is not None]
    assert len(labels) >= 4
    for text in labels:
        assert (text.get_text() in names) == written
        assert text.get_text().isdigit() != written
    kind = "name of the serving sector" if written else "number of the serving sector, from 0"
    assert kind in legend_texts(figure)


def test_labels_of_sectors_keep_off_the_sites_and_each_other(simulated: RadioMap) -> None:
    """Measured on the drawn page; sector 0 serves around a site that lies in its very middle."""
    radio_map = simulated.assign_coords(sector_name=("sector", np.array([f"N/{i}" for i in range(21)])))
    radio_map["serving_sector"].values[:, :, :12] = 0
    figure = draw_map(radio_map, "serving", 3.0)
    figure.draw_without_rendering()
    for axes in panels(figure):
        boxes = [text.get_window_extent() for text in axes.texts if text.get_bbox_patch() is not None]
        sites_px = axes.transData.transform(markers(axes))
        radius_px = 4.0 * figure.dpi / 72
        for i, box in enumerate(boxes):
            near = box.padded(radius_px)
            assert not any(near.contains(*site) for site in sites_px)
            assert not any(box.overlaps(other) for other in boxes[:i])


def test_the_cdf_is_that_of_the_free_cells_of_each_height(simulated: RadioMap) -> None:
    figure = rendered(draw_map(simulated, "cdf", 4.5))
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("mean SINR of a free cell [dB]", "share of cells below [1]")
    curves = {line.get_label(): line for line in axes.lines if line.get_label().endswith(" m")}
    assert list(curves) == ["30 m", "100 m"]
    for iz, line in enumerate(curves.values()):
        level = simulated.isel(z=iz)
        free_db = level["sinr_db"].values[~blocked_cells(level)]
        x_db, share = line.get_data()
        assert len(x_db) == len(free_db)
        for level_db in (-3.0, 2.0, 8.0):
            below = share[x_db <= level_db]
            assert (below[-1] if below.size else 0.0) == pytest.approx((free_db <= level_db).mean())
    assert len({line.get_linestyle() for line in curves.values()}) == 2
    (threshold,) = (line for line in axes.lines if line not in curves.values())
    assert list(threshold.get_xdata()) == [4.5, 4.5]
    assert "4.5 dB" in [text.get_text() for text in axes.texts]


def bad_map() -> RadioMap:
    """20 cells at each of two heights, three of the lower ones free and unknown, one that is blocked below 3 dB."""
    sinr_db = np.full((2, 4, 5), 9.0)
    sinr_db[0, 0, :3] = np.nan
    sinr_db[0, 1, :] = 1.0
    blocked = np.zeros(sinr_db.shape, bool)
    blocked[0, 1, 0] = True
    axes_m = {"x_m": 20.0 * np.arange(5), "y_m": 20.0 * np.arange(4), "z_m": [30.0, 50.0]}
    return make_map(sinr_db, **axes_m, blocked_reason=blocked, source="test", unknown="bad")  # type: ignore[arg-type]


def test_free_cells_that_are_unknown_count_as_below() -> None:
    low, high = panels(draw_map(bad_map(), "sinr", 3.0))
    assert low.get_title() == "30 m: 37 % below\n(3 of 19 unknown)"
    assert high.get_title() == "50 m: 0 % below"
    (axes,) = draw_map(bad_map(), "cdf", 3.0).axes
    line = next(line for line in axes.lines if line.get_label() == "30 m, 3 of 19 cells unknown")
    values_db, share = line.get_data()
    assert share[values_db < 3.0][-1] == pytest.approx(7 / 19)
    assert share[-1] == 1.0


@pytest.mark.parametrize(
    ("what", "variable", "value", "message"),
    [
        ("count", "count", 64, "every known cell has 64 samples: nothing to draw"),
        ("count", "count", 0, "every known cell has 0 samples: nothing to draw"),
        ("uncertainty", "sinr_std_db", 0.0, "every known cell has an uncertainty of 0 dB: nothing to draw"),
        ("uncertainty", "sinr_std_db", 2.5, "every known cell has an uncertainty of 2.5 dB: nothing to draw"),
    ],
)
def test_what_is_the_same_everywhere_is_said_and_not_drawn(what: str, variable: str, value: float, message: str) -> None:
    radio_map = bad_map()
    radio_map[variable].values[:] = value
    with pytest.raises(InputError, match=message):
        draw_map(radio_map, what, 3.0)


def test_the_legend_names_cells_of_fewer_than_two_samples(simulated: RadioMap) -> None:
    radio_map = simulated.copy(deep=True)
    assert "fewer than two samples" not in legend_texts(draw_map(radio_map, "spread", 3.0))
    radio_map["sinr_spread_db"].values[1, 2, 3] = np.nan
    assert "fewer than two samples" in legend_texts(draw_map(radio_map, "spread", 3.0))


def stacked(n_heights: int) -> RadioMap:
    sinr_db = np.random.default_rng(1).normal(3.0, 4.0, (n_heights, 6, 12))
    axes_m = {"x_m": 50.0 * np.arange(12) - 275, "y_m": 50.0 * np.arange(6), "z_m": 20.0 + 10 * np.arange(n_heights)}
    return make_map(sinr_db, **axes_m, source="test")  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("n_heights", "drawn"), [(4, [20, 30, 40, 50]), (6, [20, 30, 40, 50, 60, 70]), (8, [20, 30, 50, 60, 80, 90])]
)
def test_a_comparison_shows_up_to_six_heights_and_tells_which(n_heights: int, drawn: list[int]) -> None:
    radio_map = stacked(n_heights)
    figure = draw_comparison(radio_map, radio_map, ("a", "b"), 3.0)
    assert [axes.get_title() for axes in panels(figure)[::3]] == [f"a, {z_m} m" for z_m in drawn]
    told = heights_left_out(radio_map)
    assert told == ("" if n_heights <= 6 else " (6 of 8 heights: 20, 30, 50, 60, 80, 90 m)")


@pytest.mark.parametrize("kind", ["comparison", "sinr"])
def test_nothing_is_blank_above_the_legend_and_no_labels_touch(kind: str) -> None:
    radio_map = stacked(4)
    figure = draw_map(radio_map, "sinr", 3.0) if kind == "sinr" else draw_comparison(radio_map, radio_map, ("a", "b"), 3.0)
    figure.draw_without_rendering()
    (legend,) = figure.legends
    lowest_px = min(axes.get_tightbbox().y0 for axes in panels(figure))
    assert lowest_px - legend.get_window_extent().y1 < 0.25 * figure.dpi
    bottom = [axes for axes in panels(figure) if axes.get_xlabel()]
    assert len(bottom) > 1
    labels = [label.get_window_extent() for axes in bottom for label in axes.get_xticklabels()]
    assert not any(box.padded(2).overlaps(other.padded(2)) for i, box in enumerate(labels) for other in labels[:i])


def test_a_comparison_names_cells_that_are_not_known() -> None:
    assert legend_texts(draw_comparison(bad_map(), bad_map(), ("a", "b"), 3.0))[1:] == ["not known"]


def test_what_a_map_does_not_have_is_refused() -> None:
    with pytest.raises(InputError, match="no sinr_spread_db: nothing to draw"):
        draw_map(small_map(), "spread", 3.0)
    with pytest.raises(InputError, match="does not say which sector serves"):
        draw_map(small_map(), "serving", 3.0)
    one_point = simulate_map(hexagonal_deployment(rings=0), points_per_side=1)
    with pytest.raises(InputError, match="no sinr_spread_db in any cell"):
        draw_map(one_point, "spread", 3.0)


def test_a_comparison_shows_both_maps_and_their_difference(simulated: RadioMap) -> None:
    other = simulated.copy(deep=True)
    other["sinr_db"].values = 0.5 * simulated["sinr_db"].values - 1.0
    figure = rendered(draw_comparison(simulated, other, ("before", "after"), 3.0))
    drawn = panels(figure)
    titles = [axes.get_title() for axes in drawn]
    assert titles == ["before, 30 m", "after, 30 m", "after less before", "before, 100 m", "after, 100 m", "after less before"]
    a_db, b_db = simulated["sinr_db"].values, other["sinr_db"].values
    for iz in range(2):
        for axes, values in zip(drawn[3 * iz : 3 * iz + 3], (a_db[iz], b_db[iz], b_db[iz] - a_db[iz]), strict=True):
            np.testing.assert_allclose(shown(axes), values, atol=1e-6)
    low_db, high_db = mesh_of(drawn[2]).get_clim()
    assert low_db == -high_db
    assert (
        mesh_of(drawn[0]).get_clim() == mesh_of(drawn[4]).get_clim() == pytest.approx((min(a_db.min(), b_db.min()), a_db.max()))
    )
    assert [bar.get_ylabel() for bar in bars(figure)] == ["mean SINR [dB]", "difference [dB]"]
    assert {tuple(line.get_ydata()) for line in bars(figure)[0].lines} == {(3.0, 3.0)}
    assert [axes.get_ylabel() for axes in drawn] == ["y, north [m]", "", ""] * 2
    assert [axes.get_xlabel() for axes in drawn] == [""] * 3 + ["x, east [m]"] * 3
    assert contours(drawn[0])
    assert not contours(drawn[2])
    assert legend_texts(figure) == ["threshold 3 dB"]
    check_scale_and_north(drawn[0])


def test_a_map_compared_with_itself_and_maps_without_a_common_cell_are_drawn() -> None:
    radio_map = small_map()
    half = small_map()
    half["sinr_db"].values[..., :4], half["blocked_reason"].values[..., :4] = np.nan, 1
    other_half = small_map()
    other_half["sinr_db"].values[..., 4:], other_half["blocked_reason"].values[..., 4:] = np.nan, 1
    for a, b in ((radio_map, radio_map), (half, other_half)):
        figure = rendered(draw_comparison(a, b, ("a", "b"), 3.0))
        assert not np.nan_to_num(shown(panels(figure)[2])).any()


def curve(axes: Axes) -> dict[float, float]:
    """Gain [dBi] by the angle of the drawing [deg]."""
    (line,) = (each for each in axes.lines if isinstance(each, Line2D))
    return dict(zip(np.degrees(line.get_xdata()).round(3).tolist(), line.get_ydata().tolist(), strict=True))


def test_both_cuts_of_an_antenna_go_through_its_peak() -> None:
    antenna = ColumnAntenna(10, 0.8, 7.0)
    figure = rendered(draw_antenna(antenna))
    above, beside = figure.axes
    assert figure._suptitle is not None
    assert figure._suptitle.get_text() == "ColumnAntenna: gain [dBi], peak 17.9 dBi"
    assert above.get_title().startswith("from above, 7° below the horizon")
    assert beside.get_title().startswith("from the side, 0° clockwise from boresight")
    horizontal, vertical = curve(above), curve(beside)
    for azimuth_deg in (-60.0, 0.0, 45.0, 180.0):
        assert horizontal[azimuth_deg] == pytest.approx(antenna.gain_dbi(azimuth_deg, 97.0).item())
    # Right of straight up is the front, left of it the back; what lies 40 dB below the peak is in the middle.
    least_dbi = max(vertical.values()) - 40.0
    for angle_deg, (azimuth_deg, zenith_deg) in {97.0: (0, 97), 90.0: (0, 90), -90.0: (180, 90), 30.0: (0, 30)}.items():
        assert vertical[angle_deg] == pytest.approx(max(antenna.gain_dbi(azimuth_deg, zenith_deg).item(), least_dbi))
    assert max(vertical, key=lambda angle_deg: vertical[angle_deg]) == 97.0
    assert min(vertical.values()) == pytest.approx(least_dbi)


def test_an_antenna_that_looks_aside_is_cut_where_it_looks() -> None:
    """A peak 30 degrees clockwise is drawn to the right, and the second cut goes through it."""
    degree = np.arange(360)
    off_deg = np.abs((degree - 30 + 180) % 360 - 180)
    below_deg = np.abs((degree - 4 + 180) % 360 - 180)
    antenna = PatternAntenna(15.0, off_deg / 6.0, below_deg / 3.0, name="lopsided")
    figure = draw_antenna(antenna)
    above, beside = figure.axes
    assert above.get_title().startswith("from above, 4° below the horizon")
    assert beside.get_title().startswith("from the side, 30° clockwise from boresight")
    assert figure._suptitle is not None
    assert figure._suptitle.get_text() == "lopsided: gain [dBi], peak 15.0 dBi"
    horizontal, vertical = curve(above), curve(beside)
    assert max(horizontal, key=lambda angle_deg: horizontal[angle_deg]) == -30.0
    # Angles grow counter-clockwise from the top of the page, which the labels count the other way.
    assert above.get_theta_offset() == pytest.approx(np.pi / 2)  # type: ignore[attr-defined]
    assert above.get_theta_direction() == 1  # type: ignore[attr-defined]
    assert [tick.label1.get_text() for tick in above.xaxis.get_major_ticks()][1] == "-45°"
    assert vertical[94.0] == pytest.approx(15.0)
    assert beside.get_theta_direction() == -1  # type: ignore[attr-defined]


def test_the_rings_of_an_antenna_are_labelled_with_its_gain() -> None:
    for axes in draw_antenna(ColumnAntenna(1, 0.5, 0.0)).axes:
        assert [text.get_text() for text in axes.texts] == ["-22", "-12", "-2", "5"]
        assert [text.get_position()[1] for text in axes.texts] == pytest.approx(axes.get_yticks(), abs=1e-9)
        # Above the lobes, not under them.
        assert all(text.get_zorder() > line.get_zorder() for text in axes.texts for line in axes.lines)
        assert axes.get_rmin() == pytest.approx(-32.0)  # type: ignore[attr-defined]
        assert not [text for text in axes.findobj(Text) if text.get_text() and text.get_fontsize() < 8]


@pytest.mark.parametrize("what", ["sinr", "probability", "cdf", "count"])
def test_a_map_that_knows_nothing_is_no_picture(what: str) -> None:
    nothing = make_map(np.full((1, 2, 3), np.nan), x_m=[0, 20, 40], y_m=[0, 20], z_m=[30], source="test", unknown="bad")
    with pytest.raises(InputError, match="knows the SINR of no cell"):
        draw_map(nothing, what, 3.0)
    with pytest.raises(InputError, match="knows the SINR of no cell"):
        draw_comparison(nothing, nothing, ("a", "b"), 3.0)
