"""Data sets: where a reference leads, what is recorded of it, and what a download leaves behind."""

import gzip
import re
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from hashlib import sha256
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest

from hyperval import cli, datasets
from hyperval.datasets import DataFile, DataSet, InputLog
from hyperval.errors import InputError, MissingDataError, UsageError


@pytest.fixture(autouse=True)
def places(tmp_path, monkeypatch) -> tuple[Path, Path]:
    """An empty local copy and an empty cache."""
    local, cache = tmp_path / "local", tmp_path / "cache"
    local.mkdir()
    monkeypatch.setenv("HYPERVAL_DATA", str(local))
    monkeypatch.setenv("HYPERVAL_CACHE", str(cache))
    return local, cache / "data"


def put(root: Path, path: str, content: bytes = b"x") -> Path:
    target = root / path
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_bytes(content)
    return target


HEADER = "hysu/published/full/DLR_HySU_HS_full.hdr"


def test_registry_is_complete_and_pinned():
    for entry in datasets.registry().values():
        assert entry.licence
        assert entry.citation
        assert bool(entry.files) == entry.public
    files = [(entry, file) for entry in datasets.registry().values() for file in entry.files]
    for entry, file in files:
        assert re.fullmatch(r"[0-9a-f]{7,40}", entry.commit)
        assert re.fullmatch(r"sha256:[0-9a-f]{64}|git-blob:[0-9a-f]{40}", file.digest)
        assert file.size > 0
        assert re.search(r"^https://.*/[\w.-]+/[\w.-]+/[0-9a-f]{7,40}/", file.address)
        assert f"/{entry.repository}/{entry.commit}/" in file.address or "/chip/" in file.path
    assert len({file.path for _, file in files}) == len(files)


@pytest.mark.data
@pytest.mark.parametrize("name", ["hysu", "pasadena", "modtran6-airborne", "aviris-ng"])
def test_registry_agrees_with_the_real_files(data_dir, monkeypatch, name):
    # The fixture `places` has hidden the real folder; the session's value is in data_dir's own lookup.
    first = datasets.dataset(name).files[0].path
    monkeypatch.undo()
    root = Path(str(data_dir(first)).removesuffix(first))
    monkeypatch.setenv("HYPERVAL_DATA", str(root))
    assert set(datasets.verify(name).values()) == {"ok"}
    assert datasets.missing(name) == []


def test_where_a_reference_leads(places, tmp_path):
    """A local copy before the cache, a stated folder before both; what is not there names what mends it."""
    local, cache = places
    with pytest.raises(MissingDataError, match="hyperval data fetch hysu") as caught:
        datasets.resolve("data:" + HEADER)
    assert caught.value.exit_code == 3
    assert str(datasets.cache_dir()) in str(caught.value)  # where it should have stood
    for root in (cache, local):
        copy = put(root, HEADER)
        assert datasets.resolve("data:" + HEADER) == copy
    other = put(tmp_path / "other", HEADER)
    datasets.set_data_dir(tmp_path / "other")
    assert datasets.resolve("data:" + HEADER) == other
    with pytest.raises(UsageError, match="not a directory"):
        datasets.set_data_dir(tmp_path / "none")
    own, store = (put(tmp_path / "other", f"mine/{name}") for name in ("cube.img", "cube.ZARR/zarr.json"))
    assert [datasets.resolve(f"data:mine/{name}") for name in ("cube.img", "cube.ZARR")] == [own, store.parent]
    with pytest.raises(UsageError, match=f"nor on this machine .looked in {tmp_path}/other") as unknown:
        datasets.resolve("data:mine/spectra.txt")
    assert unknown.value.exit_code == 2
    assert not {"fetch", "perhaps"} & set(str(unknown.value).split())
    beside = put(tmp_path / "campaign", "truth/a.csv")
    assert datasets.resolve("truth/a.csv", tmp_path / "campaign") == beside
    for name, words in (("truth/b.csv", "no such file"), (".", "folder")):
        with pytest.raises(InputError, match=words):
            datasets.resolve(name, tmp_path / "campaign")
    with pytest.raises(UsageError, match="hysu, pasadena"):
        datasets.verify("hysuu")


def test_what_can_be_had_again_is_kept_where_the_environment_says(tmp_path, monkeypatch):
    monkeypatch.setenv("HYPERVAL_CACHE", str(tmp_path / "env"))
    assert datasets.cache_root() == tmp_path / "env"
    monkeypatch.delenv("HYPERVAL_CACHE")
    assert "hyperval" in str(datasets.cache_root())


def test_what_was_read_is_recorded_without_a_path_of_this_machine(places, tmp_path):
    put(places[0], "hysu/mine.hdr", b"a file of one's own among those of a set")
    inside, outside = put(places[0], "mine/a.hdr"), put(tmp_path / "elsewhere", "c.csv")
    put(tmp_path, "campaign/b.csv", b"1,2")
    names = [put(tmp_path, f"campaign/{name}").name for name in ("l.hdr", "l.sli", "t.hdr", "t.tif")]
    log = InputLog(tmp_path / "campaign")
    for reference in ("b.csv", "data:hysu/mine.hdr", "b.csv", str(outside), "l.hdr", "t.tif"):
        log.resolve(reference)
    assert log.add(inside) == inside
    entries = {e["reference"]: e for e in log.entries()}
    assert list(entries) == ["b.csv", "c.csv", "data:hysu/mine.hdr", "data:mine/a.hdr", *names]
    assert entries["b.csv"].items() >= {"sha256": sha256(b"1,2").hexdigest(), "bytes": 3, "licence": None}.items()
    assert str(tmp_path) not in repr(log.entries())
    known = datasets.owner_of("data:" + HEADER)
    assert (known.name, known.licence) == ("hysu", "CC-BY-4.0")
    assert "Cerra" in known.citation
    assert datasets.owner_of("cube.img") is datasets.owner_of("data:mine/cube.img") is None


def test_a_set_that_is_not_public_says_who_holds_it_and_where_it_goes(places):
    reference = "data:share2012/lines/0920-1631_rad.dat"
    with pytest.raises(MissingDataError, match=r"not public.*Rochester.*folder share2012 below HYPERVAL_DATA"):
        datasets.resolve(reference)
    with pytest.raises(InputError, match="ask the laboratory"):
        datasets.fetch("share2012")
    target = put(places[0], reference.removeprefix("data:"))
    assert datasets.resolve(reference) == target
    (log := InputLog(places[0])).resolve(reference)
    (record,) = log.entries()
    assert (record["dataset"], record["licence"]) == ("share2012", "not public")


@pytest.mark.parametrize(
    ("mistyped", "meant"),
    [
        ("hysu/Published/full/dlr_hysu_hs_ful.hdr", HEADER),
        ("hyzu/published/full/DLR_HySU_HS_full.hdr", HEADER),
        ("pasadina/x", "pasadena"),
        ("mine/cub.img", "mine/cube.img"),
    ],
)
def test_a_mistyped_name_is_told_the_nearest(places, mistyped, meant):
    put(places[0], "mine/cube.img")
    with pytest.raises(UsageError, match="no such file in any registered data set") as caught:
        datasets.resolve("data:" + mistyped)
    assert f"data:{meant}" in (caught.value.expected or "")


def test_a_pattern_stands_for_every_file_that_matches(places, tmp_path):
    from hyperval.paths import matching

    local, cache = places
    two = [put(local, f"mine/grass{i}.asd") for i in (1, 2)]
    put(local, "mine/sand1.asd")
    put(cache, "mine/grass3.asd")  # the first folder that has any counts
    pattern = datasets.resolve("data:mine/grass*.asd")
    assert matching(pattern) == two
    log = InputLog(local / "mine")
    assert matching(log.resolve("data:mine/grass?.asd")) == two
    assert matching(log.resolve("*1.asd")) == [two[0], local / "mine/sand1.asd"]
    assert [e["reference"] for e in log.entries()] == [
        "data:mine/grass1.asd", "data:mine/grass2.asd", "grass1.asd", "sand1.asd",
    ]  # fmt: skip
    elsewhere = InputLog(tmp_path)  # of a campaign whose scenario stands in another folder
    assert matching(elsewhere.resolve("grass*.asd", local / "mine")) == two
    assert [e["reference"] for e in elsewhere.entries()] == ["data:mine/grass1.asd", "data:mine/grass2.asd"]
    odd = put(local, "mine/a[1].asd")  # a name that only looks like a pattern
    assert matching(datasets.resolve("data:mine/a[1].asd")) == [odd]
    with pytest.raises(InputError, match="no such file"):
        datasets.resolve("*.sed", local / "mine")
    with pytest.raises(UsageError, match="no such file in any registered data set"):
        datasets.resolve("data:mine/*.sed")
    with pytest.raises(MissingDataError, match="fetch hysu"):
        datasets.resolve("data:hysu/published/full/*.hdr")


# Downloads, from a server on the loopback address.


class Handler(BaseHTTPRequestHandler):
    timeout = 10  # of a connection that nothing comes through
    content: dict[str, bytes]
    asked: list[str]
    log_message = print

    def do_GET(self) -> None:
        self.asked.append(self.path)
        body = self.content.get(self.path)
        self.send_response(404 if body is None else 200)
        self.send_header("Content-Length", str(len(body or b"")))
        self.end_headers()
        self.wfile.write(body or b"")


def toy_set(*files: DataFile) -> DataSet:
    where = {"repository": "nobody/toy", "commit": "0" * 40, "licence": "CC0", "citation": "none"}
    return DataSet(name="toy", title="Toy", files=files, **where)


@pytest.fixture
def server(monkeypatch) -> Iterator[type[Handler]]:
    """A registry of one set, `toy`, served by this machine."""
    handler = type("Local", (Handler,), {"content": {"/a.txt": b"first", "/b.chn": b"packed" * 100}, "asked": []})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as http:
        http.daemon_threads, http.block_on_close = True, False  # an answer under way holds nobody up
        threading.Thread(target=partial(http.serve_forever, poll_interval=0.01), daemon=True).start()
        root = f"http://127.0.0.1:{http.server_port}"
        paths = zip(("toy/a.txt", "toy/b.chn.gz"), handler.content.items(), strict=True)
        toy = toy_set(*(DataFile(p, root + at, len(c), f"sha256:{sha256(c).hexdigest()}") for p, (at, c) in paths))
        monkeypatch.setattr(datasets, "registry", lambda: {"toy": toy})
        monkeypatch.setattr(datasets, "ATTEMPTS", 1)
        monkeypatch.setenv("NO_PROXY", "127.0.0.1")
        yield handler
        http.shutdown()


def files_below(folder: Path) -> list[str]:
    return sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*") if p.is_file())


def test_fetch_fills_the_cache_goes_on_after_a_failure_and_mends_damage(server, places):
    assert datasets.missing("toy") == ["data:toy/a.txt", "data:toy/b.chn.gz"]
    body = server.content.pop("/b.chn")
    with pytest.raises(InputError, match="the server answered 404"):
        datasets.fetch("toy")
    assert files_below(places[1]) == ["toy/a.txt"]
    server.content["/b.chn"] = body
    for asked in (["/b.chn"], []):  # what is there is not fetched again
        server.asked.clear()
        datasets.fetch("toy")
        assert server.asked == asked
    packed = (places[1] / "toy/b.chn.gz").read_bytes()
    assert gzip.decompress(packed) == b"packed" * 100
    put(places[1], "toy/a.txt", b"fIrst")
    put(places[1], "toy/b.chn.gz", b"no gzip at all")
    assert set(datasets.verify("toy").values()) == {"differs"}
    datasets.fetch("toy")
    assert set(datasets.verify("toy").values()) == {"ok"}
    assert (places[1] / "toy/b.chn.gz").read_bytes() == packed  # the same bytes every time


def test_a_file_whose_git_blob_id_alone_is_published(server, places, monkeypatch):
    """The id of b"what is up, doc?" is the one in the book on git (10.2, Git objects)."""
    content = b"what is up, doc?"
    server.content["/c.img"] = content
    a = datasets.dataset("toy").files[0]
    blob = "bd9dbf5aae1a3862dd1526723246b20206e5fc37"
    entry = toy_set(DataFile("toy/c.img", a.address.replace("/a.txt", "/c.img"), len(content), f"git-blob:{blob}"))
    monkeypatch.setattr(datasets, "registry", lambda: {"toy": entry})
    for wrong in (b"what is up, cat?", content[:-1]):
        server.content["/c.img"] = wrong
        with pytest.raises(InputError, match=r"(?s)not the registered file.*16 bytes, git-blob:bd9dbf5a"):
            datasets.fetch("toy")
        assert files_below(places[1]) == []
    server.content["/c.img"] = content
    assert len(datasets.fetch("toy")) == 1


@pytest.mark.parametrize("answer", [b"fIrst", b"", b"first and more", b"x" * 10_000_000], ids=lambda b: str(len(b)))
def test_another_content_is_never_kept(server, places, answer):
    server.content["/a.txt"] = answer
    with pytest.raises(InputError, match=r"not the registered file(?s:.*)hyperval data fetch toy"):
        datasets.fetch("toy")
    assert files_below(places[1]) == []


def test_what_cannot_be_had_or_kept_is_one_clear_error(server, places, tmp_path, monkeypatch):
    copy = put(places[0], "toy/a.txt", b"mine!")
    with pytest.raises(InputError, match=r"local copy(?s:.*)HYPERVAL_DATA"):
        datasets.fetch("toy")
    copy.unlink()
    put(tmp_path, "a-file")
    with monkeypatch.context() as patch:
        patch.setenv("HYPERVAL_CACHE", str(tmp_path / "a-file"))
        with pytest.raises(InputError, match="cannot write"):
            datasets.fetch("toy")
    # Port 9 (discard) of the loopback address: nothing listens there.
    toy = toy_set(DataFile("toy/a.txt", "http://127.0.0.1:9/a.txt", 5, f"sha256:{'0' * 64}"))
    monkeypatch.setattr(datasets, "registry", lambda: {"toy": toy})
    with pytest.raises(InputError, match=r"cannot be downloaded: no connection(?s:.*)hyperval data fetch toy"):
        datasets.fetch("toy")


def test_eight_processes_that_fetch_the_same_files_all_get_them(server, places, monkeypatch):
    # Threads stand for processes: nothing but the folder is shared.  All of them find nothing there at first.
    monkeypatch.setattr(datasets, "_find", lambda path: None)
    with ThreadPoolExecutor(8) as pool:
        fetched = list(pool.map(lambda _: datasets.fetch("toy"), range(8)))
    assert [len(paths) for paths in fetched] == [2] * 8
    monkeypatch.undo()
    assert files_below(places[1]) == ["toy/a.txt", "toy/b.chn.gz"]
    assert gzip.decompress((places[1] / "toy/b.chn.gz").read_bytes()) == b"packed" * 100


# A local copy that is another file.


def test_a_wrong_copy_of_a_registered_file_is_refused_with_what_mends_it(small, places, tmp_path, capsys):
    name = "hysu/published/svc/DLR_HySU_SVC_ASCII.txt"
    copy = put(places[0], name, b"Wavelength (nm)\tReflectance\n400\t0.1\n2500\t0.2\n")
    small.data["collection"]["empirical_line"]["panels"][0]["spectrum"] = {"file": f"data:{name}"}
    campaign = small.write()
    words = r"not the registered file[\s\S]*it has 45 bytes[\s\S]*remove it or[\s\S]*: hyperval data fetch hysu"
    assert cli.run(["-q", "validate", str(campaign), "-o", str(tmp_path / "out")]) == 3
    said = capsys.readouterr().err
    assert re.search(words, said)
    assert str(copy) in said
    assert not (tmp_path / "out/results.json").exists()
    assert cli.run(["validate", "--dry-run", str(campaign)]) != 0
    assert re.search("not the registered file: remove it or .*: hyperval data fetch hysu", capsys.readouterr().out)
