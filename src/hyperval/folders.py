"""Folders of output: replaced whole, by one run at a time, and nothing in them is lost that is not ours.

A folder bears a list of the files that a run wrote (``.hyperval.json``); what is not in that list belongs to
the user and stays.  The new folder is made beside the old one and the two change places in one step of the file
system.  Where that cannot be (a mounted volume, the working directory, a parent that cannot be written) the new
content is made inside and changes places file by file; the file that makes it a folder of results is taken away
first and comes back last, and a change that was cut off is finished by the next run into the folder.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from hyperval.errors import HypervalError, UsageError
from hyperval.exchange import can_exchange, exchange, mount_points
from hyperval.files import umask
from hyperval.locks import Claim, claimed_by

LIST = ".hyperval.json"
RECORD = ".hyperval-made-of.json"  # what the results of a campaign were made of
LOCK = ".hyperval.lock"
PARTIAL = ".hyperval-partial"
_NEW = ".hyperval-new-"
_SWAP = ".hyperval-swap"


@dataclass(frozen=True)
class Kind:
    """A kind of output folder.

    Attributes
    ----------
    name : what it is, in words
    marker : the file without which it is none
    head : how that file begins; tells folders that were written before there was a list of files
    files : paths in such a folder that are ours
    """

    name: str
    marker: str
    head: re.Pattern[bytes]
    files: re.Pattern[str]


RESULTS = Kind(
    "results",
    "results.json",
    re.compile(rb'\{\s*"schema_version": \d+,\s*"hyperval_version": "'),
    re.compile(
        r"(?:.+/)?(?:results\.(?:csv|json)|junit\.xml|provenance\.json|products\.nc|report\.html"
        r"|table\.(?:csv|nc|parquet)|(?:figures|scores|reflectance)/[^/]+)"
    ),
)
COLLECTION = Kind(
    "a simulated collection",
    "truth.json",
    re.compile(rb'\{\s*"simulated": true,\s*"scene": \{'),
    re.compile(
        r"truth\.json|regions\.geojson|targets\.csv|panel_spectra\.csv|[^/]+_(?:rad|class|fill)\.(?:img|hdr)"
    ),
)


class Unplaced(HypervalError):
    """Results that are complete and could not be put where they belong; the message names where they are."""


POWER = Kind(
    "power tables",
    "power.csv",
    re.compile(rb"campaign,error,seen_by,"),
    re.compile(r"[^/]+\.yaml|power\.csv"),
)


_KINDS = (RESULTS, COLLECTION, POWER)


@contextmanager
def whole_folder(path: Path, kind: Kind = RESULTS) -> Iterator[Path]:
    """Give an empty folder whose content takes the place of ``path`` when the block ends well.

    Whatever happens before, ``path`` keeps what it holds.  Files in it that no run wrote stay there; where a new
    file has their name, they get the ending ``.kept``.  A link is followed and stays.

    Raises
    ------
    UsageError : ``path`` is a file, holds something else than ``kind``, is written by another run at this moment,
        or cannot be written.
    Unplaced : the new content is complete but could not be put there.
    """
    place = _place(Path(path))
    with _claimed(place, Path(path)):
        _finish(place)
        refuse_foreign(place, kind)
        inside = not swappable(place)
        new = _empty_folder(place, inside)
        try:
            yield new
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise
        try:
            os.chmod(new, 0o777 & ~umask())
            _write_list(new, kind.name, _names(new))
            if inside:
                if _list(place) is None:  # a change that is cut off must find what was there
                    _write_list(place, kind.name, _ours(place))
                os.rename(new, place / _SWAP)
                _finish(place)
                return
            kept = _keep_foreign(place, new, set())
            exchange(new, place)
            _keep_foreign(new, place, kept)  # what came meanwhile
        except OSError as error:
            raise _unplaced(new, place, error) from error
        shutil.rmtree(new, ignore_errors=True)


def refuse_foreign(path: Path, kind: Kind = RESULTS) -> None:
    """Raise UsageError where ``path`` is a file, or a folder that holds something, but not ``kind``."""
    if not path.exists():
        return
    if not path.is_dir():
        raise UsageError("is a file", where=str(path), expected="a folder for the output")
    if all(p.name.startswith(".hyperval") and p.name != LIST for p in path.iterdir()):
        return
    listing = _list(path)
    if listing is not None:
        if listing[0] == kind.name:
            return
        what = f"holds {listing[0]}, not {kind.name}"
    elif _begins(path / kind.marker, kind.head):
        return
    else:
        what = f"holds files, and not {kind.name} of an earlier run"
    raise UsageError(what, where=str(path), mend="name a new folder, or an empty one")


def swappable(path: Path) -> bool:
    """Whether the folder at ``path`` can change places with one beside it."""
    place = Path(path).resolve()
    here = Path.cwd()
    if place == here or place in here.parents or place in mount_points():
        return False
    return can_exchange(place.parent, _prefix(place))


def partial_folder(path: Path) -> Path:
    """Where a run into ``path`` keeps what it finished so far: beside it, or in it where it keeps its place."""
    place = _place(Path(path))
    return place.with_name(place.name + ".partial") if swappable(place) else place / PARTIAL


def _place(path: Path) -> Path:
    try:
        return path.resolve()
    except (OSError, RuntimeError) as error:
        raise _no_folder(path, error) from error


@contextmanager
def _claimed(place: Path, given: Path) -> Iterator[None]:
    """The folder, made where it is not there, and nobody else's for the block."""
    try:
        if place.exists() and not place.is_dir():
            raise UsageError("is a file", where=str(given), expected="a folder for the output")
        made = not place.exists()
        place.mkdir(parents=True, exist_ok=True)
        lock = Claim(place / LOCK)
    except BlockingIOError as error:
        raise UsageError(
            f"another run writes here ({claimed_by(place / LOCK) or 'it does not say which'})",
            where=str(given),
            mend="wait until it ends, or name another folder",
        ) from error
    except OSError as error:
        raise _no_folder(given, error) from error
    done = False
    try:
        yield
        done = True
    finally:
        lock.release()
        if made and not done:
            with suppress(OSError):
                place.rmdir()


def _no_folder(path: Path, error: Exception) -> UsageError:
    why = getattr(error, "strerror", None) or str(error)
    return UsageError(f"no folder can be made here: {why}", where=str(path)[:300], mend="name another folder")


def _prefix(place: Path) -> str:
    # The name itself may be as long as a name can be.
    return f"{_NEW}{place.name[:60]}-"


def _empty_folder(place: Path, inside: bool) -> Path:
    try:
        return Path(
            tempfile.mkdtemp(prefix=_NEW if inside else _prefix(place), dir=place if inside else place.parent)
        )
    except OSError as error:
        raise _no_folder(place, error) from error


def _finish(place: Path) -> None:
    """Finish a change that was cut off and remove what a killed run left; the folder is claimed."""
    listing = _list(place / _SWAP)
    if listing is not None:
        _swap_content(place, *listing)
    for left in (*place.glob(_NEW + "*"), place / _SWAP, *_left_beside(place)):
        shutil.rmtree(left, ignore_errors=True)
    (place / (LIST + ".half")).unlink(missing_ok=True)


def _left_beside(place: Path) -> list[Path]:
    """Folders that runs into ``place`` made beside it: eight letters after a prefix of their own."""
    try:
        names = os.listdir(place.parent)
    except OSError:
        return []
    exact = re.compile(re.escape(_prefix(place)) + "[a-z0-9_]{8}")
    return [place.parent / name for name in names if exact.fullmatch(name)]


def _swap_content(place: Path, kind: str, new: set[str]) -> None:
    """Put the files of the swap folder in the place of the old ones; called again, it goes on where it ended."""
    swap = place / _SWAP
    marker = next(k.marker for k in _KINDS if k.name == kind)
    ours = _ours(place)
    if (swap / marker).is_file():
        (place / marker).unlink(missing_ok=True)
    for name in sorted(ours - new, reverse=True):
        if not (place / name).is_dir():
            (place / name).unlink(missing_ok=True)
            _remove_empty(place, (place / name).parent)
    for name in [*sorted(new - {marker, LIST}), marker, LIST]:
        if not (swap / name).is_file():
            continue  # moved before
        for step in (*reversed(PurePosixPath(name).parents), PurePosixPath(name)):
            at = place / step
            if os.path.lexists(at) and at.is_dir() != (step != PurePosixPath(name)):
                os.rename(at, _kept_name(at))
        if name not in ours and name != LIST and os.path.lexists(place / name):
            os.rename(place / name, _kept_name(place / name))
        (place / name).parent.mkdir(parents=True, exist_ok=True)
        os.replace(swap / name, place / name)
    shutil.rmtree(swap, ignore_errors=True)


def _keep_foreign(place: Path, new: Path, kept: set[Path]) -> set[Path]:
    """Give the new folder what stands in the old one and is not ours, but for ``kept``; returns all of it.

    Each file gets a second name; nothing is copied where the file system knows several names of a file.
    """
    ours = _ours(place)
    for folder, folders, files in os.walk(place):
        links = [d for d in folders if (Path(folder) / d).is_symlink()]
        empty = [d for d in folders if d not in links and not any((Path(folder) / d).iterdir())]
        for entry in (*files, *links, *empty):
            at = Path(folder) / entry
            inner = at.relative_to(place)
            if inner in kept or inner.as_posix() in ours or _is_internal(inner):
                continue
            kept.add(inner)
            target = new
            for part in inner.parts[:-1]:
                taken = os.path.lexists(target / part) and not (target / part).is_dir()
                target = target / (f"{part}.kept" if taken else part)
            target.mkdir(parents=True, exist_ok=True)
            target = target / entry
            if entry in empty:
                target.mkdir(exist_ok=True)
                continue
            if os.path.lexists(target):
                target = _kept_name(target)
            try:
                os.link(at, target, follow_symlinks=False)
            except OSError:
                shutil.copy2(at, target, follow_symlinks=False)
    return kept


def _kept_name(path: Path) -> Path:
    out, n = path.with_name(path.name + ".kept"), 1
    while os.path.lexists(out):
        n += 1
        out = path.with_name(f"{path.name}.kept{n}")
    return out


def _remove_empty(place: Path, folder: Path) -> None:
    while folder != place:
        try:
            folder.rmdir()
        except OSError:
            return
        folder = folder.parent


def _is_internal(inner: Path) -> bool:
    return any(part.startswith(".hyperval") for part in inner.parts)


def _names(folder: Path) -> set[str]:
    """Files below a folder, their records, and the lists of the folders in it."""
    entries = (p for p in folder.rglob("*") if p.is_file() or p.is_symlink())
    inner = (p.relative_to(folder) for p in entries)
    return {
        p.as_posix()
        for p in inner
        if not _is_internal(p) or p.name == RECORD or (p.name == LIST and len(p.parts) > 1)
    }


def _write_list(folder: Path, kind: str, names: set[str]) -> None:
    text = json.dumps({"schema": 1, "kind": kind, "files": sorted(names)}, indent=1)
    half = folder / (LIST + ".half")
    half.write_text(text + "\n", "utf-8")
    os.replace(half, folder / LIST)


def _list(folder: Path) -> tuple[str, set[str]] | None:
    """Kind and files by the list in a folder; None where there is none that can be read."""
    try:
        content = json.loads((folder / LIST).read_bytes())
        files = {str(PurePosixPath(name)) for name in content["files"]}
        if content["schema"] != 1 or any(".." in PurePosixPath(f).parts or f.startswith("/") for f in files):
            return None
        return str(content["kind"]), files
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return None


def _ours(place: Path) -> set[str]:
    """Files of a folder that runs wrote: those of its list, and of the lists of folders in it."""
    out: set[str] = set()
    for listed in place.rglob(LIST):
        inner = listed.parent.relative_to(place)
        listing = _list(listed.parent)
        if listing is not None and not inner.as_posix().startswith(".hyperval"):
            out |= {(inner / name).as_posix() for name in listing[1]}
    if _list(place) is not None:
        return out
    for kind in _KINDS:
        if _begins(place / kind.marker, kind.head):
            out |= {name for name in _names(place) if kind.files.fullmatch(name)}
    return out


def _begins(path: Path, head: re.Pattern[bytes]) -> bool:
    try:
        if not path.is_file():
            return False
        with open(path, "rb") as stream:
            return head.match(stream.read(4096)) is not None
    except OSError:
        return False


def _unplaced(new: Path, place: Path, error: OSError) -> Unplaced:
    """The error of results that could not be put in place; they get a name that no later run removes."""
    safe = new if new.exists() else place / _SWAP
    for folder in (place.parent, place):
        try:
            target = folder / f"{place.name[:60]}.unplaced"
            target = _kept_name(target) if os.path.lexists(target) else target
            os.rename(safe, target)
            safe = target
            break
        except OSError:
            continue
    return Unplaced(
        f"the results could not be put here: {error.strerror or error}",
        where=str(place),
        mend=f"they are complete in {safe}: move them",
    )
