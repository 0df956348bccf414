"""The picture of an adaptation hides no arm."""

import numpy as np
import pytest
import xarray as xr

from cellpilot.report.adaptation import draw_adapt


@pytest.mark.parametrize("worst", [0.3, -0.2, -150.0])
def test_every_mean_and_interval_lies_on_the_paper(worst: float) -> None:
    scores = np.array([[[0.5, 0.9, 1.01]] * 2, [[worst, 0.2, 0.8], [worst - 0.01, 0.19, 0.79]]])
    figure = draw_adapt(xr.Dataset({"score": (("arm", "seed", "flights"), scores)}, {"arm": ["a", "b"], "flights": [0, 1, 100]}))
    axes = figure.axes[0]
    lowest, highest = axes.get_ylim()
    assert lowest < worst - 0.005 - 12.706 * 0.005  # Student's interval of two seeds
    assert highest > 1.01
    assert [line.get_label() for line in axes.lines[:2]] == ["a", "b"]
    np.testing.assert_allclose(axes.lines[1].get_ydata(), scores[1].mean(0))
    assert ("logarithmic" in axes.get_ylabel()) == (worst < 0)
    # Linear above the baseline, and below it ever denser, without a step or a bend at 0.
    to_paper = axes.transScale.transform
    heights = [to_paper((0.0, y))[1] for y in (-100.0, -10.0, -1e-6, 0.0, 1e-6, 0.5, 1.0)]
    assert np.all(np.diff(heights) > 0)
    assert heights[6] - heights[5] == pytest.approx(heights[5] - heights[3])
    assert heights[3] - heights[2] == pytest.approx(heights[4] - heights[3], rel=1e-3)
    assert heights[1] - heights[0] < 0.3 * (heights[6] - heights[3])
    back = axes.transScale.inverted().transform((0.0, heights[0]))[1]
    assert back == pytest.approx(-100.0)
