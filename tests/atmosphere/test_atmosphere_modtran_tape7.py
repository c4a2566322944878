"""tape7 files: fixed columns, three modes, several cases, and what is refused."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from modtran_samples import RADIANCE_WIDTHS, tape7

from hyperval.atmosphere import RADIANCE_COLUMNS, modtran, read_tape7
from hyperval.errors import InputError


def write(tmp_path, text, name="tape7"):
    path = tmp_path / name
    path.write_text(text)
    return path


def test_several_cases_with_blank_fields_packed_or_not(tmp_path):
    first, second = read_tape7(write(tmp_path, tape7((0.0, 0.5))))
    assert (first.albedo, second.albedo, first.columns["FREQ"][0]) == (0.0, 0.5, 4000.0)
    assert np.all(np.isnan(first.columns["REF_SOL"]))  # blank in the file, not shifted from a neighbour
    assert np.all(first.columns["DEPTH"] == 0.105)
    with gzip.open(tmp_path / "tape7.gz", "wb") as stream:
        stream.write(tape7((0.0, 0.5)).replace("\n", "\r\n").encode())
    np.testing.assert_equal(read_tape7(tmp_path / "tape7.gz")[0].columns, first.columns)
    # Without the card the albedo is what the emissivity leaves.
    assert read_tape7(write(tmp_path, tape7((0.3,), albedo_stated=False)))[0].albedo == 0.3


def changed_line(text, number, change):
    lines = text.split("\n")
    lines[number - 1] = change(lines[number - 1])
    return "\n".join(lines)


@pytest.mark.parametrize(
    ("harm", "said"),
    [
        (lambda t: changed_line(t, 5, lambda x: x[:19] + "*" * 11 + x[30:]), r"tape7:5: '\*+' in columns 20-30"),
        (lambda t: changed_line(t, 5, lambda x: x[:52] + "NaN".rjust(11) + x[63:]), r"tape7:5: .*not finite"),
        (lambda t: changed_line(t, 6, lambda x: " 4000.00" + x[8:]), r"tape7:6: wavenumber 4000"),
        (lambda t: changed_line(t, 6, lambda x: " " * 8 + x[8:]), r"tape7:6: wavenumber nan"),
        (lambda t: changed_line(t, 4, lambda x: x + "   1.0"), r"tape7:4: text beyond column 162"),
        (lambda t: t.replace("GRND_RFLT", "GRND_REFL"), r"tape7:3: unknown columns"),
        (lambda t: t.replace(" -9999.\n", ""), r"tape7:3: the table has no end"),
        (lambda t: "\n".join(t.split("\n")[:3]) + "\n -9999.\n", r"tape7:3: a table without rows"),
        (lambda t: t + "left over\n", r"a case without a table"),
        (lambda t: "nothing\n" * 5, "no table"),
    ],
)
def test_malformed_file_is_refused_with_its_line(tmp_path, harm, said):
    text = tape7((0.0,))
    harmed = harm(text)
    assert harmed != text
    with pytest.raises(InputError, match=said):
        read_tape7(write(tmp_path, harmed))


@pytest.mark.parametrize("part", ["PTH_THRML", "SURF_EMIS", "SOL_SCAT", "GRND_RFLT"])
def test_total_that_is_not_the_sum_of_its_parts_is_refused(tmp_path, part):
    text = tape7((0.5,), emission=True)
    number = RADIANCE_COLUMNS.index(part)
    start = sum(RADIANCE_WIDTHS[:number])

    def change(line):
        added = float(line[start : start + 11]) + 5e-4 * float(line[96:107])  # above 9e-5 of the total
        return f"{line[:start]}{added:11.4E}{line[start + 11 :]}"

    with pytest.raises(InputError, match=r"tape7:7: TOTAL_RAD .* is not the sum"):
        read_tape7(write(tmp_path, changed_line(text, 7, change)))
    assert read_tape7(write(tmp_path, text))  # unharmed it is read


def test_a_file_too_large_is_refused_before_it_is_read_whole(tmp_path, monkeypatch):
    monkeypatch.setattr(modtran, "MAX_BYTES", 1 << 20)
    with pytest.raises(InputError, match="larger than 1 MiB"):
        read_tape7(write(tmp_path, tape7((0.0,)) + " " * (1 << 20)))
    with gzip.open(tmp_path / "bomb.gz", "wb") as stream:
        stream.write(b" " * (2 << 20))  # packs to far less than the limit
    with pytest.raises(InputError, match="larger than 1 MiB"):
        read_tape7(tmp_path / "bomb.gz")


REAL = [
    # file, rows, albedo, first wavenumber, a column and its first value
    ("modtran4_5/tape7-02", 51, 0.0, 2050.0, "PTH_THRML", 2.0416e-8),
    ("modtran4_5/tape7-02b", 51, 0.0, 2050.0, "TOT_TRANS", 0.88372636),
    ("modtran4_5/tape7-02c", 13, 0.3, 655.0, "SOL_SCAT", 8.1174e-30),
    ("modtran4_5/tape7.VISSun.gz", 11668, 0.0, 13333.0, "SING_SCAT", 4.6103e-7),
    ("modtran5_decks/OMAA_userprofile/tape5.tp7.gz", 6501, np.nan, 833.0, "GRND_RFLT", 8.3842e-7),
    ("modtran5_decks/data_path100/tape7.gz", 2001, 0.0, 12000.0, "TOA_SUN", 7.4303e-6),
]


@pytest.mark.data
@pytest.mark.parametrize(("relative", "rows", "albedo", "first", "column", "value"), REAL)
def test_real_files(data_dir, relative, rows, albedo, first, column, value):
    (case,) = read_tape7(data_dir(f"modtran/{relative}"))
    assert case.wavelength_nm.size == rows
    np.testing.assert_equal(case.albedo, albedo)
    assert case.columns["FREQ"][0] == first
    assert case.wavelength_nm[-1] == 1e7 / first
    assert case.columns[column][0] == pytest.approx(value, rel=1e-12)
    scattered, once = (np.nan_to_num(case.columns[name]) for name in ("SOL_SCAT", "SING_SCAT"))
    assert np.all(scattered >= once)  # it holds the single scattering


@pytest.mark.data
@pytest.mark.parametrize("name", ["tape7-01", "tape7-04", "tape7VISNIR5kmTrop23Vis.gz"])
def test_real_files_of_other_modes_are_refused(data_dir, name):
    with pytest.raises(InputError, match="radiance mode"):
        read_tape7(data_dir(f"modtran/modtran4_5/{name}"))
