"""Damaged and hostile map files: believed only after they were checked."""

import csv
import gzip
import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps import LogOptions, load_map, make_map, read_log, read_sites, save_map, write_sites
from cellpilot.maps.account import account_of
from cellpilot.maps.files import has_checksum
from cellpilot.maps.formats.zarr import SUMS
from cellpilot.maps.geodesy import Anchor
from cellpilot.maps.limits import MAX_CELLS, check_size
from cellpilot.maps.schema import RadioMap
from cellpilot.maps.sources.sionna_file import read_sionna
from cellpilot.maps.text_table import for_spreadsheets, from_spreadsheets
from cellpilot.radio import hexagonal_deployment
from cellpilot.runs import map_digest
from cellpilot.storage import TEMPORARY
from cellpilot.storage.folders import ASIDE

ENDINGS = ("nc", "zarr", "tif", "csv")


@pytest.fixture
def plain_map() -> RadioMap:
    """6 x 5 x 2 cells with everything that all formats hold."""
    rng = np.random.default_rng(0)
    return make_map(
        rng.normal(5, 6, (2, 5, 6)).astype(np.float32),
        x_m=np.arange(6) * 20.0,
        y_m=np.arange(5) * 20.0,
        z_m=[30.0, 60.0],
        source="simulation",
        sinr_std_db=0.5,
        anchor=Anchor(3.0, 101.0, 0.0),
    )


def files_of(path: Path) -> list[Path]:
    """The file, or all files of a store."""
    return sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]


@pytest.mark.parametrize("ending", ENDINGS)
def test_no_flipped_bit_changes_a_map_without_a_word(plain_map: RadioMap, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"m.{ending}"
    save_map(plain_map, path)
    assert has_checksum(path)
    expected, rng, refused = map_digest(load_map(path)), np.random.default_rng(1), 0
    for _ in range(60):
        files = files_of(path)
        file = files[int(rng.integers(len(files)))]
        whole = file.read_bytes()
        changed = bytearray(whole)
        changed[int(rng.integers(len(whole)))] ^= 1 << int(rng.integers(8))
        file.write_bytes(changed)
        try:
            assert map_digest(load_map(path)) == expected, file
        except InputError as error:
            refused += "\n" not in str(error)
        file.write_bytes(whole)
    assert refused >= 50
    assert map_digest(load_map(path)) == expected


@pytest.mark.parametrize("ending", ENDINGS)
def test_a_map_without_a_checksum_is_read_and_that_is_known(plain_map: RadioMap, tmp_path: Path, ending: str) -> None:
    path = tmp_path / f"m.{ending}"
    save_map(plain_map, path)
    if ending == "zarr":
        (path / SUMS).unlink()
    elif ending == "csv":
        first, _, below = path.read_text().partition("\n")
        attributes = json.loads(first.removeprefix("# cellpilot map "))
        del attributes["sha256"]
        path.write_text(f"# cellpilot map {json.dumps(attributes)}\n{below}")
    else:
        path.write_bytes(path.read_bytes()[:-82])
    assert not has_checksum(path)
    assert map_digest(load_map(path)) == map_digest(load_map(path))


def test_a_csv_map_with_other_line_ends_is_the_same_file(plain_map: RadioMap, tmp_path: Path) -> None:
    save_map(plain_map, tmp_path / "m.csv")
    content = (tmp_path / "m.csv").read_bytes()
    (tmp_path / "crlf.csv").write_bytes(b"\xef\xbb\xbf" + content.replace(b"\n", b"\r\n"))
    assert map_digest(load_map(tmp_path / "crlf.csv")) == map_digest(load_map(tmp_path / "m.csv"))
    (tmp_path / "other.csv").write_bytes(content.replace(b"60.0,", b"61.0,"))
    with pytest.raises(InputError, match=r"other\.csv: checksum mismatch.*remove 'sha256' from line 1"):
        load_map(tmp_path / "other.csv")


def test_a_missing_chunk_of_a_zarr_map_is_noticed(plain_map: RadioMap, tmp_path: Path) -> None:
    save_map(plain_map, tmp_path / "m.zarr")
    (tmp_path / "m.zarr" / "sinr_db" / "0.0.0").unlink()
    with pytest.raises(InputError, match=r"checksum mismatch, sinr_db/0\.0\.0 is missing.*delete cellpilot\.sha256"):
        load_map(tmp_path / "m.zarr")


def test_the_checksums_of_a_zarr_map_are_those_of_sha256sum(plain_map: RadioMap, tmp_path: Path) -> None:
    save_map(plain_map, tmp_path / "m.zarr")
    checked = subprocess.run(["sha256sum", "--check", "--quiet", SUMS], cwd=tmp_path / "m.zarr", check=False)
    assert checked.returncode == 0


@pytest.mark.parametrize("codec", ["pickle", "msgpack2", "json2"])
def test_a_codec_that_is_not_on_the_list_runs_nothing(plain_map: RadioMap, tmp_path: Path, codec: str) -> None:
    save_map(plain_map, tmp_path / "m.zarr")
    (tmp_path / "m.zarr" / SUMS).unlink()
    for name in (".zmetadata", "sinr_db/.zarray"):
        file = tmp_path / "m.zarr" / name
        content = json.loads(file.read_text())
        array = content["metadata"]["sinr_db/.zarray"] if "metadata" in content else content
        array |= {"compressor": {"id": codec}, "dtype": "|O", "filters": [{"id": "vlen-utf8"}]}
        file.write_text(json.dumps(content))
    with pytest.raises(InputError, match=f"packed by '{codec}'; expected one of blosc"):
        load_map(tmp_path / "m.zarr")


def test_a_zarr_write_that_fails_leaves_the_old_map_and_nothing_else(
    plain_map: RadioMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    save_map(plain_map, tmp_path / "m.zarr")

    def full(path: Path, content: bytes) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(InputError, match=r"m\.zarr: cannot be written \(no space left on device\)"):
            save_map(plain_map, tmp_path / "m.zarr")
    assert [path.name for path in tmp_path.iterdir()] == ["m.zarr"]
    assert map_digest(load_map(tmp_path / "m.zarr")) == map_digest(plain_map)


def test_what_a_killed_zarr_write_left_goes_with_the_next(plain_map: RadioMap, tmp_path: Path) -> None:
    (tmp_path / f"{TEMPORARY}01234567-m.zarr" / "x").mkdir(parents=True)
    (tmp_path / f"{ASIDE}m.zarr").mkdir()
    save_map(plain_map, tmp_path / "m.zarr")
    save_map(plain_map, tmp_path / "m.zarr")
    assert [path.name for path in tmp_path.iterdir()] == ["m.zarr"]


def test_a_link_that_leads_to_itself_is_one_error(tmp_path: Path) -> None:
    for ending in ENDINGS:
        (tmp_path / f"m.{ending}").symlink_to(tmp_path / f"m.{ending}")
        with pytest.raises(InputError, match=rf"m\.{ending}"):
            load_map(tmp_path / f"m.{ending}")


@pytest.mark.parametrize(
    ("variable", "units"),
    [("x", "km"), ("z", "ft"), ("sinr_db", "mW"), ("sinr_db", "1"), ("rsrp_dbm", "W"), ("sector_x_m", "km"), ("sinr_db", "3")],
)
def test_other_units_are_refused_and_missing_ones_taken(tmp_path: Path, variable: str, units: object) -> None:
    sinr_db = np.zeros((1, 2, 2))
    dataset = make_map(
        sinr_db,
        x_m=[0, 1],
        y_m=[0, 1],
        z_m=[30],
        source="s",
        sectors={"sector_x_m": [0.0]},
        optional={"rsrp_dbm": np.zeros((1, 1, 2, 2))},
    )
    dataset[variable].attrs["units"] = units
    dataset.to_netcdf(tmp_path / "m.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=f"{variable} has the units {units!r}; expected"):
        load_map(tmp_path / "m.nc")
    del dataset[variable].attrs["units"]
    dataset.to_netcdf(tmp_path / "m.nc", engine="h5netcdf")
    assert load_map(tmp_path / "m.nc")[variable].attrs["units"]


@pytest.mark.parametrize(
    ("variable", "value"),
    [("sinr_db", 3e30), ("sinr_db", -9999), ("sector_load", 5.0), ("sector_load", -0.1), ("sector_carrier_hz", 0.0), ("x", 1e9)],
)
def test_values_that_no_network_has_are_refused(variable: str, value: float) -> None:
    sinr_db, x_m, sectors = np.zeros((1, 2, 2)), np.array([0.0, 1.0]), {"sector_load": [1.0], "sector_carrier_hz": [1e9]}
    if variable == "sinr_db":
        sinr_db[0, 0, 0] = value
    elif variable == "x":
        x_m = x_m * value
    else:
        sectors[variable] = [value]
    with pytest.raises(InputError, match=f"{variable} holds .*; expected"):
        make_map(sinr_db, x_m=x_m, y_m=[0, 1], z_m=[30], source="s", sectors=sectors)


WRONG_ATTRIBUTES = {
    "schema_version": [[1, 2], "x", None, float("nan")],
    "source": [3, ["a"], None],
    "unknown": [["blocked"], 1],
    "fill_radius_m": ["far", None, [1.0]],
    "calibration_offset_db": ["x", {"a": 1}],
    "import_account": [3, None],
    "seed": ["x", True],
    "note": [None, True, {"a": 1}, [], [1, "a"], [[1]], "\ud800", "a\0b", 10**30],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in WRONG_ATTRIBUTES.items() for value in values])
def test_a_wrong_attribute_is_named(plain_map: RadioMap, tmp_path: Path, name: str, value: object) -> None:
    save_map(plain_map, tmp_path / "m.csv")
    first, _, below = (tmp_path / "m.csv").read_text().partition("\n")
    attributes = json.loads(first.removeprefix("# cellpilot map "))
    del attributes["sha256"]
    (tmp_path / "m.csv").write_text(f"# cellpilot map {json.dumps(attributes | {name: value})}\n{below}")
    with pytest.raises(InputError, match=rf"m\.csv.*{name}") as error:
        load_map(tmp_path / "m.csv")
    assert "\n" not in str(error.value)
    for ending in ENDINGS:
        with pytest.raises(InputError, match=f"attribute {name}"):
            save_map(plain_map.assign_attrs({name: value}), tmp_path / f"o.{ending}")
        assert not (tmp_path / f"o.{ending}").exists()


@pytest.mark.parametrize("text", ["x", "[" * 100_000, "{}", '{"logs": 3}', '{"logs": [], "levels": [], "mask": 3}', "null"])
def test_an_account_that_is_none_is_one_error(plain_map: RadioMap, text: str) -> None:
    with pytest.raises(InputError, match="import_account is no account of an import"):
        account_of(plain_map.assign_attrs(import_account=text))


def test_the_size_of_a_map_is_asked_before_it_is_made() -> None:
    check_size((MAX_CELLS, 1, 1))
    with pytest.raises(InputError, match="10,000,001 cells; at most 10,000,000"):
        check_size((MAX_CELLS + 1,))
    with pytest.raises(InputError, match="cells"):
        check_size((2**62, 2**62))


PEAK = """
import sys
from pathlib import Path
from cellpilot.errors import InputError
from cellpilot.maps import load_map
try:
    load_map(sys.argv[1])
except InputError as error:
    print(error)
# Not getrusage: its peak is that of the process that was copied.
print(next(int(line.split()[1]) // 1024 for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line))
"""


def sparse_csv(folder: Path) -> Path:
    lines = [f"{i},{i},30,5" for i in range(20_000)]
    (folder / "m.csv").write_text("x_m,y_m,z_m,sinr_db\n" + "\n".join(lines))
    return folder / "m.csv"


def sparse_tif(folder: Path) -> Path:
    rasterio = pytest.importorskip("rasterio")
    profile = {"driver": "GTiff", "width": 60_000, "height": 60_000, "count": 1, "dtype": "float32", "SPARSE_OK": True}
    transform = rasterio.Affine(1e-4, 0, 7, 0, -1e-4, 50)
    with rasterio.open(folder / "m.tif", "w", crs="EPSG:4326", transform=transform, tiled=True, **profile) as file:
        file.update_tags(1, HEIGHT_M="30")
    return folder / "m.tif"


def sparse_nc(folder: Path) -> Path:
    import h5py

    with h5py.File(folder / "m.nc", "w") as file:
        for name, size in (("x", 40_000), ("y", 40_000), ("z", 1)):
            file[name] = np.arange(size, dtype=np.float64)
            file[name].make_scale(name)
        for name in ("sinr_db", "sinr_std_db"):
            data = file.create_dataset(name, (1, 40_000, 40_000), "f4", chunks=(1, 1000, 1000))
            for i, axis in enumerate("zyx"):
                data.dims[i].attach_scale(file[axis])
        file.attrs["schema_version"] = 1
    return folder / "m.nc"


def sparse_zarr(folder: Path) -> Path:
    import zarr

    group = zarr.open_group(folder / "m.zarr", mode="w", zarr_format=2)
    for name, shape, dims in (
        ("x", (40_000,), ["x"]),
        ("y", (40_000,), ["y"]),
        ("z", (1,), ["z"]),
        ("sinr_db", (1, 40_000, 40_000), ["z", "y", "x"]),
    ):
        array = group.create_array(name, shape=shape, dtype="f4", chunks=tuple(min(1000, n) for n in shape))
        array.attrs["_ARRAY_DIMENSIONS"] = dims
    group.attrs["schema_version"] = 1
    zarr.consolidate_metadata(folder / "m.zarr", zarr_format=2)
    return folder / "m.zarr"


@pytest.mark.parametrize("make", [sparse_csv, sparse_tif, sparse_nc, sparse_zarr])
def test_a_small_file_of_a_huge_map_takes_no_memory(tmp_path: Path, make: object) -> None:
    path = make(tmp_path)  # type: ignore[operator]
    ended = subprocess.run([sys.executable, "-c", PEAK, str(path)], capture_output=True, text=True, check=True)
    *said, peak_mb = ended.stdout.splitlines()
    assert len(said) == 1
    assert "cells; at most 10,000,000" in said[0]
    assert int(peak_mb) < 800


def test_an_archive_that_unpacks_to_much_is_refused(tmp_path: Path) -> None:
    bomb = tmp_path / "b.npz"
    with (
        zipfile.ZipFile(bomb, "w") as archive,
        archive.open("path_gain.npy", "w") as file,
    ):
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (1, 40_000, 40_000)})
        file.write(bytes(1000))
    with pytest.raises(InputError, match=r"b\.npz: array 'path_gain' unpacks to 12\.8 GB; at most 1 GB"):
        read_sionna([bomb])
    log = tmp_path / "log_30m.csv.gz"
    with gzip.open(log, "wb") as file:
        file.write(b"Latitude,Longitude,RS SNR\n")
        for _ in range(40):
            file.write(b"3.0,101.0,5\n" * 50_000)
    with pytest.raises(InputError, match=r"unpacks from .* MB to more than"):
        read_log(log, LogOptions(altitude_m=30.0))
    (tmp_path / "long.csv").write_text("Latitude,Longitude,RS SNR\n" + "1" * 2_000_000)
    with pytest.raises(InputError, match="a line of more than 1,000,000 characters"):
        read_log(tmp_path / "long.csv", LogOptions(altitude_m=30.0))


@pytest.mark.parametrize("kind", ["complex128", "bool", "<U3"])
def test_arrays_that_are_no_real_numbers_are_refused(tmp_path: Path, kind: str) -> None:
    centres_m = np.stack(np.meshgrid([0.0, 1.0], [0.0, 1.0]), -1)
    np.savez(
        tmp_path / "g.npz", path_gain=np.ones((1, 2, 2)).astype(kind), cell_centers=np.dstack([centres_m, np.full((2, 2), 30.0)])
    )
    with pytest.raises(InputError, match=r"array 'path_gain' is of type .*; expected real numbers"):
        read_sionna([tmp_path / "g.npz"])


NAMES = ["=cmd|' /C calc'!A0", "+1", "@SUM(1)", "-2", "\t=1", "'=quoted", "''+x", "plain", "it's", "'", "zürich"]


@pytest.mark.parametrize("name", NAMES)
def test_a_name_that_looks_like_a_formula_comes_back_as_it_was(name: str) -> None:
    assert from_spreadsheets(for_spreadsheets(name)) == name
    assert for_spreadsheets(name)[0] not in "=+-@\t\r"


def test_no_cell_of_a_site_list_is_a_formula(tmp_path: Path) -> None:
    deployment = hexagonal_deployment()
    names = [f"=cmd{site}/+{sector}" for sector, site in enumerate(deployment.site)]
    write_sites(deployment, tmp_path / "s.csv", names, Anchor(-3.0, -101.0, 0.0), note="@SUM(1)")
    with (tmp_path / "s.csv").open(encoding="utf-8", newline="") as file:
        cells = [cell for row in csv.reader(file) for cell in row]
    formulas = [cell for cell in cells if (cell[:1] in "=+@\t\r" and cell) or (cell.startswith("-") and not cell[1:2].isdigit())]
    assert formulas == []
    assert any(cell.startswith("-3.0") for cell in cells)
    assert list(read_sites(tmp_path / "s.csv").names) == names


def test_a_height_in_a_file_name_has_the_limits_of_any_height(tmp_path: Path) -> None:
    log = tmp_path / "99999999m.csv"
    log.write_text("Time,Latitude,Longitude,RS SNR\n1,3.0,101.0,5\n2,3.0,101.0,6\n")
    with pytest.raises(InputError, match="the file name gives a height of 99999999 m; expected at most 10,000 m"):
        read_log(log)


def test_a_mask_beside_a_raster_that_is_no_tiff_is_refused(plain_map: RadioMap, tmp_path: Path) -> None:
    save_map(plain_map, tmp_path / "m.tif")
    (tmp_path / "m.tif.msk").write_text("<VRTDataset></VRTDataset>")
    with pytest.raises(InputError, match=r"m\.tif\.msk: no TIFF"):
        load_map(tmp_path / "m.tif")


def test_512_zeroed_bytes_end_in_one_line(plain_map: RadioMap, tmp_path: Path) -> None:
    save_map(plain_map, tmp_path / "m.nc")
    whole = (tmp_path / "m.nc").read_bytes()
    for start in range(0, len(whole) - 600, 256):
        if not any(whole[start : start + 512]):
            continue
        (tmp_path / "m.nc").write_bytes(whole[:start] + bytes(512) + whole[start + 512 :])
        with pytest.raises(InputError, match="checksum mismatch"):
            load_map(tmp_path / "m.nc")
