"""Damaged files: the same sample and number give the same damage."""

from __future__ import annotations

import random
import re
import struct

NUMBERS = (
    b"0", b"-1", b"nan", b"inf", b"-inf", b"1e308", b"1e-308", b"-0", b"", b"1e400", b"2147483648", b"4294967296",
    b"18446744073709551616", b"9" * 4301, b"0x10", b"1_000", b"1,5", b"1.2.3", b"\xd9\xa1", b"1e", b"--1", b"true",
)  # fmt: skip
TOKENS = (
    b"\0", b"\r", b"\n", b"\r\n", b"\xef\xbb\xbf", b"\xff\xfe", b"\xed\xa0\x80", b"{", b"}", b"[", b"]", b'"', b"'",
    b":", b",", b";", b"&a", b"*a", b"!!python/object", b"<!DOCTYPE a [<!ENTITY b 'c'>]>", b"&b;", b"../", b"%s",
    b"\t", b"\x1a", b"[" * 3000, b"{a: " * 100,
)  # fmt: skip
WORDS = tuple(
    struct.pack(form, value)
    for form, values in (
        ("<B", (0, 1, 127, 128, 255)), ("<H", (0, 1, 0x7FFF, 0x8000, 0xFFFF)), (">H", (1, 0x7FFF, 0xFFFF)),
        ("<I", (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF)), (">I", (1, 0x7FFFFFFF, 0xFFFFFFFF)),
        ("<Q", (0, 1, 0x7FFFFFFFFFFFFFFF, 0xFFFFFFFFFFFFFFFF)),
        ("<f", (float("nan"), float("inf"), 1e38, 1e-40, -1.0)),
        ("<d", (float("nan"), float("inf"), 1e300, 2e-192, -1.0)),
    )
    for value in values
)  # fmt: skip
_NUMBER = re.compile(rb"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?")
GREATEST = 4


def mutant(content: bytes, sample: str, number: int) -> bytes:
    """The content with one to four damages, drawn from the sample's name and the number."""
    draw = random.Random(f"{sample} {number}")  # noqa: S311 - repeatable, not secret
    raw = bytearray(content)
    for _ in range(draw.randint(1, GREATEST)):
        draw.choice(DAMAGES)(raw, draw)
    return bytes(raw)


def _place(raw: bytearray, draw: random.Random) -> int:
    return draw.randrange(len(raw)) if raw else 0


def _span(raw: bytearray, draw: random.Random) -> slice:
    start = _place(raw, draw)
    return slice(start, start + min(len(raw) - start, int(2 ** draw.uniform(0, 9))))


def flip(raw: bytearray, draw: random.Random) -> None:
    """One bit the other way."""
    if raw:
        raw[_place(raw, draw)] ^= 1 << draw.randrange(8)


def overwrite(raw: bytearray, draw: random.Random) -> None:
    """One byte anew."""
    if raw:
        raw[_place(raw, draw)] = draw.randrange(256)


def word(raw: bytearray, draw: random.Random) -> None:
    """An extreme number in binary over what stands there."""
    new = draw.choice(WORDS)
    start = _place(raw, draw)
    raw[start : start + len(new)] = new


def clear(raw: bytearray, draw: random.Random) -> None:
    """A span of zeros, ones or chance."""
    span = _span(raw, draw)
    size = span.stop - span.start
    raw[span] = draw.choice((bytes(size), b"\xff" * size, draw.randbytes(size)))


def remove(raw: bytearray, draw: random.Random) -> None:
    """A span less."""
    del raw[_span(raw, draw)]


def repeat(raw: bytearray, draw: random.Random) -> None:
    """A span twice or often."""
    span = _span(raw, draw)
    raw[span.start : span.start] = raw[span] * draw.choice((1, 1, 2, 50))


def move(raw: bytearray, draw: random.Random) -> None:
    """A span at another place too."""
    part = raw[_span(raw, draw)]
    start = _place(raw, draw)
    raw[start : start + len(part)] = part


def cut(raw: bytearray, draw: random.Random) -> None:
    """The end lost."""
    del raw[_place(raw, draw) :]


def insert(raw: bytearray, draw: random.Random) -> None:
    """A sign with a meaning to some format."""
    start = _place(raw, draw)
    raw[start:start] = draw.choice(TOKENS)


def number(raw: bytearray, draw: random.Random) -> None:
    """A number in text by a hostile one."""
    places = list(_NUMBER.finditer(raw))
    if places:
        chosen = draw.choice(places)
        raw[chosen.start() : chosen.end()] = draw.choice(NUMBERS)


def line(raw: bytearray, draw: random.Random) -> None:
    """A line lost, twice, or in another's place."""
    lines = raw.split(b"\n")
    i, j = draw.randrange(len(lines)), draw.randrange(len(lines))
    kind = draw.randrange(3)
    if kind == 0:
        del lines[i]
    elif kind == 1:
        lines.insert(j, lines[i])
    else:
        lines[i], lines[j] = lines[j], lines[i]
    raw[:] = b"\n".join(lines)


DAMAGES = (flip, overwrite, word, clear, remove, repeat, move, cut, insert, number, line)
