"""`cellpilot export`: from runs, shipped scenarios and policy files to an ONNX file that acts like the policy."""

from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from cli_tools import Cli

from cellpilot.policies import load_parameters, onnx_file
from cellpilot.scenario import SHIPPED


@pytest.mark.parametrize(("source", "n_actions"), [("run", 4), ("run/policy.safetensors", 4), ("thesis-3d", 6)])
def test_a_policy_is_exported(place: Path, cli: Cli, source: str, n_actions: int) -> None:
    result = cli("export", source, "--onnx", "new/policy.onnx")
    assert result.code == 0, result.err
    assert "new/policy.onnx: concatenated policy" in result.out
    session = onnxruntime.InferenceSession("new/policy.onnx", providers=["CPUExecutionProvider"])
    parameters = load_parameters(SHIPPED / "thesis-3d.safetensors" if n_actions == 6 else Path("run/policy.safetensors"))
    assert session.get_modelmeta().custom_metadata_map["grid_sides"] == " ".join(map(str, parameters.sides))
    place_3d = np.array([[0, 0, 0], [3, 2, 0]], np.int64)
    values = session.run(["action_values"], {"position": place_3d, "goal": place_3d[::-1].copy()})[0]
    assert values.shape == (2, n_actions)
    assert [path.name for path in (place / "new").iterdir()] == ["policy.onnx"]


def test_without_the_extra_nothing_is_written(place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnx_file, "find_spec", lambda name: None)
    result = cli("export", "run", "--onnx", "policy.onnx")
    assert (result.code, result.err) == (2, "cellpilot: ONNX export needs the extra onnx: pip install 'cellpilot[onnx]'\n")
    assert not (place / "policy.onnx").exists()
