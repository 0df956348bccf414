"""Text files with one header line and separated columns, read so that every complaint names file, line and column."""

import csv
import gzip
import re
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from io import TextIOWrapper
from itertools import chain
from math import nan
from pathlib import Path
from typing import IO, TextIO, cast

from cellpilot.errors import InputError

MISSING_TEXTS = frozenset({"", "-", "n/a", "na", "nan", "null", "none"})
"""Texts (in small letters) that stand for no value."""

LONGEST_LINE, MOST_UNPACKED_BYTES, MOST_PACKING = 1_000_000, 20_000_000, 100
"""Characters of a line, and bytes of a packed text: those that are always read, and how many times the file more."""

SENTINELS = frozenset({2147483647.0, -2147483648.0, 9223372036854775807.0})
"""Numbers that stand for no value: Android's UNAVAILABLE is the greatest 32-bit integer."""


UNREADABLE = (OSError, EOFError, zlib.error)
"""What a file that cannot be read, or is packed and damaged, raises."""


@dataclass(frozen=True)
class Column:
    """A numeric column: its name, and the values that make sense in it."""

    name: str
    low: float
    high: float
    unit: str = ""


LATITUDE_DEG, LONGITUDE_DEG = (-90.0, 90.0), (-180.0, 180.0)


@dataclass(frozen=True)
class Table:
    """The header of an opened file."""

    path: Path
    line: int  # of the header, counted from 1
    names: tuple[str, ...]

    def require(self, names: tuple[str, ...], hint: str = "") -> None:
        """`InputError` naming the first of the columns that the file does not have."""
        for name in names:
            if name not in self.names:
                raise InputError(f"{self.path}, line {self.line}: no column {name!r}; found {self.shown()}{hint}")
            if self.names.count(name) > 1:
                raise InputError(
                    f"{self.path}, line {self.line}: two columns {name!r}; rename or remove the one that is not meant"
                )

    def shown(self) -> str:
        """Number of columns and the first names, for messages."""
        first = ", ".join(repr(name) for name in self.names[:6]) + (", ..." if len(self.names) > 6 else "")
        return f"{len(self.names)} column(s): {first}"


@dataclass(frozen=True)
class TextRow:
    """One line below the header."""

    table: Table
    line: int
    fields: list[str]

    def check_width(self) -> None:
        """`InputError` unless the line has as many fields as the header."""
        if len(self.fields) != len(self.table.names):
            raise self.error(
                f"{len(self.fields)} field(s); expected {len(self.table.names)} as in the header: remove or complete the line"
            )

    def text(self, name: str | None) -> str:
        """The field of that column; empty where the value or the whole column is missing."""
        if name is None or name not in self.table.names:
            return ""
        text = self.fields[self.table.names.index(name)].strip()
        return "" if text.lower() in MISSING_TEXTS else text

    def number(self, column: Column) -> float:
        """The number in that column, NaN where it is missing; `InputError` for text and for values out of range."""
        return self._number(column, ", or nothing")

    def _number(self, column: Column, or_nothing: str) -> float:
        text = self.text(column.name)
        if not text:
            return nan
        wanted = f"{_range(column)}{or_nothing}: correct or remove the line"
        try:
            # Python would read 1_0 as ten.
            value = float(text.replace("_", "?"))
        except ValueError:
            raise self.error(f"{column.name} is {text!r}; {wanted}") from None
        if value in SENTINELS:
            return nan
        if not column.low <= value <= column.high:
            raise self.error(f"{column.name} is {text}; {wanted}")
        return value

    def needed(self, column: Column) -> float:
        """`number` of a column that may not be empty."""
        value = self._number(column, "")
        if value != value:
            found = self.fields[self.table.names.index(column.name)].strip() if column.name in self.table.names else ""
            raise self.error(f"{column.name} is {repr(found) if found else 'empty'}; {_range(column)}")
        return value

    def error(self, text: str) -> InputError:
        """The error that says where and what."""
        return InputError(f"{self.table.path}, line {self.line}: {text}")


FORMULA = re.compile(r"'*[=+\-@\t\r]")
"""How a text begins that a spreadsheet runs as a formula, apostrophes before it included."""


def for_spreadsheets(text: str) -> str:
    """A text that no spreadsheet takes for a formula: one that begins like one gets an apostrophe in front."""
    return f"'{text}" if FORMULA.match(text) else text


def from_spreadsheets(text: str) -> str:
    """The text behind `for_spreadsheets`."""
    return text[1:] if text.startswith("'") and FORMULA.match(text) else text


def _range(column: Column) -> str:
    return f"expected a number from {column.low:g} to {column.high:g} {column.unit}".rstrip()


def open_table(path: Path, what: str, header: Sequence[str] | None = None) -> tuple[Table, Iterator[TextRow]]:
    """The header of a file, and its further lines that are not blank; `what` is expected in it.

    `header` names the columns of files that may come without a header line: a first line with anything but these names is
    data. Columns are separated by comma, tab or semicolon, whichever the first line has most of. Lines above it that start
    with # are comments. A file named .gz is unpacked. `InputError` for a missing, empty or unreadable file.
    """
    if not path.is_file():
        raise InputError(f"{path}: {'not a file' if path.exists() else 'no such file'}; expected a {what} (.csv)")
    lines = _lines(path)
    for line, fields in lines:
        if fields[0].lstrip().startswith("#"):
            continue
        names = tuple(name.strip() for name in fields)
        if header is None or set(names) <= set(header):
            table, below = Table(path, line, names), lines
        else:
            table, below = Table(path, line, tuple(header)), chain([(line, fields)], lines)
        return table, (TextRow(table, number, row) for number, row in below)
    raise InputError(f"{path}: the file is empty; expected a {what}" + ("" if header else " with a header line"))


def _lines(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of every line that is not blank; a byte-order mark is taken off."""
    reader = None
    try:
        with _unpacked(path) as packed, TextIOWrapper(packed, "utf-8-sig", newline="") as file:
            first = next((text for text in _short(path, file) if text.strip() and not text.lstrip().startswith("#")), "")
            delimiter = max(",\t;", key=first.count)
            file.seek(0)
            reader = csv.reader(_short(path, file), delimiter=delimiter)
            for row in reader:
                if any(field.strip() for field in row):
                    yield reader.line_num, row
    except UnicodeDecodeError:
        line, byte = _not_utf8(path)
        raise InputError(
            f"{path}, line {line}: not readable as text (the byte 0x{byte:02x} there is not UTF-8);"
            " expected UTF-8 with separated columns: save it with that encoding"
        ) from None
    except csv.Error as error:
        line = reader.line_num if reader else 1
        raise InputError(f"{path}, line {line}: not readable as text ({error}); expected UTF-8 with separated columns") from None
    except UNREADABLE as error:
        raise InputError(
            f"{path}: cannot be read ({getattr(error, 'strerror', None) or error}): check the file and its permissions"
        ) from None


def _short(path: Path, file: TextIO) -> Iterator[str]:
    """The lines of a text; `InputError` for one without end, or text that packs a disk full into a small file."""
    packed_bytes, characters = path.stat().st_size if path.suffix == ".gz" else None, 0
    while line := file.readline(LONGEST_LINE + 1):
        characters += len(line)
        if len(line) > LONGEST_LINE:
            raise InputError(f"{path}: a line of more than {LONGEST_LINE:,} characters; expected lines of separated columns")
        if packed_bytes is not None and characters > max(MOST_UNPACKED_BYTES, MOST_PACKING * packed_bytes):
            raise InputError(
                f"{path}: unpacks from {packed_bytes / 1e6:.3g} MB to more than {characters / 1e6:.3g} MB, as no log does;"
                " unpack it yourself if it is one"
            )
        yield line


def _unpacked(path: Path) -> IO[bytes]:
    return cast(IO[bytes], gzip.open(path)) if path.suffix == ".gz" else path.open("rb")


def _not_utf8(path: Path) -> tuple[int, int]:
    """Line and value of the first byte that is not UTF-8: text is decoded in blocks, far ahead of the line being read."""
    with _unpacked(path) as file:
        data = file.read()
    before = re.split("[\udc80-\udcff]", data.decode(errors="surrogateescape"), maxsplit=1)[0]
    return len(re.findall(r"\r\n|\r|\n", before)) + 1, data[len(before.encode())]
