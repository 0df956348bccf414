import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parents[2] / "src" / "cellpilot"
LAZY = ("cellpilot", "cellpilot.maps", "cellpilot.report", "cellpilot.service")


@pytest.mark.parametrize("package", LAZY)
def test_every_name_of_a_lazy_package_is_found(package: str) -> None:
    module = import_module(package)
    assert all(getattr(module, name) is not None for name in module.__all__)
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = module.nothing


def test_importing_the_package_imports_nothing_slow() -> None:
    code = f"import sys, {', '.join(LAZY)}; print(sorted({{'jax', 'numpy', 'xarray', 'scipy', 'matplotlib'}} & set(sys.modules)))"
    assert subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip() == "[]"


def test_lazy_import_is_written_once() -> None:
    own = [path.name for path in PACKAGE.rglob("*.py") if "def __getattr__" in path.read_text()]
    assert own == ["lazy.py"]
