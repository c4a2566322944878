"""Files and folders: whole or not at all, by one run at a time, nothing of the user's lost, wherever a run ends."""

import errno
import os
import stat
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

from hyperval import storage
from hyperval.errors import InputError, UsageError
from hyperval.storage import scratch_folder, sha256_of, size_of, whole_file, write_text

# Whole or not at all: what stands on disk after a failure at any point.


class Broken(Exception):
    pass


def left_over(folder: Path) -> list[str]:
    return sorted(p.name for p in folder.iterdir())


def ended(script: str) -> int:
    """The code with which a program ends that runs the script."""
    return subprocess.run([sys.executable, "-B", "-c", textwrap.dedent(script)], check=False).returncode


def test_a_file_is_whole_or_the_old_one(tmp_path):
    path = tmp_path / "deep" / ("n" * 251 + ".csv")  # a name as long as a name can be
    before = os.umask(0o027)
    try:
        write_text(path, "λ\n")
    finally:
        os.umask(before)
    assert path.read_bytes() == b"\xce\xbb\n"
    assert stat.S_IMODE(path.stat().st_mode) == 0o640

    def half_write() -> None:
        with whole_file(path) as temporary:
            assert (temporary.parent, temporary.suffix) == (path.parent, ".csv")
            temporary.write_text("ne")
            raise Broken

    with pytest.raises(Broken):
        half_write()
    assert path.read_bytes() == b"\xce\xbb\n"
    assert left_over(path.parent) == [path.name]


def test_digests(tmp_path):
    # NIST FIPS 180-4 example: the one-block message "abc".
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256_of(tmp_path / "abc") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"
    with pytest.raises(InputError, match="cannot read"):
        sha256_of(tmp_path / "none")
    for folder, name in (("a", "0.0"), ("b", "0.1")):  # a folder is known by the names of its files, too
        (tmp_path / folder / "inner").mkdir(parents=True)
        (tmp_path / folder / "inner" / name).write_bytes(b"1")
    assert sha256_of(tmp_path / "a") != sha256_of(tmp_path / "b")
    assert size_of(tmp_path / "a") == 1


def test_a_killed_process_keeps_the_old_file_and_the_next_one_removes_what_it_left(tmp_path):
    (path := tmp_path / "result.csv").write_text("old")
    script = f"""
        import os, signal
        from pathlib import Path
        from hyperval.storage import whole_file
        with whole_file(Path({str(path)!r})) as t:
            t.write_text("ne")
            os.kill(os.getpid(), signal.SIGKILL)
    """
    assert ended(script) == -9
    assert path.read_text() == "old"
    (left,) = (p for p in tmp_path.iterdir() if p != path)
    write_text(path, "new")
    assert left.exists()  # too new: perhaps of a process on another machine
    os.utime(left, (0, 0))
    other = tmp_path / ".result.csv.backup.csv"  # the user's
    other.write_text("mine")
    os.utime(other, (0, 0))
    write_text(path, "newer")
    assert left_over(tmp_path) == [other.name, "result.csv"]
    with whole_file(path) as outer:  # what a running process writes is left alone
        outer.write_text("outer")
        os.utime(outer, (0, 0))
        write_text(path, "inner")
        assert outer.exists()
    assert path.read_text() == "outer"


def test_full_disk_keeps_the_old_file(tmp_path):
    # A limit on file size stands in for a full disk: the write fails in the middle with EFBIG.
    (path := tmp_path / "a.bin").write_bytes(b"old")
    script = f"""
        import resource, signal
        from pathlib import Path
        from hyperval.storage import whole_file
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        try:
            with whole_file(Path({str(path)!r})) as t:
                t.write_bytes(bytes(10000))
        except OSError:
            raise SystemExit(7)
    """
    assert ended(script) == 7
    assert path.read_bytes() == b"old"
    assert left_over(tmp_path) == ["a.bin"]


def test_scratch_of_killed_processes_goes_with_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    script = f"""
        import os, signal, tempfile
        tempfile.tempdir = {str(tmp_path)!r}
        from hyperval.storage import scratch_folder
        with scratch_folder("trial") as folder:
            (folder / "cube.img").write_bytes(bytes(100))
            os.utime(folder, (0, 0))
            os.kill(os.getpid(), signal.SIGKILL)
    """
    assert ended(script) == -9
    assert len(left_over(tmp_path)) == 1
    with scratch_folder("trial") as folder:
        assert list(tmp_path.iterdir()) == [folder]
        os.utime(folder, (0, 0))
        with scratch_folder("trial"):
            assert folder.exists()  # of a process that runs
    assert list(tmp_path.iterdir()) == []


# Output folders: replaced whole, by one run at a time, nothing of the user's lost, wherever a run ends.


HEAD = '{\n "schema_version": 1,\n "hyperval_version": "0.1.0",\n "rows": []\n}\n'
SRC = Path(storage.__file__).parents[1]


def refused(path: Path, words: str, kind: str = storage.RESULTS) -> None:
    with pytest.raises(UsageError, match=words), storage.whole_folder(path, kind):
        raise AssertionError("the block must not begin")


def files(folder: Path) -> dict[str, str]:
    """Path -> content of every file below a folder, without the list."""
    return {
        p.relative_to(folder).as_posix(): p.read_text()
        for p in sorted(folder.rglob("*"))
        if p.is_file() and p.name != storage.LIST
    }


def fill(folder: Path, **content: str) -> None:
    for name, text in content.items():
        path = folder / name.replace("__", "/").replace("_", ".")
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)


def run(path: Path, **content: str) -> None:
    with storage.whole_folder(path) as new:
        fill(new, results_json=HEAD, **content)


def test_a_folder_is_replaced_as_a_whole(tmp_path):
    path = tmp_path / "report"
    before = os.umask(0o027)
    try:
        run(path, old_csv="1", figures__a_svg="<old>", figures__deep__b_svg="b")
    finally:
        os.umask(before)
    assert [stat.S_IMODE(p.stat().st_mode) for p in (path, path / storage.LIST)] == [0o750, 0o640]
    with storage.whole_folder(path) as new:
        fill(new, results_json=HEAD, figures__a_svg="<new>")
        assert files(path)["old.csv"] == "1"
        run(path.with_name("report-2"))  # a neighbour whose name begins alike
        assert set(files(new)) == {"results.json", "figures/a.svg"}
    assert files(path) == {"results.json": HEAD, "figures/a.svg": "<new>"}
    assert sorted(p.name for p in tmp_path.iterdir()) == ["report", "report-2"]
    assert not (path / "figures" / "deep").exists()


def test_what_the_user_put_there_is_refused_and_stays(tmp_path):
    path = tmp_path / "report"
    run(path, old_csv="1", figures__a_svg="<old>")
    (path / ".DS_Store").write_text("of the system")
    run(path, figures__a_svg="<new>")
    held = {"results.json": HEAD, "figures/a.svg": "<new>", ".DS_Store": "of the system"}
    assert files(path) == held
    for name, make in (
        ("notes.txt", lambda p: p.write_text("mine")),
        ("figures/my.png", lambda p: p.write_text("mine too")),
        ("link", lambda p: p.symlink_to("elsewhere")),
    ):
        make(path / name)
        refused(path, f"holds files that are not results of a run: {name}")
        assert {k: v for k, v in files(path).items() if k != name} == held
        (path / name).unlink()
    run(path)
    assert set(files(path)) == {"results.json", ".DS_Store"}
    other = tmp_path / "thesis"
    fill(other, results_json='{"mine": 1}', thesis_tex="years of work")
    before = files(other)
    refused(other, "holds files that are not results of a run")
    assert files(other) == before
    assert not (other / storage.LOCK).exists()


@pytest.mark.parametrize("first", [True, False])
def test_a_failure_keeps_what_was_there(tmp_path, first):
    if not first:
        run(tmp_path / "report", old_csv="old")

    with pytest.raises(Broken), storage.whole_folder(tmp_path / "report") as new:  # noqa: PT012 - it ends in the middle
        fill(new, new_csv="ne")
        raise Broken
    assert [p.name for p in tmp_path.iterdir()] == ([] if first else ["report"])
    assert first or files(tmp_path / "report") == {"results.json": HEAD, "old.csv": "old"}


def test_each_kind_is_replaced_by_its_own_alone(tmp_path):
    for kind in (storage.RESULTS, storage.COLLECTION, storage.POWER):
        path = tmp_path / ("n" * 200 + storage.MARKERS[kind])  # a name nearly as long as a name can be
        for content in "12":
            with storage.whole_folder(path, kind) as new:
                (new / storage.MARKERS[kind]).write_text(content)
                (new / f"old{content}.yaml").write_text("")
        assert files(path) == {storage.MARKERS[kind]: "2", "old2.yaml": ""}
        other = storage.COLLECTION if kind is storage.RESULTS else storage.RESULTS
        refused(path, f"holds {kind}, not {other}", other)


def test_a_damaged_list_loses_nothing(tmp_path):
    path = tmp_path / "report"
    run(path, notes_txt="1")
    (path / storage.LIST).write_text('{"schema": 1, "kind": "results", "files": ["../../etc/passwd"]}')
    with pytest.raises(UsageError, match=r"notes\.txt"):
        run(path, new_csv="2")
    assert set(files(path)) == {"results.json", "notes.txt"}


@pytest.mark.parametrize("name", ["file", "file/out", "n" * 300, "n" * 200 + "/" + "n" * 300])
def test_places_where_no_folder_can_be_are_the_users_to_mend(tmp_path, name):
    (tmp_path / "file").write_text("mine")
    refused(tmp_path / name, r"is a file|cannot create the folder")
    assert (tmp_path / "file").read_text() == "mine"


def test_two_runs_into_one_folder(tmp_path):
    path = tmp_path / "report"
    with storage.whole_folder(path) as new:
        fill(new, results_json=HEAD, first_csv="1")
        refused(path, f"another run is writing here \\(process {os.getpid()} on ")
    assert set(files(path)) == {"results.json", "first.csv"}
    run(path, second_csv="2")
    assert set(files(path)) == {"results.json", "second.csv"}


def test_the_working_directory_keeps_its_place_and_a_link_is_followed_and_stays(tmp_path, monkeypatch):
    path, link = tmp_path / "disk" / "report", tmp_path / "out"
    run(path, old_csv="1")
    inode = path.stat().st_ino
    monkeypatch.chdir(path)
    link.symlink_to("disk/report")
    for place, name in ((Path(), "new"), (link, "newer")):
        run(place, **{f"{name}_csv": "2"})
        assert (path.stat().st_ino, link.is_symlink()) == (inode, True)
        assert set(files(Path())) == {"results.json", f"{name}.csv"}
    assert storage.partial_folder(Path()) == path / storage.PARTIAL


def test_a_mounted_volume_is_written_inside(tmp_path):
    (tmp_path / "volume").mkdir()
    (tmp_path / "out").mkdir()
    script = f"""
        from pathlib import Path
        from hyperval.storage import whole_folder
        for content in "12":
            with whole_folder(Path({str(tmp_path / "out")!r})) as new:
                (new / "results.json").write_text(content)
    """
    (tmp_path / "script.py").write_text(textwrap.dedent(script))
    mount = f"mount --bind {tmp_path}/volume {tmp_path}/out && exec {sys.executable} {tmp_path}/script.py"
    # In a name space of its own, where an ordinary user may mount.
    trial = subprocess.run(["unshare", "-Urm", "true"], capture_output=True, check=False)
    if trial.returncode != 0:
        pytest.skip("this machine lets nobody mount")
    command = ["unshare", "-Urm", "sh", "-c", mount]
    done = subprocess.run(command, capture_output=True, check=False, env={**os.environ, "PYTHONPATH": str(SRC)})
    assert done.returncode == 0, done.stderr
    assert files(tmp_path / "volume") == {"results.json": "2"}


def test_results_that_cannot_be_placed_are_kept_and_named(tmp_path, monkeypatch):
    path = tmp_path / "report"
    run(path, old_csv="1")

    monkeypatch.setattr(os, "rename", lambda source, target: (_ for _ in ()).throw(OSError(errno.EBUSY, "busy")))
    with pytest.raises(storage.UnplacedResults, match=r"put here: busy(?s:.*)they are complete in (.*): copy") as told:
        run(path, new_csv="2")
    monkeypatch.undo()
    (safe,) = path.glob(".hyperval-new-*")
    assert str(safe) in str(told.value)
    assert files(safe)["new.csv"] == "2"
    safe.rename(tmp_path / "safe")
    assert set(files(path)) == {"results.json", "old.csv"}


def test_a_change_that_failed_is_finished_by_the_next_run(tmp_path, monkeypatch):
    path = tmp_path / "report"
    run(path, old_csv="1")
    monkeypatch.setattr(os, "replace", lambda source, target: (_ for _ in ()).throw(OSError(errno.ENOSPC, "full")))
    with pytest.raises(storage.UnplacedResults, match=r"put here: full(?s:.*)the next run into this folder finishes"):
        run(path, new_csv="2")
    monkeypatch.undo()
    assert "results.json" not in files(path)
    with pytest.raises(Broken), storage.whole_folder(path):
        raise Broken
    assert set(files(path)) == {"results.json", "new.csv"}


KILLED = """
import os, signal, sys
sys.path.insert(0, {src!r})
from pathlib import Path
from hyperval import storage as folders
WRITES = {{"os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.chmod", "shutil.rmtree", "os.truncate"}}
left = [{steps}]
def hook(event, args):
    if event in WRITES or event == "open" and isinstance(args[1], str) and args[1][0] in "wxa":
        if not any({parent!r} in str(a) or isinstance(a, str) and a.startswith(".hyperval") for a in args):
            return
        left[0] -= 1
        if left[0] == 0:
            os.kill(os.getpid(), signal.SIGKILL)
sys.addaudithook(hook)
with folders.whole_folder(Path({path!r})) as new:
    (new / "figures").mkdir()
    (new / "results.json").write_text({head!r})
    (new / "a.csv").write_text("new")
    (new / "figures" / "a.svg").write_text("new")
    (new / "figures" / "b.svg").write_text("new")
"""


@pytest.mark.parametrize("first", [True, False], ids=["first run", "second run"])
def test_killed_at_any_point_the_old_report_or_the_new_one(tmp_path, first):
    new = {"results.json": HEAD, "a.csv": "new", "figures/a.svg": "new", "figures/b.svg": "new"}
    outcomes, codes, steps = [], [], 0
    while not codes or codes[-1] == -9:
        steps += 1
        path = tmp_path / str(steps) / "report"
        path.parent.mkdir()
        old: dict[str, str] = {}
        if not first:
            run(path, a_csv="old", figures__a_svg="old", figures__c_svg="old")
            fill(path, **{".notes": "mine"})
            old = files(path)
        script = KILLED.format(src=str(SRC), steps=steps, parent=str(path.parent), path=str(path), head=HEAD)
        codes.append(subprocess.run([sys.executable, "-c", script], check=False).returncode)
        mine = {} if first else {".notes": "mine"}
        there = {k: v for k, v in files(path).items() if not k.startswith(".hyperval")} if path.exists() else {}
        whole = there in (old, new | mine)
        # File by file: what is neither bears no results, and the next run finishes it.
        assert whole or "results.json" not in there, (steps, there)
        if not first:
            assert there[".notes"] == "mine"
        seen = []
        with storage.whole_folder(path) as made:  # the next run
            seen.append({k: v for k, v in files(path).items() if not k.startswith(".hyperval")})
            fill(made, results_json=HEAD)
        assert seen[0] in (old, new | mine), (steps, seen)
        outcomes.append(seen[0] != old)
        assert set(files(path)) == {"results.json", *mine}
        assert {p.name for p in path.parent.iterdir()} == {"report"}  # nothing is left behind
    assert codes[-1] == 0
    assert outcomes == sorted(outcomes)  # the old one up to a point, the new one from there on
    assert steps > 15
