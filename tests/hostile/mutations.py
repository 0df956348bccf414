"""Ways in which a file goes wrong: by chance, by a careless program, on purpose."""

import re
from collections.abc import Callable

import numpy as np

Mutation = Callable[[np.random.Generator, bytes], bytes]
WORDS = (
    *(b"", b"nan", b"NaN", b"inf", b"-inf", b"null", b"true", b"[]", b"{}", b'""', b"-1", b"0", b"1e309", b"1e-400"),
    *(b"2147483648", b"9" * 400, b"1e18", b"-9999", b"3,5", b"0x10", b"\xff\xfe", b"\x00", b"\x1b[31m", b"../../x"),
    *(b"=cmd|' /C calc'!A0", b"'" * 3, "１２".encode(), "ü\u202e".encode(), b"[" * 3000, b'"\\ud800"'),
)
"""What is put in the place of a number or a word."""


def flip_bits(rng: np.random.Generator, content: bytes) -> bytes:
    """One to four bits the other way round."""
    changed = bytearray(content)
    for _ in range(int(rng.integers(1, 5))):
        changed[int(rng.integers(len(changed)))] ^= 1 << int(rng.integers(8))
    return bytes(changed)


def cut(rng: np.random.Generator, content: bytes) -> bytes:
    """The end is missing."""
    return content[: int(rng.integers(len(content)))]


def zero_block(rng: np.random.Generator, content: bytes) -> bytes:
    """A sector of the disk reads as zeros."""
    start = int(rng.integers(len(content)))
    length = min(int(rng.choice([16, 64, 512, 4096])), len(content) - start)
    return content[:start] + bytes(length) + content[start + length :]


def drop_block(rng: np.random.Generator, content: bytes) -> bytes:
    """Some bytes are missing in the middle."""
    start = int(rng.integers(len(content)))
    return content[:start] + content[start + int(rng.integers(1, 200)) :]


def repeat_block(rng: np.random.Generator, content: bytes) -> bytes:
    """Some bytes stand there twice."""
    start = int(rng.integers(len(content)))
    end = start + int(rng.integers(1, 200))
    return content[:end] + content[start:end] + content[end:]


def noise(rng: np.random.Generator, content: bytes) -> bytes:
    """Not the file at all."""
    return rng.bytes(int(rng.integers(0, 3000)))


def replace_words(rng: np.random.Generator, content: bytes) -> bytes:
    """One to three numbers or words are others."""
    for _ in range(int(rng.integers(1, 4))):
        found = list(re.finditer(rb"[\w.+-]+", content))
        if not found:
            break
        place = found[int(rng.integers(len(found)))]
        content = content[: place.start()] + WORDS[int(rng.integers(len(WORDS)))] + content[place.end() :]
    return content


def swap_lines(rng: np.random.Generator, content: bytes) -> bytes:
    """Two lines change places, or one is missing or there twice."""
    lines = content.splitlines(keepends=True)
    i, j = (int(n) for n in rng.integers(len(lines), size=2))
    what = int(rng.integers(3))
    if what == 0:
        lines[i], lines[j] = lines[j], lines[i]
    elif what == 1:
        del lines[i]
    else:
        lines.insert(j, lines[i])
    return b"".join(lines)


def other_encoding(rng: np.random.Generator, content: bytes) -> bytes:
    """Saved by another editor."""
    text = content.decode("utf-8", "replace")
    return [lambda: b"\xef\xbb\xbf" + content, lambda: text.encode("utf-16"), lambda: content.replace(b"\n", b"\r\n")][
        int(rng.integers(3))
    ]()


BINARY: tuple[Mutation, ...] = (flip_bits, flip_bits, flip_bits, cut, zero_block, drop_block, repeat_block, noise)
TEXT: tuple[Mutation, ...] = (flip_bits, replace_words, replace_words, replace_words, swap_lines, cut, other_encoding, drop_block)


def mutate(rng: np.random.Generator, content: bytes) -> bytes:
    """The content changed in one way, as text where it is text."""
    is_text = b"\0" not in content[:4000]
    choices = TEXT if is_text else BINARY
    return choices[int(rng.integers(len(choices)))](rng, content) if content else noise(rng, content)
