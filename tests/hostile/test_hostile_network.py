"""No command opens a connection, whatever a map file says; importing the package opens none either."""

import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path

import pytest
from originals import make_originals

WATCHED = """
import os, sys
def refuse(event, arguments):
    if event in ("socket.connect", "socket.bind", "socket.getaddrinfo", "socket.gethostbyname", "socket.sendto"):
        os.write(2, f"NETWORK {event} {arguments}\\n".encode())
        os._exit(99)
sys.addaudithook(refuse)
"""
"""Ends the process at the first event of the interpreter that reaches out; libraries below Python are watched by a listener."""

IMPORT_ALL = """
import importlib, pkgutil
import cellpilot
for module in pkgutil.walk_packages(cellpilot.__path__, "cellpilot."):
    if not module.name.endswith("raytrace_worker"):
        importlib.import_module(module.name)
"""

CALL_ALL = """
from cellpilot.cli.main import main
for line in sys.argv[1].splitlines():
    try:
        main(line.split())
    except SystemExit:
        pass
"""


def watched(program: str, place: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a program in a process that ends when it reaches out."""
    command = [sys.executable, "-c", WATCHED + program, *arguments]
    return subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=300, check=False)


@contextmanager
def listener() -> Iterator[tuple[int, list[str]]]:
    """A server on loopback: its port, and the requests that came."""
    asked: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            asked.append(self.path)
            self.send_error(404)

        do_HEAD = do_POST = do_GET

        def log_message(self, format: str, *arguments: object) -> None:
            """Nothing on standard error."""

    with HTTPServer(("127.0.0.1", 0), Handler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield server.server_port, asked
        finally:
            server.shutdown()


def test_the_watch_sees_a_connection(tmp_path: Path) -> None:
    with listener() as (port, asked):
        program = "import urllib.request; urllib.request.urlopen('http://127.0.0.1:' + sys.argv[1])"
        assert watched(program, tmp_path, str(port)).returncode == 99
        assert asked == []


def test_importing_opens_no_connection(tmp_path: Path) -> None:
    ended = watched(IMPORT_ALL, tmp_path)
    assert ended.returncode == 0, ended.stderr


@pytest.mark.slow
def test_no_command_on_sound_files_opens_a_connection(tmp_path: Path) -> None:
    make_originals(tmp_path)
    calls = [
        *(f"map {verb} m.{ending}" for verb in ("info", "show") for ending in ("nc", "zarr", "tif", "csv")),
        *(f"map convert m.{ending} out.nc" for ending in ("zarr", "tif", "csv")),
        "map compare m.nc m.tif",
        "map import log_30m.csv --altitude 30 --bin-m 50 --out log.nc",
        "map simulate quick --map.points-per-side 3 --out sim.nc",
        "map sites quick --out again.csv",
        "map antenna antenna.msi --out antenna.png",
        "plan m.nc --start 0,0,0 --goal 3,3,1",
        "evaluate run",
        "report run",
        "export run --onnx out.onnx",
        "train --resume run",
        "doctor",
    ]
    ended = watched(CALL_ALL, tmp_path, "\n".join(calls))
    assert ended.returncode == 0, ended.stderr[-500:]
    assert "cellpilot: " not in ended.stderr


DESCRIPTIONS = {
    "VRT": """<VRTDataset rasterXSize="4" rasterYSize="4"><SRS>EPSG:4326</SRS><GeoTransform>101,0.001,0,3,0,-0.001</GeoTransform>
<VRTRasterBand dataType="Float32" band="1"><SimpleSource><SourceFilename relativeToVRT="0">/vsicurl/http://127.0.0.1:{port}/x.tif
</SourceFilename><SourceBand>1</SourceBand></SimpleSource></VRTRasterBand></VRTDataset>""",
    "WMS": """<GDAL_WMS><Service name="TMS"><ServerUrl>http://127.0.0.1:{port}/${{z}}/${{x}}/${{y}}.png</ServerUrl></Service>
<DataWindow><UpperLeftX>-20037508</UpperLeftX><UpperLeftY>20037508</UpperLeftY><LowerRightX>20037508</LowerRightX>
<LowerRightY>-20037508</LowerRightY><TileLevel>2</TileLevel><TileCountX>1</TileCountX><TileCountY>1</TileCountY>
<YOrigin>top</YOrigin></DataWindow><Projection>EPSG:3857</Projection><BandsCount>1</BandsCount></GDAL_WMS>""",
    "WCS": """<WCS_GDAL><ServiceURL>http://127.0.0.1:{port}/wcs?</ServiceURL><CoverageName>x</CoverageName></WCS_GDAL>""",
    "remote link": "http://127.0.0.1:{port}/x.tif",
}


@pytest.mark.parametrize("kind", DESCRIPTIONS)
@pytest.mark.parametrize("ending", ["tif", "tiff"])
def test_a_raster_that_describes_another_place_is_refused_and_nobody_is_asked(tmp_path: Path, kind: str, ending: str) -> None:
    pytest.importorskip("rasterio")
    with listener() as (port, asked):
        (tmp_path / f"m.{ending}").write_text(DESCRIPTIONS[kind].format(port=port))
        calls = ["map info {}", "map convert {} o.nc --heights-m 30", "map compare {0} {0}", "map show {}"]
        ended = watched(CALL_ALL, tmp_path, "\n".join(calls).replace("{0}", "{}").format(*[f"m.{ending}"] * 5))
    assert asked == []
    assert ended.returncode == 0, ended.stderr
    lines = ended.stderr.splitlines()
    assert len(lines) == 4, ended.stderr
    assert all(line.startswith("cellpilot: m.") for line in lines)
