"""Zarr: everything a map holds, as a folder of chunks that cloud storage and dask read piece by piece (extra `zarr`)."""

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import xarray as xr

from cellpilot.errors import InputError
from cellpilot.maps.schema import RadioMap, check_header, validate
from cellpilot.memory import check_memory
from cellpilot.storage import digest_of_bytes, new_folder, parse_json, read_text, resolved

SUMS = "cellpilot.sha256"
"""File in a store with the checksums of all others, as `sha256sum --check` reads it."""
CODECS = frozenset(
    {"blosc", "zlib", "gzip", "zstd", "lz4", "bz2", "shuffle", "vlen-utf8", "bytes", "transpose", "crc32c"}
    | {"numcodecs.zlib", "numcodecs.shuffle"}
)
"""What may pack a chunk; others run programs that stand in the file (pickle), or are not needed for numbers and names."""
METADATA = (".zarray", ".zmetadata", "zarr.json")


def write(dataset: RadioMap, path: Path) -> None:
    """Write a valid map as a Zarr folder with the checksums of its files, in the place of one that is there."""
    _check_installed()
    path = resolved(path)  # of a link, what it points at is replaced
    if path.is_dir() and any(path.iterdir()) and not (path / ".zgroup").exists() and not (path / "zarr.json").exists():
        raise InputError(f"{path}: a folder that is no Zarr store; choose another name, it is not replaced")
    files = _packed(dataset)
    sums = "".join(f"{digest_of_bytes(content)}  {name}\n" for name, content in files.items())
    with new_folder(path) as temporary:
        for name, content in (files | {SUMS: sums.encode()}).items():
            (temporary / name).parent.mkdir(parents=True, exist_ok=True)
            (temporary / name).write_bytes(content)


def _packed(dataset: RadioMap) -> dict[str, bytes]:
    """The files of a store by name, made in memory: on a full disk Zarr's own tasks complain on standard error."""
    import zarr

    files: dict[str, Any] = {}
    dataset.drop_encoding().to_zarr(zarr.storage.MemoryStore(files), mode="w", consolidated=True, zarr_format=2)
    return {name: files[name].to_bytes() for name in sorted(files)}


def read(path: Path) -> RadioMap:
    """The map in a Zarr folder, in memory and checked; `InputError` for a damaged store and for codecs that are not allowed."""
    _check_installed()
    path = resolved(path)
    has_checksum(path)
    _check_codecs(path)
    try:
        with xr.open_zarr(path, decode_times=False, decode_timedelta=False) as opened:
            check_header(opened, str(path))
            check_memory(2 * opened.nbytes, f"{path}: reading it", "take a smaller one, or a machine with more memory")
            dataset = opened.load()
    except InputError:
        raise
    except (OSError, ArithmeticError, AttributeError, LookupError, RuntimeError, TypeError, ValueError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: not a readable Zarr store ({reason}); expected a map written by cellpilot") from None
    return validate(dataset, str(path)).drop_encoding()


def has_checksum(path: Path) -> bool:
    """Whether a store has checksums; `InputError` if they are those of other files than it has."""
    if not (path / SUMS).is_file():
        return False
    stated: dict[str, str] = {}
    for line in read_text(path / SUMS, "write the map again").splitlines():
        checksum, _, name = line.partition("  ")
        stated[name] = checksum
    found = {file.relative_to(path).as_posix(): file for file in _files(path) if file.name != SUMS}
    for name in sorted(stated.keys() | found.keys()):
        if name not in found or stated.get(name) != _sum(found[name]):
            what = "is missing" if name not in found else "is not the file that was written"
            raise InputError(
                f"{path}: checksum mismatch, {name} {what}: restore the map; if you changed it yourself, delete {SUMS} in it"
            )
    return True


def _files(path: Path) -> list[Path]:
    return sorted(file for file in path.rglob("*") if file.is_file())


def _sum(file: Path) -> str:
    with file.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()


def _check_codecs(path: Path) -> None:
    """`InputError` if a chunk is packed in a way that is not in `CODECS`: before anything is unpacked."""
    for file in _files(path):
        if file.name in METADATA:
            for codec in _codecs(parse_json(read_text(file, "restore the map"), str(file), "restore the map")):
                if codec not in CODECS:
                    raise InputError(
                        f"{file}: packed by {codec!r}; expected one of {', '.join(sorted(CODECS))}: write the map again"
                    )


def _codecs(content: Any) -> Iterator[str]:
    """Names of all codecs anywhere in the description of a store."""
    if isinstance(content, list):
        for item in content:
            yield from _codecs(item)
    if not isinstance(content, dict):
        return
    for key, value in content.items():
        if key in ("compressor", "filters", "codecs", "serializer", "compressors"):
            for codec in value if isinstance(value, list) else [value]:
                if codec is not None:
                    yield str(codec.get("id", codec.get("name"))) if isinstance(codec, dict) else json.dumps(codec)[:40]
        yield from _codecs(value)


def _check_installed() -> None:
    try:
        import zarr  # noqa: F401
    except ImportError:
        raise InputError("Zarr files need the package zarr: pip install 'cellpilot[zarr]'") from None
