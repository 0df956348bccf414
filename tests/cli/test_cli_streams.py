"""Streams that are no wide UTF-8 terminal: every number, or one line; never a traceback."""

import io
import os
import subprocess
import sys
from pathlib import Path

import pytest
from cli_tools import TINY, Cli, assert_refused
from rich.table import Table

from cellpilot.cli import console
from cellpilot.cli.console import SafeConsole, stacked
from cellpilot.cli.main import main
from cellpilot.text import encodable, visible

PROGRAM = "import sys; from cellpilot.cli.main import entry; sys.exit(entry())"
CALLS = {
    "evaluate": ("evaluate", "run"),
    "info": ("map", "info", "plain.nc"),
    "compare": ("map", "compare", "plain.nc", "plain.nc"),
    "plan": ("plan", "plain.nc", "--start", "0,0,0", "--goal", "3,3,0"),
}


def called(place: Path, arguments: tuple[str, ...], shell: str = "", **environment: str) -> subprocess.CompletedProcess[bytes]:
    """The program in a process of its own, with the redirections of a shell."""
    words = [sys.executable, "-c", PROGRAM, *arguments]
    command = ["bash", "-c", f'"$@" {shell}', "bash", *words]
    return subprocess.run(command, cwd=place, env=os.environ | environment, capture_output=True, timeout=120, check=False)


@pytest.mark.parametrize("encoding", ["ascii", "latin-1", "cp1252", "cp437"])
@pytest.mark.parametrize("call", CALLS)
def test_an_output_without_unicode_has_all_numbers(
    place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch, encoding: str, call: str
) -> None:
    whole = cli(*CALLS[call]).out
    stream = io.TextIOWrapper(io.BytesIO(), encoding=encoding, write_through=True)
    monkeypatch.setattr(sys, "stdout", stream)
    assert main(list(CALLS[call])) == 0
    said = stream.buffer.getvalue().decode(encoding)  # type: ignore[attr-defined]
    digits = lambda text: [letter for letter in text if letter in "0123456789."]
    assert digits(said) == digits(whole)
    assert "?" not in said


def test_ascii_output_of_a_whole_process(place: Path) -> None:
    ended = called(place, CALLS["evaluate"], PYTHONIOENCODING="ascii")
    assert ended.returncode == 0, ended.stderr
    assert ended.stderr == b""
    assert b"100.00 %" in ended.stdout


@pytest.mark.parametrize("width", [40, 60, 70, 80, 200])
@pytest.mark.parametrize("call", ["evaluate", "compare"])
def test_numbers_are_never_cut(place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch, width: int, call: str) -> None:
    whole = cli(*CALLS[call]).out
    monkeypatch.setattr(console.out, "width", width)
    said = cli(*CALLS[call]).out
    assert "…" not in said
    for number in {word for word in whole.replace("│", " ").split() if word[:1].isdigit() and "." in word}:
        assert number in said, number


def test_a_table_that_is_too_wide_is_printed_row_by_row() -> None:
    table = Table("policy", "reached [%]", "return", title="all pairs", caption="what it means")
    table.add_row("greedy", "100.000", "7.13")
    table.add_row("optimum", "99.125", "8.13")
    lines = stacked(table)
    assert lines == [
        *("all pairs", "", "greedy", "  reached [%]: 100.000", "  return: 7.13"),
        *("", "optimum", "  reached [%]: 99.125", "  return: 8.13", "", "what it means"),
    ]
    for width, expected in ((100, "┃"), (20, "  return: 8.13")):
        printed = io.StringIO()
        SafeConsole(file=printed, width=width).print(table)
        assert expected in printed.getvalue()
        assert "99.125" in printed.getvalue()


@pytest.mark.parametrize(
    ("shell", "code"), [(">&-", 0), ("2>&-", 0), (">&- 2>&-", 0), ("<&-", 0), (">&- <&- 2>&-", 0), ("> /dev/full", 2)]
)
def test_closed_and_full_streams(place: Path, shell: str, code: int) -> None:
    ended = called(place, CALLS["info"], shell)
    assert ended.returncode == code, ended.stderr
    assert b"Traceback" not in ended.stderr
    assert b"Exception" not in ended.stderr
    if shell == "> /dev/full":
        assert ended.stderr.decode().startswith("cellpilot: standard output: ")


@pytest.mark.parametrize("arguments", [("--help",), ("--version",), ("map", "info", "--help"), ()])
def test_help_to_a_full_device_is_one_line(place: Path, arguments: tuple[str, ...]) -> None:
    ended = called(place, arguments, "> /dev/full")
    assert ended.returncode != 0
    assert len(ended.stderr.splitlines()) == 1
    assert b"Traceback" not in ended.stderr


def test_an_error_with_standard_error_closed_keeps_its_exit_code(place: Path) -> None:
    assert called(place, ("map", "info", "gone.nc"), "2>&-").returncode == 2


def test_a_reader_that_goes_away_is_no_error(place: Path) -> None:
    ended = called(place, CALLS["plan"], "| head -1")
    assert ended.returncode == 0
    assert ended.stderr == b""


HOSTILE = "a\x1b[31mred\x07\x9b\u202e\u2028b"


def test_control_characters_are_written_out() -> None:
    assert visible(HOSTILE) == "a\\x1b[31mred\\x07\\x9b\\u202e\\u2028b"
    assert visible("zürich\nnorth – 3 × 4") == "zürich\nnorth – 3 × 4"
    for stream in (io.StringIO(),):
        safe = SafeConsole(file=stream, width=60, force_terminal=True, markup=False, highlight=False)
        safe.print(f"name {HOSTILE}", style="yellow")
        table = Table(HOSTILE)
        table.add_row(HOSTILE)
        safe.print(table)
        text = stream.getvalue().replace("\x1b[33m", "").replace("\x1b[0m", "").replace("\x1b[1m", "")
        assert "\x1b[31m" not in text
        assert not {"\x07", "\x9b", "\u202e", "\u2028"} & set(text)


def test_names_from_files_reach_the_terminal_without_their_escapes(place: Path, cli: Cli) -> None:
    evil = place / "e\x1b[31mvil.nc"
    (place / "plain.nc").rename(evil)
    for call in (("map", "info", evil), ("map", "info", f"{evil}x"), ("map", "compare", evil, evil), ("plan", f"{evil}.nc")):
        result = cli(*call)
        assert "\x1b" not in result.out + result.err
        assert "\\x1b[31m" in result.out + result.err


@pytest.mark.parametrize(
    ("text", "plain"), [("3 ± 1 × 2 − 4", "3 +- 1 x 2 - 4"), ("zürich", "zurich"), ("東", "?"), ("a\u202fb", "a b")]
)
def test_letters_that_an_encoding_lacks(text: str, plain: str) -> None:
    assert encodable(text, "ascii") == plain
    assert encodable(text, "utf-8") == text
    assert encodable(text, "no such encoding") == plain


def test_long_work_without_a_terminal_says_now_and_then_how_far_it_is(
    place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert cli("evaluate", "run").err == ""  # short work says nothing
    monkeypatch.setattr(console, "LINE_EVERY_S", 0.0)
    lines = cli("evaluate", "run").err.splitlines()
    assert len(lines) > 2
    assert all(line.startswith("evaluate: ") and "% done" in line for line in lines)
    few = ("--learner.episodes", "5", "--learner.replay-start", "100")
    trained = cli("train", "tiny.toml", "--out", "new", *few).err
    assert "train: 100% done" in trained
    assert "5 of 5 episodes, return" in trained


MISTYPED = [
    (("trian", "tiny.toml"), "perhaps you meant train"),
    (("train", "tiny.toml", "--learner.episode", "3"), "perhaps you meant --learner.episodes"),
    (("train", "tiny.toml", "--task.treshold-db", "3"), "perhaps you meant --task.threshold-db"),
    (("evaluate", "run", "--jsn"), "perhaps you meant --json"),
    (("evaluate", "thesis2d"), "no such"),
    (("train", "thesis-2", "--out", "x"), "perhaps you meant thesis-2d"),
]


@pytest.mark.parametrize(("arguments", "hint"), MISTYPED)
def test_a_mistyped_word_brings_the_nearest_one(place: Path, cli: Cli, arguments: tuple[str, ...], hint: str) -> None:
    assert_refused(cli(*arguments), hint)


@pytest.mark.parametrize("option", ["--learner.episodes=200", "--seed=3", "--task.threshold-db=4", "--out=x", "--force"])
def test_a_run_that_goes_on_takes_no_other_settings(place: Path, cli: Cli, option: str) -> None:
    assert_refused(cli("train", "--resume", "run", option), option.partition("=")[0], "its own settings", "start a new one")


NAMES = ["../../up", "/abs", "", ".", "..", "a/b", "a\\b", "x" * 101, "a\tb", "-rf", " a", "a\u202eb", "con:x"]


@pytest.mark.parametrize("name", NAMES)
def test_a_scenarios_name_is_one_name_of_a_file(place: Path, cli: Cli, name: str) -> None:
    text = name.replace("\\", "\\\\").replace("\t", "\\t")
    (place / "s.toml").write_text(TINY.replace('"tiny"', f'"{text}"'), encoding="utf-8")
    before = {path.name for path in place.parent.iterdir()}
    assert_refused(cli("train", "s.toml"), "s.toml", "name is")
    assert {path.name for path in place.parent.iterdir()} == before


def test_a_name_with_an_umlaut_under_another_locale_is_read_again(place: Path) -> None:
    (place / "s.toml").write_text(
        TINY.replace('"tiny"', '"zürich nord"').replace("episodes = 60", "episodes = 5"), encoding="utf-8"
    )
    surroundings = {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0", "PYTHONIOENCODING": ""}
    trained = called(place, ("train", "s.toml", "--out", "z"), **surroundings)
    assert trained.returncode == 0, trained.stderr
    again = called(place, ("evaluate", "z"), **surroundings)
    assert again.returncode == 0, again.stderr
    assert 'name = "zürich nord"' in (place / "z" / "scenario.toml").read_text(encoding="utf-8")


WRONG_TOML = [
    (b"\xef\xbb\xbf", None),
    ("a = " + "[" * 100_000, "nested too deeply"),
    ("n = " + "1" * 5_000, "not valid TOML"),
    ('name = "a\\u0000b"', "name is"),
    (b"\xff\xfe", "not UTF-8"),
    ("[evaluation]\nn_sampled = 1000000000000", "n_sampled"),
    ("[evaluation]\nboltzmann_temperature = 1e308", "boltzmann_temperature"),
    ("[learner]\nepisodes = 99999999999", "episodes"),
]


@pytest.mark.parametrize(("text", "named"), WRONG_TOML)
def test_a_scenario_file_that_is_odd(place: Path, cli: Cli, text: str | bytes, named: str | None) -> None:
    content = text if isinstance(text, bytes) else text.encode()
    (place / "s.toml").write_bytes(content + TINY.encode() if named is None else content)
    result = cli("map", "simulate", "s.toml", "--out", "o.nc")
    if named is None:
        assert result.code == 0, result.err
    else:
        assert_refused(result, "s.toml", named)


def test_a_recorded_command_can_be_called_again(place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    import json
    import shlex

    few = ["--learner.episodes", "5", "--learner.replay-start", "100"]
    arguments = ["train", "tiny.toml", "--out", "my 'run'", *few]
    monkeypatch.setattr(sys, "argv", ["/somewhere/cellpilot", *arguments])
    assert cli(*arguments).code == 0
    command = json.loads((place / "my 'run'" / "run.json").read_text())["command"]
    assert shlex.split(command) == ["cellpilot", *arguments]


def test_a_link_that_leads_to_itself_is_one_line(place: Path, cli: Cli) -> None:
    (place / "loop").symlink_to("loop")
    for call in (
        ("train", "tiny.toml", "--out", "loop"),
        ("evaluate", "loop"),
        ("map", "convert", "plain.nc", "loop"),
        ("export", "run", "--onnx", "loop"),
        ("map", "import", "loop", "loop"),
    ):
        assert_refused(cli(*call), "loop")
