"""Commands that look at maps and antennas: `map antenna`, `show`, `compare`, `calibrate`."""

from pathlib import Path

import numpy as np
import pytest
from cli_tools import Cli, assert_refused, tree

from cellpilot.maps import Anchor, load_map, make_map, save_map

PNG = b"\x89PNG"
CENTRES_M = np.arange(4) * 100.0 - 150
VIEWS = {
    "sinr": "simulated.png",
    "probability": "simulated.probability.png",
    "serving": "simulated.serving.png",
    "spread": "simulated.spread.png",
    "uncertainty": "simulated.uncertainty.png",
    "count": "simulated.count.png",
    "cdf": "simulated.cdf.png",
}
CUT = "\n".join(f"{degree} {min(degree, 360 - degree) / 10:g}" for degree in range(360))
ANTENNA = f"NAME panel\nFREQUENCY 1845\nGAIN 15 dBi\nELECTRICAL_TILT 0\nHORIZONTAL 360\n{CUT}\nVERTICAL 360\n{CUT}\n"


@pytest.fixture
def desk(place: Path, cli: Cli) -> Path:
    """The working directory with a simulated map, one that is twice as spread and 3 dB better, and an antenna file."""
    assert cli("map", "simulate", "tiny.toml", "--out", "simulated.nc").code == 0
    sinr_db = load_map(place / "simulated.nc")["sinr_db"].values
    better = make_map(2 * sinr_db + 3, x_m=CENTRES_M, y_m=CENTRES_M, z_m=[30.0], source="test")
    save_map(better, place / "better.nc")
    (place / "panel.msi").write_text(ANTENNA)
    (place / "broken.msi").write_text(ANTENNA.replace("GAIN 15 dBi", "GAIN 15 dB"))
    (place / "text.nc").write_text("this is no map\n")
    return place


def pictures(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir() if path.suffix in (".png", ".pdf", ".svg")}


@pytest.mark.parametrize("what", VIEWS)
def test_show_draws_every_view_beside_the_map(desk: Path, cli: Cli, what: str) -> None:
    radio_map = load_map(desk / "simulated.nc")
    # A simulation has as many points in every cell and no uncertainty, and that is no picture.
    radio_map["count"].values[0, 0, 0], radio_map["sinr_std_db"].values[0, 0, 0] = 1, 1.0
    save_map(radio_map, desk / "simulated.nc")
    result = cli("map", "show", "simulated.nc", "--what", what)
    assert (result.code, result.out, result.err) == (0, f"picture: {VIEWS[what]}\n", "")
    assert pictures(desk) == {VIEWS[what]}
    assert (desk / VIEWS[what]).read_bytes().startswith(PNG)


def test_threshold_and_noise_reach_the_picture(desk: Path, cli: Cli) -> None:
    drawn = {}
    for name, flags in {
        "plain": [],
        "noisy": ["--noise-std-db", "6"],
        "strict": ["--threshold-db", "9"],
    }.items():
        assert cli("map", "show", "simulated.nc", "--what", "probability", *flags, "--out", f"{name}.png").code == 0
        drawn[name] = (desk / f"{name}.png").read_bytes()
    assert len(set(drawn.values())) == 3


def test_heights_that_have_no_picture_are_named(desk: Path, cli: Cli) -> None:
    sinr_db = np.arange(7 * 16.0).reshape(7, 4, 4)
    save_map(make_map(sinr_db, x_m=CENTRES_M, y_m=CENTRES_M, z_m=10.0 * np.arange(1, 8), source="test"), desk / "tall.nc")
    told = " (6 of 7 heights: 10, 20, 30, 50, 60, 70 m)\n"
    assert cli("map", "show", "tall.nc").out == f"picture: tall.png{told}"
    assert cli("map", "compare", "tall.nc", "tall.nc").out.endswith(f"picture: compare.png{told}")


def test_info_says_how_to_simulate_on_the_same_grid(desk: Path, cli: Cli) -> None:
    result = cli("map", "info", "better.nc")
    line = next(line for line in result.out.splitlines() if line.startswith("  area"))
    assert line.startswith("  area x -200 to 200 m, y -200 to 200 m: --map.")
    options = line.split(": ")[1].split()
    assert cli("map", "simulate", "tiny.toml", *options, "--out", "again.nc").code == 0
    again, better = load_map(desk / "again.nc"), load_map(desk / "better.nc")
    for axis in "xy":
        np.testing.assert_allclose(again[axis].values, better[axis].values)


def test_compare_prints_the_difference_and_draws_it(desk: Path, cli: Cli) -> None:
    a, b = (load_map(desk / f"{name}.nc")["sinr_db"].values.astype(float) for name in ("simulated", "better"))
    result = cli("map", "compare", "simulated.nc", "better.nc")
    assert (result.code, result.err) == (0, "")
    assert "better.nc less simulated.nc, cells known in both" in result.out
    row = next(line for line in result.out.splitlines() if line.startswith("│"))
    agreement = ((a < 3) == (b < 3)).mean()
    rms_db = np.sqrt(((b - a) ** 2).mean())
    expected = ["30", "16", f"{(b - a).mean():+.2f}", f"{rms_db:.2f}", "1.000", f"{agreement:.1%}"]
    assert [cell.strip() for cell in row.strip("│").split("│")] == expected
    assert result.out.endswith("picture: compare.png\n")
    assert (desk / "compare.png").read_bytes().startswith(PNG)
    apart = cli("map", "compare", "simulated.nc", "better.nc", "--threshold-db", "12", "--out", "other.pdf")
    assert f"{((a < 12) == (b < 12)).mean():.1%}" in apart.out
    assert (desk / "other.pdf").read_bytes().startswith(b"%PDF")


def test_calibrate_finds_offset_and_spread_and_writes_the_map(desk: Path, cli: Cli) -> None:
    simulated, better = (load_map(desk / f"{name}.nc") for name in ("simulated", "better"))
    result = cli("map", "calibrate", "simulated.nc", "--to", "better.nc", "--out", "deep/fitted.nc")
    assert (result.code, result.err) == (0, "")
    offset_db = float((better["sinr_db"] - simulated["sinr_db"]).mean())
    assert "16 measured cells within the simulated map" in result.out
    assert result.out.endswith(f"offset {offset_db:+.2f} dB (standard error 0.00 dB), spread x 2.000; map: deep/fitted.nc\n")
    before, after = (line.split("│")[1:-1] for line in result.out.splitlines() if line.startswith("│"))
    assert [cell.strip() for cell in before[:3]] == ["before", f"{-offset_db:+.2f}", "0.500"]
    assert [cell.strip() for cell in (after[0], *after[2:])] == ["after", "1.000", "0.00", "1.000"]
    fitted = load_map(desk / "deep" / "fitted.nc")
    np.testing.assert_allclose(fitted["sinr_db"].values, better["sinr_db"].values, atol=1e-4)


def test_antenna_prints_what_the_file_states_and_draws_both_cuts(desk: Path, cli: Cli) -> None:
    result = cli("map", "antenna", "panel.msi")
    assert (result.code, result.err) == (0, "")
    assert result.out == "panel.msi: panel, 1845 MHz, 15.00 dBi, downtilt 0 deg\npicture: panel.png\n"
    assert (desk / "panel.png").read_bytes().startswith(PNG)
    result = cli("map", "antenna", "panel.msi", "--electrical-tilt-deg", "6", "--out", "tilted.svg")
    assert result.out == "panel.msi: panel, 1845 MHz, 15.00 dBi, downtilt 6 deg\npicture: tilted.svg\n"
    assert (desk / "tilted.svg").read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (["show", "plain.nc", "--what", "serving"], ["sector serves"]),
        (["show", "plain.nc", "--what", "spread"], ["sinr_spread_db"]),
        (["show", "simulated.nc", "--what", "uncertainty"], ["every cell has an uncertainty of 0 dB"]),
        (["show", "simulated.nc", "--what", "beauty"], ["--what", "beauty", "serving"]),
        (["show", "simulated.nc", "--what", "cdf", "--threshold-db", "nan"], ["--threshold-db", "nan"]),
        (["show", "simulated.nc", "--noise-std-db", "2"], ["--noise-std-db", "--what probability"]),
        (["show", "simulated.nc", "--what", "probability", "--noise-std-db", "-2"], ["--noise-std-db", "-2"]),
        (["show", "gone.nc", "--what", "cdf"], ["gone.nc", "no such file"]),
        (["show", "simulated.nc", "--what", "count", "--out", "a.gif"], ["a.gif", ".png"]),
        (["compare"], ["RadioMap file"]),
        (["compare", "simulated.nc"], ["RadioMap file"]),
        (["compare", "simulated.nc", "gone.nc"], ["gone.nc", "no such file"]),
        (["compare", "text.nc", "simulated.nc"], ["text.nc", "NetCDF"]),
        (["compare", "simulated.nc", "larger.nc"], ["the grids differ", "simulated.nc", "larger.nc"]),
        (["compare", "simulated.nc", "better.nc", "--threshold-db", "inf"], ["--threshold-db", "inf"]),
        (["calibrate", "simulated.nc"], ["--to"]),
        (["calibrate", "simulated.nc", "--to", "gone.nc"], ["gone.nc", "no such file"]),
        (["calibrate", "text.nc", "--to", "better.nc"], ["text.nc", "NetCDF"]),
        (["calibrate", "simulated.nc", "--to", "far.nc"], ["0 measured cells", "at least 3"]),
        (["calibrate", "simulated.nc", "--to", "anchored.nc"], ["anchor"]),
        (["antenna"], ["antenna file"]),
        (["antenna", "gone.msi"], ["gone.msi"]),
        (["antenna", "broken.msi"], ["broken.msi", "GAIN", "15 dB"]),
        (["antenna", "text.nc"], ["text.nc", "HORIZONTAL"]),
        (["antenna", "panel.msi", "--electrical-tilt-deg", "100"], ["electrical tilt", "100"]),
        (["antenna", "panel.msi", "--mechanical-tilt-deg", "steep"], ["--mechanical-tilt-deg", "steep"]),
    ],
    ids=lambda value: " ".join(value),
)
def test_wrong_input_is_refused_and_leaves_nothing(desk: Path, cli: Cli, call: list[str], named: list[str]) -> None:
    sinr_db = load_map(desk / "simulated.nc")["sinr_db"].values
    far = make_map(sinr_db, x_m=CENTRES_M + 5000, y_m=CENTRES_M, z_m=[30.0], source="test")
    save_map(far, desk / "far.nc")
    anchored = make_map(sinr_db, x_m=CENTRES_M, y_m=CENTRES_M, z_m=[30.0], source="test", anchor=Anchor(47.0, 8.0))
    save_map(anchored, desk / "anchored.nc")
    before = tree(desk)
    assert_refused(cli("map", *call), *named)
    assert tree(desk) == before


@pytest.mark.parametrize(
    "call", [["compare", "simulated.nc", "better.nc"], ["antenna", "panel.msi"], ["show", "simulated.nc"], ["show", "gone.nc"]]
)
def test_a_picture_of_an_unknown_kind_is_not_written(desk: Path, cli: Cli, call: list[str]) -> None:
    before = tree(desk)
    result = cli("map", *call, "--out", "a.gif")
    # Before anything is read or printed.
    assert (result.code, result.out) == (2, "")
    assert result.err == "cellpilot: a.gif: expected a picture's name ending in .png, .pdf, .svg\n"
    assert tree(desk) == before


@pytest.mark.parametrize("name", [r"$\frac{$", "a$b$c", "東\x1b", "$x$"])
def test_names_are_drawn_as_they_are(place: Path, cli: Cli, name: str) -> None:
    (place / "a.msi").write_text(ANTENNA.replace("NAME panel", f"NAME {name}"), encoding="utf-8")
    (place / "plain.nc").rename(place / f"{name}.nc".replace("\x1b", ""))
    file = f"{name}.nc".replace("\x1b", "")
    for call in (("map", "antenna", "a.msi", "--out", "a.png"), ("map", "compare", file, file), ("map", "show", file)):
        result = cli(*call)
        assert result.code == 0, result.err
        assert result.err == ""
