"""Text as a stream can show it: control characters made visible, and letters that its encoding lacks in plain ones."""

import re
import unicodedata
from collections.abc import Container

PLAIN = {
    "\u202f": " ",
    "\u00a0": " ",
    "\u2009": " ",
    "\u2212": "-",
    "\u2013": "-",
    "\u2014": "-",
    "\u2011": "-",
    "\u2500": "-",
    "\u2501": "-",
    "\u00d7": "x",
    "\u00b1": "+-",
    "\u00b0": " deg",
    "\u2026": "...",
    "\u00b7": "|",
    "\u2265": ">=",
    "\u2264": "<=",
    "\u2192": "->",
    "\u0394": "D",
    "\u00b2": "2",
    "\u00df": "ss",
}
"""What to write for signs that an encoding may lack; accents are taken off letters, and what is left becomes a question mark."""


def visible(text: str) -> str:
    """The text with everything that would act on a terminal written out, such as \\x1b for an escape; line ends stay."""
    if text.isprintable():
        return text
    return "".join(letter if letter == "\n" or not _acts(letter) else _written_out(letter) for letter in text)


def encodable(text: str, encoding: str | None) -> str:
    """The text in letters that the encoding has."""
    encoding = encoding or "utf-8"
    try:
        text.encode(encoding)
    except UnicodeEncodeError:
        return "".join(_letter(letter, encoding) for letter in text)
    except LookupError:
        return encodable(text, "ascii")
    return text


def _acts(letter: str) -> bool:
    """Control characters, marks that turn the direction of writing, and halves of characters."""
    return unicodedata.category(letter) in ("Cc", "Cf", "Cs", "Zl", "Zp")


def _written_out(letter: str) -> str:
    code = ord(letter)
    return f"\\x{code:02x}" if code < 256 else f"\\u{code:04x}" if code < 65536 else f"\\U{code:08x}"


def _letter(letter: str, encoding: str) -> str:
    for candidate in (letter, PLAIN.get(letter, ""), unicodedata.normalize("NFKD", letter)[:1]):
        try:
            candidate.encode(encoding)
        except UnicodeEncodeError:
            continue
        if candidate:
            return candidate
    return "?"


ARGUMENT = re.compile(r"`([a-z]\w*(?:\.[a-z]\w*)*)`")


def in_section(section: str, message: str, names: Container[str]) -> str:
    """A message in which the arguments of these names are named as settings of a section (`map.altitude_m`)."""
    return ARGUMENT.sub(lambda found: f"`{section}.{found[1]}`" if found[1] in names else found[0], message)


def as_flags(message: str) -> str:
    """A message with the arguments that it names in backquotes (`map.bin_m`) as options of the command line."""
    return ARGUMENT.sub(lambda found: f"--{found[1].replace('_', '-')}", message)
