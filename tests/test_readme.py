"""What the README shows runs as printed, and no template is left in the documents."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


EXAMPLES = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), flags=re.DOTALL)


def test_the_python_example_runs_as_printed(capsys: pytest.CaptureFixture[str]) -> None:
    exec(compile(EXAMPLES[0], "README.md", "exec"), {})
    shares, status = capsys.readouterr().out.splitlines()
    assert "'greedy': 0.125" in shares
    assert "'optimal': 0.048" in shares
    assert status == "reached"


def test_the_verbs_in_python_run_as_printed(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(EXAMPLES[1], "README.md", "exec"), {})
    assert len(EXAMPLES) == 2
    lines = capsys.readouterr().out.splitlines()
    for seed in (0, 1):
        printed, status, score = lines[2 * seed].split()
        assert (printed, status) == (str(seed), "reached")
        assert float(score) > 0.98
        assert (tmp_path / lines[2 * seed + 1]).is_file()


@pytest.mark.parametrize(
    "document", ["README.md", "docs/results.md", "docs/deviations.md", "CHANGELOG.md", "benchmarks/RESULTS.md"]
)
def test_no_template_is_left_in_the_documents(document: str) -> None:
    assert not re.search(r"\b(DEMO|TEST|RESULTS)_[A-Z]+\b", (ROOT / document).read_text())


def test_every_document_the_readme_links_to_exists() -> None:
    for link in re.findall(r"\]\(([^)#]+)\)", (ROOT / "README.md").read_text()):
        assert (ROOT / link).exists(), link


def test_three_trained_policies_ship() -> None:
    from cellpilot.policies import load_parameters

    scenarios = ROOT / "src" / "cellpilot" / "scenarios"
    shipped = {path.stem: load_parameters(path).about["scenario"] for path in scenarios.glob("*.safetensors")}
    assert shipped == {name: name for name in ("thesis-2d", "thesis-2d-noise", "thesis-3d")}
    assert sum(path.stat().st_size for path in scenarios.glob("*.safetensors")) < 200_000
