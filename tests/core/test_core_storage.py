"""Files: whole or not at all, checked before they are believed, held by one at a time."""

import os
import stat
import subprocess
import sys
from contextlib import suppress
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cellpilot.errors import InputError, WriteError
from cellpilot.storage import (
    LOCK,
    TEMPORARY,
    check_seal,
    hold,
    load_array,
    load_netcdf,
    load_tensors,
    parse_json,
    read_text,
    save_array,
    save_netcdf,
    save_tensors,
    seal,
    write_atomically,
)


def names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


def test_text_is_utf8_whatever_the_locale_says(tmp_path: Path) -> None:
    code = "from pathlib import Path; from cellpilot.storage import write_atomically; write_atomically(Path('t'), 'z\\xfcrich')"
    environment = os.environ | {"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0", "PYTHONUTF8": "0"}
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, env=environment, check=True)
    assert (tmp_path / "t").read_bytes() == "zürich".encode()


def test_a_write_that_fails_leaves_the_file_as_it_was_and_nothing_else(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "deep" / "result.txt"
    write_atomically(path, "first")

    def full(descriptor: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(WriteError, match=r"result\.txt: cannot be written \(no space left on device\)"):
        write_atomically(path, "second")
    assert path.read_text() == "first"
    assert names(path.parent) == ["result.txt"]


def test_the_file_appears_only_when_it_is_whole(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path, seen = tmp_path / "result.txt", []
    monkeypatch.setattr(os, "fsync", lambda descriptor: seen.append((path.exists(), names(tmp_path))))
    write_atomically(path, "whole")
    (before, files), *_ = seen
    assert not before
    assert [name[: len(TEMPORARY)] for name in files] == [TEMPORARY]
    assert names(tmp_path) == ["result.txt"]


def _write_often(path: Path, content: bytes) -> None:
    for _ in range(50):
        write_atomically(path, content)


def test_two_writers_of_one_name_both_finish_and_the_file_is_of_one_of_them(tmp_path: Path) -> None:
    path, contents = tmp_path / "shared.bin", [bytes([i]) * 20_000 for i in range(3)]
    writers = [get_context("spawn").Process(target=_write_often, args=(path, content)) for content in contents]
    for writer in writers:
        writer.start()
    for writer in writers:
        writer.join()
    assert [writer.exitcode for writer in writers] == [0, 0, 0]
    assert path.read_bytes() in contents
    assert names(tmp_path) == ["shared.bin"]


def test_what_a_kill_left_goes_with_the_next_write_but_not_what_a_living_writer_holds(tmp_path: Path) -> None:
    import fcntl

    path = tmp_path / "m.nc"
    (tmp_path / f"{TEMPORARY}00000000-m.nc").write_text("of a dead one")
    (tmp_path / f"{TEMPORARY}00000000-other.nc").write_text("of another name")
    with (tmp_path / f"{TEMPORARY}11111111-m.nc").open("w") as living:
        fcntl.flock(living, fcntl.LOCK_EX)
        write_atomically(path, "new")
        assert names(tmp_path) == [f"{TEMPORARY}00000000-other.nc", f"{TEMPORARY}11111111-m.nc", "m.nc"]


def test_a_link_under_the_temporary_name_is_not_followed(tmp_path: Path) -> None:
    precious = tmp_path / "precious"
    precious.write_text("precious")
    for name in (f"{TEMPORARY}z.csv", f"{TEMPORARY}00000000-z.csv"):
        (tmp_path / name).symlink_to(precious)
    write_atomically(tmp_path / "z.csv", "cells")
    assert precious.read_text() == "precious"
    assert not (tmp_path / "z.csv").is_symlink()


def test_a_temporary_name_that_somebody_has_is_not_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn = iter(["aaaaaaaa", "bbbbbbbb"])
    monkeypatch.setattr("secrets.token_hex", lambda n: next(drawn))
    theirs = tmp_path / f"{TEMPORARY}aaaaaaaa-f.txt"
    with theirs.open("w") as held:
        import fcntl

        fcntl.flock(held, fcntl.LOCK_EX)
        theirs.write_text("theirs")
        write_atomically(tmp_path / "f.txt", "ours")
    assert theirs.read_text() == "theirs"
    assert (tmp_path / "f.txt").read_text() == "ours"


@pytest.mark.parametrize(("umask", "mode"), [(0o077, 0o600), (0o022, 0o644), (0o002, 0o664)])
def test_permissions_are_those_of_the_umask(tmp_path: Path, umask: int, mode: int) -> None:
    before = os.umask(umask)
    try:
        write_atomically(tmp_path / "f", "x")
    finally:
        os.umask(before)
    assert stat.S_IMODE((tmp_path / "f").stat().st_mode) == mode


@pytest.mark.parametrize("name", ["a\0b", "x" * 300, "\udcff\0"])
def test_a_name_that_no_file_can_have_is_one_error(tmp_path: Path, name: str) -> None:
    with pytest.raises(WriteError, match="cannot be written"):
        write_atomically(tmp_path / name, "x")


def test_text_that_is_no_unicode_is_refused(tmp_path: Path) -> None:
    with pytest.raises(WriteError, match="no Unicode text"):
        write_atomically(tmp_path / "f", "a\ud800b")
    assert names(tmp_path) == []


def test_a_held_folder_names_its_process_and_is_free_afterwards(tmp_path: Path) -> None:
    folder = tmp_path / "a" / "run"
    with hold(folder):
        assert (folder / LOCK).read_text() == f"{os.getpid()}\n"
        with pytest.raises(InputError, match=rf"run is in use by process {os.getpid()}: wait"), hold(folder):
            pass
        (folder / "kept").write_text("x")
    with hold(folder):
        pass
    assert names(folder) == ["kept"]


def test_a_folder_that_was_made_to_be_held_and_stays_empty_goes_again(tmp_path: Path) -> None:
    with hold(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
    assert names(tmp_path) == []


def test_the_lock_of_a_killed_process_is_taken_over(tmp_path: Path) -> None:
    code = "import os; from pathlib import Path; from cellpilot.storage import hold\nwith hold(Path('r')): os._exit(9)"
    subprocess.run([sys.executable, "-c", code], cwd=tmp_path, check=False)
    assert (tmp_path / "r" / LOCK).exists()
    with hold(tmp_path / "r"):
        assert (tmp_path / "r" / LOCK).read_text() == f"{os.getpid()}\n"


def test_a_file_in_the_place_of_the_folder_is_said(tmp_path: Path) -> None:
    (tmp_path / "r").write_text("x")
    with pytest.raises(InputError, match="a file; choose an empty folder"), hold(tmp_path / "r"):
        pass
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(InputError, match="loop: cannot be worked in"), hold(tmp_path / "loop"):
        pass


def small_dataset() -> xr.Dataset:
    return xr.Dataset({"a": (("x",), np.linspace(0.0, 1.0, 50))}, {"x": np.arange(50)}, {"title": "zürich"})


def test_every_flipped_bit_of_a_netcdf_file_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "d.nc"
    save_netcdf(small_dataset(), path)
    assert check_seal(path)
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    for position in rng.integers(len(whole) - 82, size=200):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ (1 << int(rng.integers(8)))]) + whole[position + 1 :])
        with pytest.raises(InputError, match="checksum mismatch"):
            load_netcdf(path, "a dataset")
    path.write_bytes(whole)
    xr.testing.assert_identical(load_netcdf(path, "a dataset"), small_dataset())


def test_other_readers_of_hdf5_open_a_sealed_file_and_what_they_write_has_no_seal(tmp_path: Path) -> None:
    import h5py

    save_netcdf(small_dataset(), tmp_path / "d.nc")
    with h5py.File(tmp_path / "d.nc") as file:
        np.testing.assert_array_equal(file["a"][:], np.linspace(0.0, 1.0, 50))
    xr.load_dataset(tmp_path / "d.nc", engine="h5netcdf").to_netcdf(tmp_path / "e.nc", engine="h5netcdf")
    assert not check_seal(tmp_path / "e.nc")
    xr.testing.assert_equal(load_netcdf(tmp_path / "e.nc", "a dataset"), small_dataset())


def test_a_damaged_header_without_a_seal_is_one_line(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "d.nc"
    small_dataset().to_netcdf(path, engine="h5netcdf")
    whole = path.read_bytes()
    for position in range(0, min(len(whole), 4000), 52):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x10]) + whole[position + 1 :])
        with suppress(InputError):
            load_netcdf(path, "a dataset")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("value", [{"a": 1}, None, "\ud800", ["a", 1, None]])
def test_an_attribute_that_netcdf_cannot_hold_is_named(tmp_path: Path, value: object) -> None:
    with pytest.raises(InputError, match="attribute note"):
        save_netcdf(small_dataset().assign_attrs(note=value), tmp_path / "d.nc")
    assert names(tmp_path) == []


def test_tensors_come_back_equal_and_every_change_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "t.safetensors"
    tensors = {"b": np.arange(6, dtype=np.float32).reshape(2, 3), "a": np.array(7, np.int32)}
    save_tensors(path, tensors, "kind-1", {"sides": (3, 3, 1), "x": 0.1})
    found, header = load_tensors(path, "kind-1", {"sides", "x"}, "make it again")
    assert (header["sides"], header["x"]) == ([3, 3, 1], 0.1)
    for name, value in tensors.items():
        np.testing.assert_array_equal(found[name], value, strict=True)
    whole = path.read_bytes()
    accepted, messages = list[int](), list[str]()
    for position in range(len(whole)):
        path.write_bytes(whole[:position] + bytes([whole[position] ^ 0x04]) + whole[position + 1 :])
        try:
            load_tensors(path, "kind-1", {"sides", "x"}, "make it again")
            accepted.append(position)
        except InputError as error:
            messages.append(str(error))
    assert accepted == []
    assert all(message.endswith("make it again") for message in messages)


def test_a_tensor_of_another_shape_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "t.safetensors"
    save_tensors(path, {"w": np.arange(6.0).reshape(2, 3)}, "kind-1", {})
    whole = path.read_bytes()
    assert whole.count(b"[2,3]") == 1
    path.write_bytes(whole.replace(b"[2,3]", b"[3,2]"))
    with pytest.raises(InputError, match="checksum"):
        load_tensors(path, "kind-1", set(), "make it again")


def test_equal_tensors_make_equal_files(tmp_path: Path) -> None:
    for name in "ab":
        save_tensors(tmp_path / name, {"w": np.ones(3, np.float32), "v": np.zeros(2)}, "kind-1", {"q": 1, "p": [2]})
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_arrays_come_back_equal_and_a_changed_one_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "c.npy"
    save_array(np.arange(5.0), path)
    np.testing.assert_array_equal(load_array(path), np.arange(5.0))
    np.testing.assert_array_equal(np.load(path), np.arange(5.0))
    for content in (path.read_bytes().replace(b"\xf0?", b"\xf1?"), path.read_bytes()[:-10], b"", seal(b"no array")):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"c\.npy"):
            load_array(path)


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("[" * 100_000, "nested too deeply"),
        ("{", "not readable as JSON"),
        ("[1]", "expected a JSON object"),
        ("1" * 5000, ""),
    ],
)
def test_json_that_is_no_object_is_one_line(text: str, what: str) -> None:
    with pytest.raises(InputError, match=rf"^run\.json: .*{what}.*; restore it$"):
        parse_json(text, "run.json", "restore it")


def test_text_with_a_byte_order_mark_is_read_and_latin1_is_refused(tmp_path: Path) -> None:
    (tmp_path / "b").write_bytes(b"\xef\xbb\xbfa = 1")
    assert read_text(tmp_path / "b", "write it again") == "a = 1"
    (tmp_path / "l").write_bytes("zürich".encode("latin-1"))
    with pytest.raises(InputError, match=r"l: not UTF-8 text \(byte 1.*write it again"):
        read_text(tmp_path / "l", "write it again")


def test_an_axis_that_no_memory_holds_is_refused_before_it_is_read(tmp_path: Path) -> None:
    import h5py

    with h5py.File(tmp_path / "m.nc", "w") as file:
        file.create_dataset("x", (10**12,), "f8", chunks=(1000,)).make_scale("x")
    with pytest.raises(InputError, match=r"m\.nc: reading its axes needs 1\.6e\+04 GB"):
        load_netcdf(tmp_path / "m.nc", "a dataset")
