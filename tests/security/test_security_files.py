"""Files and references from somebody else.

Whatever stands in a file, what comes back is its content or one clear error, and soon; a reference does not reach
beyond the data directory, nor open an address.
"""

import ast
import gzip
import importlib
import inspect
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

import hyperval
from hyperval import cli, datasets
from hyperval.collection import BandTableFile
from hyperval.errors import HypervalError, InputError, UsageError, reader

PACKAGE = Path(hyperval.__file__).parent
TABLES = yaml.safe_load(Path(__file__).with_name("contents.yaml").read_text("utf-8"))
STARTS = ("read_", "load_", "open_")
PATHS = {"path", "name_or_path", "table"}
# Several files at once, of which each is read by a reader below.
JOINED = {"read_modtran_runs"}


def readers() -> dict[str, Callable[..., Any]]:
    """Every public function whose name and first argument say that it reads a file."""
    found = {}
    for source in sorted(set(PACKAGE.rglob("*.py")) - set((PACKAGE / "api").rglob("*.py"))):  # its verbs call these
        for node in ast.parse(source.read_text("utf-8")).body:
            if not isinstance(node, ast.FunctionDef) or not node.name.startswith(STARTS):
                continue
            first = next(iter(node.args.args), None)
            if first is None or first.arg not in PATHS or node.name in JOINED:
                continue
            module = ".".join(source.relative_to(PACKAGE.parent).with_suffix("").parts)
            found[f"{module}.{node.name}"] = getattr(importlib.import_module(module), node.name)
    return found


READERS = readers()
# What each needs besides the path.
MORE: dict[str, dict[str, Any]] = {
    "open_cube": {"quantity": "other"},
    "open_lookup_table": {"shape": (2, 2)},
    "open_matrix": {"kind": "MATLAB 5"},
    "open_tiff": {"header": None},
    "read_band_table": {"table": BandTableFile(path="b.txt", wavelength_unit="nm")},
    "read_targets": {"shape": (2, 2)},
    "read_regions": {"cube_shape": (2, 2)},
}
SPECTRA = gzip.compress(b"wavelength value\n" * 500)
RING = b'{"type": "Polygon", "coordinates": [[[%b, 1], [1, 1], [2, 2]]]}'
CONTENTS = (
    [text.encode("latin-1") for text in TABLES["any reader"].values()]
    + [
        bytes(4096),
        bytes(range(256)) * 8,
        b"[" * 100_000,  # JSON, deep
        b'{"MODTRAN": [{"MODTRANINPUT": ' + b"9" * 5000 + b"}]}",
        RING % (b"9" * 5000),
        SPECTRA[:60],
        SPECTRA[:-8] + bytes(8),  # another check sum
    ]
)
ENDINGS = (".yaml", ".json", ".csv", ".hdr", ".tif", ".nc", ".chn.gz")


class TooLong(BaseException):
    """Not an Exception, so that no reader takes it for damage."""


@pytest.fixture
def soon() -> Iterator[None]:
    """Ends what waits for a file that never ends; the time is for hanging alone."""

    def stop(*_: object) -> None:
        raise TooLong

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(60)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def test_every_reader_is_wrapped():
    assert len(READERS) > 25
    bare = [name for name, function in READERS.items() if not hasattr(inspect.unwrap(function), "__code__")]
    assert bare == []
    assert [name for name, function in READERS.items() if not hasattr(function, "__wrapped__")] == []
    for function in READERS.values():  # what the wrapper would take for a damaged file
        assert inspect.signature(function).bind(Path(), **MORE.get(function.__name__, {}))


def test_the_wrapper_says_what_and_where_and_passes_clear_errors_on(tmp_path):
    @reader
    def divides(path: Path, by: int) -> float:
        if by == 1:
            raise InputError("clear")
        return 1 / by

    assert divides(tmp_path, 2) == 0.5
    with pytest.raises(InputError, match=r"named: damaged, or not .* \(ZeroDivisionError: division by zero\)"):
        divides(tmp_path / "named", by=0)
    with pytest.raises(InputError, match=r"^clear$"):
        divides(tmp_path, by=1)


def exit_code(function: Callable[..., Any], path: Path) -> int:
    """Of reading the file as a command would; 0 where it can be read."""
    try:
        function(path, **MORE.get(function.__name__, {}))
    except HypervalError as error:
        return error.exit_code
    return 0


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_clear_errors(name, tmp_path, soon):
    # What is loaded is YAML, whatever its name ends in.
    endings = ENDINGS[:1] if READERS[name].__name__.startswith("load_") else ENDINGS
    for number, content in enumerate(CONTENTS):
        for ending in endings:
            path = tmp_path / f"a{number}{ending}"
            path.write_bytes(content)
            assert exit_code(READERS[name], path) in (0, 2, 3), path


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", READERS)
def test_pipes_and_devices_are_not_waited_for(name, tmp_path, soon):
    for ending in ENDINGS:
        pipe = tmp_path / f"pipe{ending}"
        os.mkfifo(pipe)
        keep = os.open(pipe, os.O_RDWR | os.O_NONBLOCK)  # somebody who writes nothing and does not close
        link = tmp_path / f"zero{ending}"
        link.symlink_to("/dev/zero")
        try:
            assert {exit_code(READERS[name], path) for path in (pipe, link)} <= {2, 3}
        finally:
            os.close(keep)


@pytest.mark.parametrize("content", [b"just plain words\n", b"- a\n- b\n", b"7\n"])
def test_plain_text_as_a_campaign_is_a_mistake_of_the_user(content, tmp_path, capsys):
    (tmp_path / "c.yaml").write_bytes(content)
    assert cli.run(["validate", str(tmp_path / "c.yaml"), "-o", str(tmp_path / "out")]) == 2
    assert "holds no keys" in capsys.readouterr().err


LONG = 1_000_000
SLOW = {
    "digits": b"nm,rho\n400,0.1\n500,0." + b"9" * LONG + b"x\n",
    "digits without a point": b"nm,rho\n400," + b"9" * LONG + b"x\n",
    "blanks in a title": b"a cm" + b" " * LONG + b",rho\n400,0.1\n500,0.2\n",
    "blanks in a plot": b"ENVI ASCII Plot File\nColumn 1: a" + b" " * LONG + b"b\nColumn 2: c\n400 1\n500 2\n",
    "signs before a key": (b";" * 1000 + b"\n") * 900 + b"nm,rho\n400,0.1\n500,0.2\n",
}


@pytest.mark.parametrize("content", SLOW.values(), ids=SLOW)
def test_long_lines_take_no_longer_than_their_length(content, tmp_path, soon):
    (tmp_path / "a.txt").write_bytes(content)
    assert exit_code(READERS["hyperval.spectra.read.read_spectrum"], tmp_path / "a.txt") in (0, 2, 3)


MISNAMED = b'{"crs": {"properties": {"name": "EPSG:1,5"}}, ' + (RING % b"0")[1:]


@pytest.mark.parametrize(
    ("function", "name", "content", "message"),
    [
        ("spectra.read.read_spectrum", "a.csv", b"name,400,500,600,700\na,1\rb,2,3,4,5\n", "2 cells"),
        ("paths.read_table", "a.csv", b"line,sample\n1,2\r3,4,5\n", "3 cells for 2 columns"),
        ("imagery.regions.read_regions", "a.json", RING % (b"9" * 4400), "damaged.*Exceeds the limit"),
        ("imagery.regions.read_regions", "a.json", MISNAMED, "unknown coordinate system 'EPSG:1,5'"),
        ("config.load_yaml", "a.yaml", b"schema: 1\nseed: " + b"9" * 4400, "a.yaml:2: a number of 4400 digits"),
        (
            "atmosphere.modtran.read_channels",
            "a.chn.gz",
            SPECTRA[:20] + b"x" * 90,
            "cannot read: Error -3 while decomp",
        ),
    ],
)
def test_what_mutants_met_is_foreseen(function, name, content, message, tmp_path):
    (tmp_path / name).write_bytes(content)
    read = READERS[f"hyperval.{function}"]
    with pytest.raises(HypervalError, match=message):
        read(tmp_path / name, **MORE.get(read.__name__, {}))


# References -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("reference", "leaves"), TABLES["references"])
def test_a_reference_stays_inside_and_is_no_address(reference, leaves, tmp_path, monkeypatch):
    (tmp_path / "secret").write_text("x")
    (tmp_path / "data").mkdir()
    monkeypatch.setenv("HYPERVAL_DATA", str(tmp_path / "data"))
    with pytest.raises(UsageError, match="leaves the data directory" if leaves else None):
        datasets.resolve(reference, tmp_path)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputError, match="pipe"):
        datasets.resolve("pipe", tmp_path)


@given(st.text(max_size=60))
@example("data:" + "../" * 20)
def test_any_reference_is_a_file_below_the_root_or_an_error(reference):
    root = Path(__file__).parent
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HYPERVAL_DATA", str(root))
        patch.setenv("HYPERVAL_CACHE", str(root / "none"))
        try:
            found = datasets.resolve("data:" + reference)
        except HypervalError as error:
            assert error.exit_code in (2, 3)  # noqa: PT017 - both ends are asserted
        else:
            assert found.resolve().is_relative_to(root)
