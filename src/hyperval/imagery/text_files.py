"""Text of files beside an image, gzipped or not: a table, XML."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree

from hyperval.errors import InputError, reader
from hyperval.paths import MAX_TEXT_BYTES, read_text

_DECIMAL_COMMA = re.compile(r"[-+]?[0-9]+,[0-9]+$")


@reader
def read_xml(path: Path, most: int = MAX_TEXT_BYTES) -> ElementTree.Element:
    """The root of an XML file of at most so many bytes.

    Raises
    ------
    InputError : larger, with a DOCTYPE or ENTITY, or no XML.
    """
    text = read_text(path, most)
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise InputError("a DOCTYPE or ENTITY is not allowed", where=str(path))
    try:
        # The document type is refused above, so no entity can be declared.
        return ElementTree.fromstring(re.sub(r"^<\?xml[^>]*\?>", "", text.lstrip()))  # noqa: S314
    except ElementTree.ParseError as error:
        raise InputError(f"not valid XML: {error}", where=f"{path}:{error.position[0]}") from error


@reader
def read_table(path: Path, known: Collection[str] = ()) -> tuple[list[str], list[tuple[int, dict[str, str]]]]:
    """Column names of a CSV file, and its rows with their line numbers; short rows are filled with "".

    Columns are divided by commas, or by semicolons (then a comma may be the decimal sign) or tabs where the first
    line holds no comma.  The ``known`` columns may be written in any case.
    """
    text = read_text(path)
    first = text.split("\n", 1)[0]
    divider = next((d for d in ",;\t" if d in first), ",")
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=divider, skipinitialspace=divider != "\t")
    try:
        fields = [f.strip() for f in next(reader, [])]
        fields = [f.lower() if f.lower() in known else f for f in fields]
        if len(set(fields)) < len(fields):
            raise InputError("two columns have the same name", where=f"{path}:1")
        rows = []
        for cells in reader:
            if len(cells) > len(fields):
                raise InputError(f"{len(cells)} cells for {len(fields)} columns", where=f"{path}:{reader.line_num}")
            if any(cell.strip() for cell in cells):
                padded = [cell.strip() for cell in cells] + [""] * (len(fields) - len(cells))
                if divider == ";":
                    padded = [c.replace(",", ".") if _DECIMAL_COMMA.match(c) else c for c in padded]
                rows.append((reader.line_num, dict(zip(fields, padded, strict=True))))
    except csv.Error as error:
        raise InputError(f"not a CSV file: {error}", where=f"{path}:{reader.line_num}") from error
    return fields, rows
