"""Public data sets: what they are, where they are on this machine, how they are fetched.

``data:PATH`` in a YAML file is the file PATH of the data directory: HYPERVAL_DATA first, so that a local copy wins,
then the user's cache, which ``hyperval data fetch SET`` fills from the addresses that the registry pins.
"""

from __future__ import annotations

import gzip
import hashlib
import os
import zlib
from collections import defaultdict
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from functools import cache
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any
from urllib.parse import quote

import platformdirs

from hyperval.envi_header import data_beside, header_beside
from hyperval.errors import HypervalError, MissingDataError, nearest, needed, package_table, refusal, refuse
from hyperval.paths import checked_store, is_pattern, is_store, matching, read_table
from hyperval.progress import track
from hyperval.storage import has_digest, installed_file, sha256_of, size_of, whole_file

ATTEMPTS = 3


PREFIX, SIMULATED = "data:", "simulated:"


@dataclass(frozen=True)
class DataFile:
    """One file of a data set.

    Attributes
    ----------
    path : where it stands below the data directory, with forward slashes
    address : public address of the pinned version
    size, digest : of the published content, as ``sha256:HEX`` or ``git-blob:HEX``.  A path in ``.gz`` whose address
        is not is stored packed here, and they then describe the content before packing.
    """

    path: str
    address: str
    size: int
    digest: str

    @property
    def packed(self) -> bool:
        """Whether the file is kept compressed here though it is published plain."""
        return self.path.endswith(".gz") and not self.address.endswith(".gz")

    def matches(self, path: Path) -> bool:
        """Whether the file at ``path`` has the registered content."""
        if not self.packed:
            return path.stat().st_size == self.size and has_digest(path, self.digest)
        with suppress(OSError, EOFError, zlib.error), gzip.open(path) as stream:
            return self.digest == f"sha256:{hashlib.sha256(stream.read(self.size + 1)).hexdigest()}"
        return False


def download(file: DataFile, target: Path, mend: str) -> Path:
    """Bring a file from its address to ``target`` and return ``target``.

    An answer that grows past the registered size is cut off.

    Parameters
    ----------
    mend : what the user can do when it fails

    Raises
    ------
    InputError : no connection, another content, or no room to write; nothing stands at ``target`` then.
    """
    # Imported here: only a download needs a network client, and its import is slow.
    import requests

    try:
        with whole_file(target) as temporary:
            for more in reversed(range(ATTEMPTS)):
                with suppress(*((requests.RequestException, ValueError) if more else ())):
                    _receive(file, temporary)
                    break
            if file.packed:  # no time in the header: the same content gives the same bytes
                temporary.write_bytes(gzip.compress(temporary.read_bytes(), mtime=0))
    except requests.RequestException as error:
        raise refusal("data.download", file.address, why=_reason(error), mend=mend) from error
    except ValueError as error:
        raise refusal("data.content", file.address, size=file.size, digest=file.digest, mend=mend) from error
    except OSError as error:
        raise refusal("file.unwritable", target, why=error.strerror or error) from error
    return target


def _receive(file: DataFile, output: Path) -> None:
    """Write the answer to ``output``; ValueError for another content than the registered, cut off beyond its size."""
    import requests

    with requests.get(file.address, stream=True, timeout=60) as answer, open(output, "wb") as stream:
        answer.raise_for_status()
        for chunk in answer.iter_content(1 << 14):
            stream.write(chunk)
            if stream.tell() > file.size:
                break
    if not has_digest(output, file.digest):
        raise ValueError("different content")


def _reason(error: Exception) -> str:
    """The cause in a few words: the text of the exception repeats the address several times."""
    import requests

    if isinstance(error, requests.HTTPError) and error.response is not None:
        return f"the server answered {error.response.status_code}"
    words = {requests.Timeout: "no answer in time", requests.ConnectionError: "no connection"}
    return next((text for kind, text in words.items() if isinstance(error, kind)), type(error).__name__)


@dataclass(frozen=True, kw_only=True)
class DataSet:
    """A data set with its licence, its citation and its files, as ``registry/sets.yaml`` and ``files.csv`` have it.

    A set that is not public has no repository and no listed files: ``holder`` says who has it, ``obtain`` how to
    get it; its files stand below a folder of its name.
    """

    name: str
    title: str
    licence: str
    citation: str
    repository: str = ""
    commit: str = ""
    upstream: str = ""
    files: tuple[DataFile, ...] = ()
    holder: str = ""
    obtain: str = ""

    @property
    def public(self) -> bool:
        """Whether it can be fetched."""
        return not self.holder


@cache
def registry() -> Mapping[str, DataSet]:
    """Every registered data set by name."""
    sets, files = package_table("registry/sets.yaml"), defaultdict[str, list[DataFile]](list)
    for _, row in read_table(installed_file("hyperval", "registry", "files.csv"))[1]:
        folder = "{repository}/{commit}/{upstream}".format_map(sets[row["set"]])
        inside = row["upstream"][1:] if row["upstream"].startswith("@") else f"{folder}/{row['upstream']}"
        address = f"https://raw.githubusercontent.com/{quote(inside.replace('//', '/'))}"
        digest = f"sha256:{row['sha256']}" if row["sha256"] else f"git-blob:{row['git_blob']}"
        files[row["set"]].append(DataFile(row["path"], address, int(row["bytes"]), digest))
    return {name: DataSet(name=name, files=tuple(files[name]), **about) for name, about in sets.items()}


def dataset(name: str) -> DataSet:
    """The data set of that name; raises UsageError for a name that is not registered."""
    refuse(name not in registry(), "data.none", name=name, known=", ".join(registry()))
    return registry()[name]


def set_data_dir(path: Path) -> None:
    """Look for data below ``path`` first, in this process and those it starts."""
    refuse(not Path(path).is_dir(), "data.folder", path)
    os.environ["HYPERVAL_DATA"] = str(Path(path).resolve())


def cache_root() -> Path:
    """Where all is kept that can be had again: HYPERVAL_CACHE, or the user's cache folder."""
    return Path(os.environ.get("HYPERVAL_CACHE") or platformdirs.user_cache_path("hyperval", appauthor=False))


def cache_dir() -> Path:
    """Where fetched data are kept."""
    return cache_root() / "data"


def resolve(reference: str, base: Path | None = None) -> Path:
    """The file that ``reference`` names.

    ``data:PATH`` is looked for below HYPERVAL_DATA and then in the cache; anything else is a path relative
    to ``base`` (the folder of the YAML file that holds the reference; by default the working directory).
    Where the last part is a pattern (``*``, ``?``) the path of the pattern comes back, which at least one file
    matches (:func:`hyperval.paths.matching` lists them).

    Raises
    ------
    UsageError : the reference is empty, an address, leaves the data directory, or names a file that neither this
        machine nor the registry knows.
    MissingDataError : a file of a data set that is not on this machine.
    InputError : no such file.
    """
    refuse(not reference.strip(), "data.empty")
    if reference.startswith(PREFIX):
        return _resolve_data(_data_path(reference))
    # An address is refused before it is joined to the folder and becomes a path that only does not exist.
    if "://" in reference or reference.startswith("/vsi"):
        return checked_store(reference)
    path = (Path(base) if base is not None else Path()) / reference
    return path if is_pattern(reference) and matching(path) else checked_store(path)


def owner_of(reference: str) -> DataSet | None:
    """The set that a reference belongs to: by its file, or by its folder where the set is not public; else None.

    >>> owner_of("data:share2012/0920-1631/mine.dat").name, owner_of("data:hysu/mine.dat"), owner_of("hysu/mine.dat")
    ('share2012', None, None)
    """
    if not reference.startswith(PREFIX):
        return None
    path = _data_path(reference)
    if path in _by_path():
        return _by_path()[path][0]
    beside = registry().get(path.split("/")[0])
    return None if beside is None or beside.public else beside


def files_at_hand(name: str) -> int:
    """Number of files below the folder of a set that is not public, in HYPERVAL_DATA and the cache."""
    return sum(1 for root in _roots() for p in (root / dataset(name).name).rglob("*") if p.is_file())


def verify(name: str) -> dict[str, str]:
    """Every file of a set, where it would be read from: ok, missing, or differs (from its registered SHA-256)."""
    found = {file: _find(file.path) for file in dataset(name).files}
    return {f.path: "missing" if path is None else "ok" if f.matches(path) else "differs" for f, path in found.items()}


def missing(name: str) -> list[str]:
    """The references of a set whose files are not on this machine."""
    return [PREFIX + file.path for file in dataset(name).files if _find(file.path) is None]


def fetch(name: str) -> list[Path]:
    """Bring every file of a set that is not at hand, or that differs, into the cache; return the new paths.

    Each appears under its name only when its SHA-256 is right; a repeated call goes on where the first stopped.

    Raises
    ------
    InputError : no connection, another answer, no room to write, or a set that is not public, with who has it.
    """
    entry = dataset(name)
    refuse(not entry.public, "data.held", name=name, holder=entry.holder, how=how_to_get(entry))
    needed = {f: path for f in entry.files if (path := _find(f.path)) is None or not f.matches(path)}
    for file, path in needed.items():
        if path is not None and not path.is_relative_to(cache_dir()):
            raise _another_file(name, file, path)
    again = f"check the connection and repeat: hyperval data fetch {name}; or name a copy with HYPERVAL_DATA"
    return [download(file, cache_dir() / file.path, again) for file in track(needed, f"fetching {name}")]


def check_copy(reference: str, path: Path) -> None:
    """Raise InputError where ``path``, which stands for a registered file, has another content."""
    entry = _by_path().get(_data_path(reference)) if reference.startswith(PREFIX) else None
    if entry is not None and not entry[1].matches(path):
        raise _another_file(entry[0].name, entry[1], path)


def _another_file(name: str, file: DataFile, path: Path) -> HypervalError:
    size = f"{file.size} bytes{' unpacked' * file.packed}"
    return refusal("data.copy", path, path=file.path, size=size, digest=file.digest, has=size_of(path), name=name)


def how_to_get(entry: DataSet) -> str:
    """What to do about a set that is not public."""
    return f"{entry.obtain}; put the files into the folder {entry.name} below HYPERVAL_DATA (or --data-dir)"


class InputLog:
    """Every file that a run read, simulated ones among them, for its provenance record.

    Attributes
    ----------
    base : folder that references are relative to
    simulated : folder of the files that ``simulated:NAME`` stands for, once they are made
    """

    def __init__(self, base: Path | None = None):
        self.base = Path(base) if base is not None else Path()
        self.simulated: Path | None = None
        self._entries: dict[str, dict[str, Any]] = {}
        self._names: dict[Path, str] = {}  # the first of each file

    @classmethod
    def of_file(cls, path: Path) -> InputLog:
        """The log of a run of a file, which is its first entry; references are relative to its folder."""
        (log := cls(path.resolve().parent)).add(path.resolve(), path.name)
        return log

    def resolve(self, reference: str, base: Path | None = None) -> Path:
        """Like :func:`resolve`, and keep a record of the file; InputError where it is not the registered one."""
        if reference.startswith(SIMULATED):
            folder = needed(self.simulated, "data.simulated", reference=reference)
            return self.add(folder / Path(reference.removeprefix(SIMULATED)).name, reference)
        path = resolve(reference, base or self.base)
        if is_pattern(reference) and not path.is_file():
            for one in matching(path):
                self.resolve((PurePosixPath(reference).parent / one.name).as_posix(), base)
            return path
        is_own = base in (None, self.base) and not Path(reference).is_absolute()
        ending, companion = path.suffix.lower(), None
        with suppress(HypervalError):  # which of several is read is the reader's to say
            companion = data_beside(path) if ending == ".hdr" else header_beside(path)
        if companion is not None:
            self.add(companion)
        return self.add(path, reference if is_own or reference.startswith(PREFIX) else None)

    def add(self, path: Path, reference: str | None = None) -> Path:
        """Record a file that was found otherwise, such as the header beside a cube; once, by its first name."""
        reference = reference or self._names.get(path.resolve()) or self._relative(path)
        self._names.setdefault(path.resolve(), reference)
        if reference not in self._entries:
            check_copy(reference, path)
            owner, content = owner_of(reference), {"sha256": sha256_of(path), "bytes": size_of(path)}
            whose = {key: getattr(owner, key, None) for key in ("licence", "citation")}
            self._entries[reference] = {"reference": reference, **content, "dataset": owner and owner.name, **whose}
        return path

    def entries(self) -> list[dict[str, Any]]:
        """One record per file, sorted by reference: what was read, its SHA-256, size, licence, citation."""
        return [dict(self._entries[key]) for key in sorted(self._entries)]

    def _relative(self, path: Path) -> str:
        """A name for ``path`` that says nothing of this machine."""
        full = Path(path).resolve()
        made = [(self.simulated.resolve(), SIMULATED)] if self.simulated else []
        for root, prefix in [*made, *((r.resolve(), PREFIX) for r in _roots()), (self.base.resolve(), "")]:
            if full.is_relative_to(root):
                return prefix + full.relative_to(root).as_posix()
        return full.name


def _data_path(reference: str) -> str:
    """The path in a ``data:`` reference, which must stay inside the data directory."""
    text = reference.removeprefix(PREFIX)
    path = PurePosixPath(text)
    leaves = not text or path.is_absolute() or ".." in path.parts or any(c in text for c in "\\\0:")
    refuse(leaves, "data.leaves", reference=reference)
    return path.as_posix()


def _roots() -> list[Path]:
    local = os.environ.get("HYPERVAL_DATA")
    return [*([Path(local)] if local else []), cache_dir()]


def _find(path: str) -> Path | None:
    return next((p for root in _roots() if matching(p := root / path) or is_store(p)), None)


@cache
def _by_path() -> dict[str, tuple[DataSet, DataFile]]:
    return {file.path: (owner, file) for owner in registry().values() for file in owner.files}


def _resolve_data(path: str) -> Path:
    if (path_here := _find(path)) is not None:
        return path_here
    looked = ", ".join(f"{root}{'' if root.is_dir() else ' (no such folder)'}" for root in _roots())
    of_pattern = (owner for file, (owner, _) in _by_path().items() if is_pattern(path) and fnmatchcase(file, path))
    owner = next(of_pattern, None) or owner_of(PREFIX + path)
    if owner is None:  # neither the registry nor this machine knows it: the names nearest to it
        folders = [folder for root in _roots() if (folder := (root / path).parent).is_dir()]
        neighbours = [str(PurePosixPath(path).parent / p.name) for f in folders for p in islice(f.iterdir(), 10_000)]
        close = nearest(path, [*_by_path(), *neighbours], 3) or nearest(path.split("/")[0], registry(), 3)
        perhaps = f"perhaps {', '.join(PREFIX + name for name in close)}" if close else ""
        raise refusal("data.unknown", PREFIX + path, looked=looked, perhaps=perhaps)
    mend = f"hyperval data fetch {owner.name}"
    if not owner.public:
        mend = f"the collection is not public, it is held by {owner.holder}: {how_to_get(owner)}"
    # Reports say what is missing, and not which folders a machine has: that is for whoever runs it.
    raise MissingDataError("not on this machine", where=PREFIX + path, expected=f"it below {looked}", mend=mend)
