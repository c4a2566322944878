"""A strict parser of ENVI headers: what it cannot understand it refuses, with file and line."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from hyperval.data import Array
from hyperval.errors import needed, reader, refusal, refuse
from hyperval.storage import content_of, decoded, number_of

MAX_HEADER_BYTES = 1 << 20
MAX_KEYS = 1000
MAX_WORDS = 40  # characters of a byte order in words

# ENVI data type code -> NumPy kind and size. Complex types (6, 9) have no meaning here.
DATA_TYPES = {1: "u1", 2: "i2", 3: "i4", 4: "f4", 5: "f8", 12: "u2", 13: "u4", 14: "i8", 15: "u8"}
DATA_SUFFIXES = ("", ".img", ".dat", ".raw", ".bil", ".bsq", ".bip", ".rad", ".cub", ".sli", ".lib")
INTERLEAVES = ("bsq", "bil", "bip")
# Words that have one meaning; "host" alone and "ieee" alone have two.
_ORDER_WORDS = {
    0: r"(host\s*)?\(?intel\)?|lsf|ieee-le|little([- ]endian)?|0\s*\(.*(intel|little).*\)",
    1: r"network(\s*\(ieee\))?|msf|ieee-be|big([- ]endian)?|motorola|1\s*\(.*(ieee|network|big).*\)",
}


@dataclass(frozen=True)
class EnviHeader:
    """The content of one ENVI header.

    Attributes
    ----------
    path : the header file
    samples, lines, bands : size of the image
    data_type : ENVI code, a key of ``DATA_TYPES``; 0 where the sidecar of a GeoTIFF states none
    interleave : "bsq", "bil" or "bip" ("tif" for the sidecar of a GeoTIFF)
    byte_order : 0 little-endian, 1 big-endian
    header_offset : bytes before the first value
    file_type : as in the file, "" when absent
    entries : every key in lower case with its text, braces taken off
    line_of : line number (1-based) of every key
    notes : what was assumed, such as a byte order that the file leaves out
    """

    path: Path
    samples: int
    lines: int
    bands: int
    data_type: int
    interleave: str
    byte_order: int
    header_offset: int
    file_type: str = ""
    entries: Mapping[str, str] = field(default_factory=dict)
    line_of: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def dtype(self) -> np.dtype:
        """Type of one stored value, byte order included."""
        return np.dtype("<>"[self.byte_order] + DATA_TYPES[self.data_type])

    @property
    def expected_bytes(self) -> int:
        """Size of the data file that the header describes, in exact integers."""
        return self.header_offset + self.samples * self.lines * self.bands * self.dtype.itemsize

    def where(self, key: str) -> str:
        """``file:line`` of a key, or the file when the key is absent."""
        return f"{self.path}:{self.line_of[key]}" if key in self.line_of else str(self.path)

    def text(self, key: str) -> str | None:
        """Text of an entry, None when it is absent or empty."""
        return self.entries.get(key, "").strip() or None

    def strings(self, key: str) -> tuple[str, ...] | None:
        """A comma-separated entry as text, None when it is absent or empty."""
        value = self.text(key)
        return None if value is None else tuple(part.strip() for part in value.split(","))

    @property
    def band_names(self) -> tuple[str, ...]:
        """The names of the bands; none where there are not as many of them as bands."""
        names = self.strings("band names") or ()
        return names if len(names) == self.bands else ()

    def numbers(self, key: str, count: int | None = None, *, each: bool = True) -> Array | None:
        """A comma-separated entry as finite numbers, None when it is absent or empty.

        ``each``: there must be ``count`` of them; else one may stand for all.

        Raises
        ------
        InputError : an item is no number or not finite, or another number of them.
        """
        parts = self.strings(key)
        if parts is None:
            return None
        if count is not None and len(parts) == 1 < count == len(parts[0].split()):  # blanks in place of commas
            parts = tuple(parts[0].split())
        if parts[-1] == "" and len(parts) > 1:  # a comma before the closing brace
            parts = parts[:-1]
        out = np.array([number_of(part) for part in parts])
        for i in np.flatnonzero(~np.isfinite(out)):
            kind = "finite" if np.isinf(out[i]) or "nan" in parts[i].lower() else "a number"
            raise refusal("header.item", self.where(key), item=i + 1, key=key, kind=kind, text=parts[i][:40])
        unlike = count not in (None, out.size) and (each or out.size > 1)
        refuse(unlike, "header.count", self.where(key), key=key, size=out.size, count=count)
        return out

    def number(self, key: str) -> float | None:
        """A single number, None when the entry is absent; NaN and infinity are passed on."""
        value = self.text(key)
        number = None if value is None else number_of(_bare(value).rstrip(", "))
        wrong = number != number and "nan" not in str(value).lower()
        refuse(wrong, "header.number", self.where(key), key=key, text=str(value)[:40])
        return number


def header_beside(data: Path) -> Path | None:
    """The header of a data file: ``name.img.hdr`` or ``name.hdr``; None when there is none.

    ``name.hdr`` is that of an image: of no table ``name.csv``, nor of a ``name.glt`` beside its own ``name.glt.hdr``.

    >>> from tempfile import TemporaryDirectory
    >>> with TemporaryDirectory() as folder:
    ...     image, table, *headers = (Path(folder) / name for name in ("x", "x.glt", "x.hdr", "x.glt.hdr"))
    ...     _ = [header.touch() for header in headers]
    ...     [header_beside(of).name for of in (image, table)]
    ['x.hdr', 'x.glt.hdr']
    """
    ends = (".hdr", ".HDR")
    headers = sorted(p for end in ends if (p := data.with_name(data.name + end)).is_file())
    if data.suffix.lower() in DATA_SUFFIXES or not (headers or data.suffix.lower() in (".csv", ".txt")):
        headers += sorted(p for p in {*map(data.with_suffix, ends)} - {data, *headers} if p.is_file())
    # One file under two names on a file system that ignores case is one header.
    unique = {p.resolve().stat().st_ino: p for p in reversed(headers)}
    refuse(len(unique) > 1, "header.two", data, names=", ".join(p.name for p in headers))
    return next(iter(unique.values()), None)


def data_beside(header: Path) -> Path:
    """The data file of a header; InputError unless there is one alone."""
    stem, beside = header.stem, sorted(header.parent.iterdir())
    found = [p for p in beside if p.name.startswith(stem) and p.name[len(stem) :].lower() in DATA_SUFFIXES]
    refuse(len(found) != 1, "image.data_files", header, names=", ".join(p.name for p in found) or "none")
    return found[0]


@reader
def read_header(path: Path, *, sidecar: bool = False) -> EnviHeader:
    """Read an ENVI header file.

    Parameters
    ----------
    path : the .hdr file
    sidecar : True for a header that lies beside a GeoTIFF: sizes are then enough, as the GeoTIFF has its own layout

    A header without byte order is little-endian, as for ENVI, GDAL and SPy, and that is noted; so are a byte order
    in words, a header in UTF-16 and a key that stands twice and says the same.

    Raises
    ------
    InputError : no such file, larger than 1 MiB, not a header, or anything in it that is not
        understood: a key that stands twice and differs, an open brace, an unknown interleave, byte order or data
        type, sizes that are no positive integers, compressed data.
    """
    path = Path(path)
    raw = content_of(path, ("header.none", "header.large"), most=MAX_HEADER_BYTES)
    header = parse_header(decoded(raw), path, sidecar=sidecar)
    return replace(header, notes=("the header is written in UTF-16", *header.notes)) if b"\0" in raw[:8] else header


def parse_header(text: str, path: Path, *, sidecar: bool = False) -> EnviHeader:
    """Parse header text by the rules of :func:`read_header`; ``path`` stands in messages."""
    entries, line_of, notes = _entries(text, str(path))

    where = EnviHeader(path, 0, 0, 0, 0, "", 0, 0, line_of=line_of).where

    def integer(key: str, default: str | None = None, least: int = 0) -> int:
        value = needed(entries.get(key, default), "header.missing", path, key=key)
        bare, kind = _bare(value), "a positive integer" if least == 1 else "an integer of 0 or more"
        wrong = not re.fullmatch(r"[+-]?[0-9]{1,18}", bare) or int(bare) < least
        refuse(wrong, "header.integer", where(key), key=key, text=bare[:40], kind=kind)
        return int(bare)

    samples, lines, bands = (integer(key, least=1) for key in ("samples", "lines", "bands"))
    data_type = integer("data type", "0" if sidecar else None)
    if data_type not in DATA_TYPES and not (sidecar and "data type" not in entries):
        types = ", ".join(f"{code} ({np.dtype(name).name})" for code, name in DATA_TYPES.items())
        kind = " (complex)" if data_type in (6, 9) else ""
        raise refusal("header.type", where("data type"), code=data_type, kind=kind, known=types)
    byte_order, remark = _byte_order(entries.get("byte order"), where("byte order"))
    if remark and data_type not in (0, 1):  # a single byte has no order
        notes.append(remark)
    refuse("interleave" not in entries and bands > 1 and not sidecar, "header.missing", path, key="interleave")
    # A single band has one order only.
    interleave = _bare(entries.get("interleave", "tif" if sidecar else "bsq")).lower().replace("tiff", "tif")
    allowed = (*INTERLEAVES, "tif") if sidecar else INTERLEAVES
    fields = {"interleave": interleave, "allowed": ", ".join(allowed)}
    refuse(interleave not in allowed, "header.interleave", where("interleave"), **fields)
    refuse(integer("file compression", "0") != 0, "header.compressed", where("file compression"))
    for key in ("major frame offsets", "minor frame offsets"):
        offset = any(part.strip() not in ("", "0") for part in entries.get(key, "").split(","))
        refuse(offset, "header.frames", where(key), key=key)
    layout = samples, lines, bands, data_type, interleave, byte_order, integer("header offset", "0")
    return EnviHeader(path, *layout, _bare(entries.get("file type", "")), entries, line_of, tuple(notes))


def _byte_order(value: str | None, where: str) -> tuple[int, str]:
    """0 or 1, and a note where the header says it in words or not at all."""
    if value is None:
        return 0, "the header states no byte order: read as little-endian"
    bare = _bare(value)
    if bare in ("0", "1"):
        return int(bare), ""
    for order, words in _ORDER_WORDS.items():
        if len(bare) <= MAX_WORDS and re.fullmatch(words, bare.lower()):
            return order, f"byte order {bare!r}: read as {order}, {('little', 'big')[order]}-endian"
    raise refusal("header.order", where, text=bare[:40])


def _entries(text: str, name: str) -> tuple[dict[str, str], dict[str, int], list[str]]:
    """Keys with their texts and lines, and notes on keys that occur twice; linear in the length of the text."""
    entries, line_of, notes = dict[str, str](), dict[str, int](), list[str]()

    def add(key: str, value: str, number: int) -> None:
        if key in entries:
            a, b = _squeezed(entries[key]), _squeezed(value)
            differ = next((i for i, (x, y) in enumerate(zip(a, b, strict=False)) if x != y), min(len(a), len(b)))
            values = " against ".join(repr(version[max(0, differ - 20) : differ + 30]) for version in (a, b))
            refuse(a != b, "header.twice", f"{name}:{number}", key=key, first=line_of[key], told=values)
            notes.append(f"header: {key!r} occurs twice with the same value (lines {line_of[key]} and {number})")
        else:
            line_of[key], entries[key] = number, value
        refuse(len(entries) > MAX_KEYS, "header.keys", f"{name}:{number}", most=MAX_KEYS)

    lines = text.rstrip("\0\x1a \t\r\n").splitlines()  # some programs fill up a block, or mark the end of the text
    refuse(not lines or lines[0].strip() != "ENVI", "header.first", f"{name}:1")
    key, start, depth, parts = "", 0, 0, list[str]()
    for number, line in enumerate(map(str.strip, lines[1:]), start=2):
        if not line or line.startswith(";"):
            continue
        if depth == 0:
            start, parts = number, []
            if line.startswith("{") and entries.get(key) == "":  # its list begins on the line below
                start = line_of.pop(key)
                del entries[key]
            else:
                key, equals, value = line.partition("=")
                key, value = " ".join(key.split()).lower(), value.strip()
                refuse(not equals or not key, "header.form", f"{name}:{number}", text=line[:60])
                if not value.startswith("{"):
                    add(key, value, number)
                    continue
                line = value
        depth += line.count("{") - line.count("}")
        parts.append(line)
        if depth <= 0:
            depth, listed_text = 0, "\n".join(parts)
            listed, rest = listed_text[: listed_text.rindex("}")], listed_text[listed_text.rindex("}") + 1 :].strip()
            refuse(rest and not rest.startswith(";"), "header.behind", f"{name}:{number}", text=rest[:40])
            add(key, listed[1:].strip(), start)
    refuse(depth, "header.open", f"{name}:{start}", key=key)
    return entries, line_of, notes


def _squeezed(value: str) -> str:
    """A value without the blanks that programs set in one way or another."""
    return re.sub(r"\s*([{}\[\](),=])\s*", r"\1", " ".join(value.split()))


def _bare(value: str) -> str:
    """A one-word value without a trailing comment."""
    return value.split(";")[0].strip()
