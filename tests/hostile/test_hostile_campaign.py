"""A short campaign of damaged and hostile files; `campaign.py` runs longer ones."""

from pathlib import Path
from typing import Any

import pytest
from campaign import campaign
from originals import KINDS, make_originals

ROUNDS = 4
"""Inputs of each kind of file."""


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """One sound file of each kind."""
    folder = tmp_path_factory.mktemp("originals")
    make_originals(folder)
    return folder


def wrong(results: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The results that are not as they should be."""
    return [result for result in results if result["verdict"] != "ok"]


@pytest.mark.slow
def test_damaged_files_end_in_one_line_or_in_what_was_written(originals: Path) -> None:
    results = list(campaign(originals, seed=7, first=0, inputs=ROUNDS * len(KINDS)))
    assert wrong(results) == []
    assert {result["kind"] for result in results} == KINDS.keys()
    assert 0.3 < sum(result["code"] == 2 for result in results) / len(results) < 1.0  # both sides were tried
