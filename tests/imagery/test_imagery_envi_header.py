"""The header parser: what it understands, and what it refuses with file and line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hyperval.envi_header import MAX_HEADER_BYTES, parse_header, read_header
from hyperval.errors import HypervalError, InputError

BASE = {
    "samples": "5", "lines": "6", "bands": "4", "header offset": "0", "data type": "2", "interleave": "bil",
    "byte order": "0",
}  # fmt: skip
NAME = Path("a.hdr")


def header_text(**changes: str | None) -> str:
    entries = BASE | {k.replace("_", " "): v for k, v in changes.items()}
    return "ENVI\n" + "".join(f"{k} = {v}\n" for k, v in entries.items() if v is not None)


def test_fields_and_lines_are_read():
    header = parse_header(header_text(wavelength="{ 1.5,\n 2.5, 3,4 }", note="a = b = c"), NAME)
    assert (header.samples, header.lines, header.bands, header.interleave) == (5, 6, 4, "bil")
    assert header.dtype == np.dtype("<i2")
    assert header.numbers("wavelength", 4).tolist() == [1.5, 2.5, 3.0, 4.0]
    assert header.text("note") == "a = b = c"  # "=" inside a value belongs to the value
    assert header.where("wavelength") == "a.hdr:9"
    assert header.line_of["note"] == 11
    assert set(header.extras) == {"wavelength", "note"}


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "latin-1"])
def test_encodings(tmp_path: Path, encoding: str):
    path = tmp_path / "a.hdr"
    path.write_bytes(header_text(description="{Größe µm}").encode(encoding))
    assert read_header(path).text("description") == "Größe µm"


@pytest.mark.parametrize(("encoding", "mark"), [("utf-16", b""), ("utf-16-le", b""), ("utf-16-be", b"\xfe\xff")])
def test_a_header_in_utf_16_is_read_and_noted(tmp_path: Path, encoding: str, mark: bytes):
    path = tmp_path / "a.hdr"
    path.write_bytes(mark + header_text(description="{Größe µm}").encode(encoding))
    header = read_header(path)
    assert (header.text("description"), header.notes) == ("Größe µm", ("the header is written in UTF-16",))
    path.write_bytes(path.read_bytes()[:-1])  # half a character
    with pytest.raises(InputError, match="after the closing brace"):
        read_header(path)


@pytest.mark.parametrize(
    ("changes", "message", "where"),
    [
        ({"samples": "10.0"}, "'10.0'", ":2"),
        ({"samples": "-5"}, "positive integer", ":2"),
        ({"lines": "0"}, "positive integer", ":3"),
        ({"lines": "5_0"}, "positive integer", ":3"),
        ({"bands": "1e3"}, "positive integer", ":4"),
        ({"bands": "9" * 40}, "positive integer", ":4"),
        ({"samples": None}, "'samples' is missing", ""),
        ({"data_type": "99"}, "1 (uint8), 2 (int16)", ":6"),
        ({"data_type": "6"}, "complex", ":6"),
        ({"data_type": None}, "'data type' is missing", ""),
        ({"interleave": "xyz"}, "one of bsq, bil, bip", ":7"),
        ({"interleave": None}, "'interleave' is missing", ""),
        ({"interleave": "tif"}, "unknown interleave", ":7"),
        ({"byte_order": "9"}, "0 (little-endian) or 1", ":8"),
        ({"byte_order": "1.0"}, "unknown byte order '1.0'", ":8"),
        ({"header_offset": "-1"}, "0 or more", ":5"),
        ({"file_compression": "1"}, "compressed", ":9"),
        ({"major_frame_offsets": "{4, 0}"}, "frame offsets", ":9"),
        ({"wavelength": "{1, 2, 3, 4"}, "never closed", ":9"),
        ({"wavelength": "{1, 2} 3"}, "after the closing brace", ":9"),
        ({"wavelength": "{1\nfwhm = {2}"}, "'wavelength' is never closed", ":9"),
        ({"interleave": "bil\ngarbage"}, "not of the form", ":8"),
        ({"Samples": "7"}, "stands twice (first on line 2): '5' against '7'", ":9"),
    ],
)
def test_refused(changes: dict[str, str | None], message: str, where: str):
    text = header_text(**changes)
    with pytest.raises(InputError) as caught:
        parse_header(text, NAME)
    assert message in str(caught.value)
    assert str(caught.value).startswith(f"a.hdr{where}:")


@pytest.mark.parametrize(
    ("words", "order"),
    [
        ("Host (Intel)", 0), ("Network (IEEE)", 1), ("0 (Host (Intel))", 0), ("1 (Network (IEEE)) ; ENVI", 1),
        ("ieee-le", 0), ("IEEE-BE", 1), ("LSF", 0), ("MSF", 1), ("Little Endian", 0), ("big-endian", 1),
    ],
)  # fmt: skip
def test_a_byte_order_in_words_is_read_and_noted(words: str, order: int):
    header = parse_header(header_text(byte_order=words), NAME)
    assert header.dtype == np.dtype("<>"[order] + "i2")
    assert header.notes == (f"byte order {words.split(' ;')[0]!r}: read as {order}, {('little', 'big')[order]}-endian",)


@pytest.mark.parametrize("words", ["Host", "IEEE", "0 (big endian)", "01", "", "intel" * 100_000])
def test_a_byte_order_of_two_meanings_or_none_is_refused(words: str):
    with pytest.raises(InputError, match=r"a\.hdr:8: unknown byte order.*(?s:.)*write 0 where"):
        parse_header(header_text(byte_order=words), NAME)


def test_a_key_that_stands_twice_and_says_the_same_is_noted():
    text = header_text(a="{x[ 1,2 ],  y}") + "a = {x[1, 2],\n y}\n"
    header = parse_header(text, NAME)
    assert header.text("a") == "x[ 1,2 ],  y"
    assert header.notes == ("header: 'a' stands twice and says the same (lines 9 and 10)",)
    with pytest.raises(InputError, match=r"a\.hdr:10: .*'x\[1,2\],y' against 'x\[1,3\],y'"):
        parse_header(text.replace("[1, 2]", "[1, 3]"), NAME)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("{1, NaN, 3, 4}", "item 2 .* not finite"),
        ("{1, inf, 3, 4}", "not finite"),
        ("{1, two, 3, 4}", "item 2 .* not a number: 'two'"),
        ("{1,5, 2,5, 3,5, 4,5}", "8 values for 4 bands"),  # decimal commas
        ("{1, 2}", "2 values for 4 bands"),
        ("{1, 2_0, 3, 4}", "not a number"),
        ("{1, , 3, 4}", "not a number"),
        ("{1 2 3}", "not a number"),  # of four: blanks take the place of commas where the count is right
    ],
)
def test_number_lists(text: str, message: str):
    header = parse_header(header_text(wavelength=text), NAME)
    with pytest.raises(InputError, match=message):
        header.numbers("wavelength", 4)


def test_larger_than_the_cap_is_refused_unread(tmp_path: Path):
    path = tmp_path / "a.hdr"
    text = header_text() + "; "
    path.write_text(text + "x" * (MAX_HEADER_BYTES - len(text)))
    assert read_header(path).samples == 5  # exactly at the cap
    path.write_text(text + "x" * (MAX_HEADER_BYTES - len(text) + 1))
    with pytest.raises(InputError, match="larger than 1048576 bytes"):
        read_header(path)


@pytest.mark.parametrize("inside", [False, True])
def test_a_header_of_400000_lines_is_read(inside: bool):
    # Inside a brace and outside: a reader that is quadratic in the number of lines needs half a minute.
    filler = "x\n" * 400_000
    text = header_text() + (f"description = {{{filler}}}\n" if inside else ";\n" * 400_000)
    assert parse_header(text, NAME).samples == 5


@given(st.text(max_size=300))
@settings(max_examples=200)
def test_any_text_gives_a_header_or_a_clear_error(text: str):
    for body in (text, "ENVI\n" + text, header_text() + text):
        try:
            samples = parse_header(body, NAME).samples
        except HypervalError:  # anything else fails the test
            samples = 1
        assert samples >= 1


@pytest.mark.parametrize("text", ["", "XENVI\n", "samples = 5\n", "\x00\x01\x02"])
def test_what_is_no_header(text: str):
    with pytest.raises(InputError, match="first line is not 'ENVI'"):
        parse_header(text, NAME)


@pytest.mark.parametrize(
    ("changes", "interleave", "notes"),
    [
        ({"interleave": "Bil"}, "bil", ()),
        ({"interleave": "BSQ ; band sequential"}, "bsq", ()),
        ({"byte_order": None}, "bil", ("the header states no byte order: read as little-endian",)),
        ({"byte_order": None, "data_type": "1"}, "bil", ()),  # a byte has none
    ],
)
@pytest.mark.parametrize("end", ["", "\0" * 300, "\x1a", "; a comment = 1\n\n"])
@pytest.mark.parametrize("newline", ["\n", "\r\n"])
def test_case_comments_ends_of_lines_and_of_text(changes, interleave, notes, end, newline):
    text = (header_text(**changes).replace("samples", "SAMPLES ") + end).replace("\n", newline)
    header = parse_header(text, NAME)
    assert (header.samples, header.interleave, header.notes) == (5, interleave, notes)


def test_what_may_be_left_out_and_sizes_beyond_64_bits_of_float():
    assert parse_header(header_text(bands="1", interleave=None), NAME).interleave == "bsq"
    header = parse_header("ENVI\nsamples = 5\nlines = 6\nbands = 4\n", NAME, sidecar=True)
    assert (header.samples, header.lines, header.bands, header.interleave) == (5, 6, 4, "tif")
    header = parse_header(header_text(samples="999999937", lines="999999893", bands="7", header_offset="3"), NAME)
    assert header.expected_bytes == 3 + 999999937 * 999999893 * 7 * 2
