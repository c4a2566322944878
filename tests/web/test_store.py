"""Runs through restarts, damage and full disks: the files are the truth."""

import errno
import secrets
import time
from pathlib import Path

import pytest

pytest.importorskip("fastapi", reason="needs the extra web")
from hyperval.web import Runs, ServerSettings, WebRun

POOLS = (None, None)  # nothing is ordered here


@pytest.fixture
def store(tmp_path):
    return Runs(ServerSettings(tmp_path), POOLS)


def again(store, **limits):
    return Runs(ServerSettings(store.folder, **limits), POOLS)


def kept(store, name="x", state="finished", **about):
    """A run as its file has it."""
    about = {"owner": "a", "kind": "prediction", "created": time.time(), **about}
    run = WebRun(id=secrets.token_urlsafe(12), name=name, state=state, summary={"bands": 3}, **about)
    place = store.place(run.id)
    place.mkdir()
    (place / "charts.json").write_bytes(b"a" * 1000)
    (place / "run.json").write_text(run.model_dump_json())
    return run


def test_runs_outlive_a_restart_and_those_on_their_way_are_lost(store):
    done, going = kept(store), kept(store, state="waiting")
    second = again(store)
    assert second.run(done.id, "a") == done
    assert second.run(going.id, "a").state == "lost"
    assert "server stopped" in second.run(going.id, "a").reason
    assert any("1 runs had not finished" in words for words in second.notices)
    assert again(second).notices == []  # told once


def test_folder_that_cannot_be_read_is_told_of_and_removed(store):
    good, bad, copy = kept(store), kept(store), kept(store)
    (store.place(bad.id) / "run.json").write_text('{"id": ')
    (store.place(copy.id) / "run.json").write_text(good.model_dump_json())
    before, second = store.visible_to("a"), again(store)
    assert [r.id for r in before] == [r.id for r in second.visible_to("a")] == [good.id]
    assert any("2 folders of runs could not be read" in words for words in second.notices)


def test_oldest_go_first_when_there_are_too_many_bytes_or_days(store):
    now = time.time()
    runs = [kept(store, name=f"n{i}", created=now - 1000 + i) for i in range(4)]
    second = again(store, kept_bytes=2900)
    assert {r.id for r in second.visible_to("a")} == {r.id for r in runs[2:]}
    assert not store.place(runs[0].id).exists()
    old = kept(second, created=now - 40 * 86400.0)
    third = again(second, kept_days=30.0)
    assert [r.id for r in third.visible_to("a")] == [runs[3].id, runs[2].id]
    assert not store.place(old.id).exists()


def test_full_disk_refuses_orders_and_shows_what_there_is(make_server, monkeypatch):
    server = make_server()
    client = server.session()
    run = client.post(f"{server.address}/api/v1/predictions", json={"name": "panels"}).json()
    full = OSError(errno.ENOSPC, "No space left on device")

    def refuse(path: Path, text: str) -> None:
        raise full

    with monkeypatch.context() as patch:
        patch.setattr("hyperval.web.store.write_text", refuse)
        answer = client.post(f"{server.address}/api/v1/predictions", json={"name": "panels"})
        assert answer.status_code == 503
        assert "No space left" in answer.text
        assert client.get(f"{server.address}/runs/{run['id']}").status_code == 200
    # The disk fills up while a run is on its way.
    server.quick.gate.clear()
    late = client.post(f"{server.address}/api/v1/predictions?wait=0", json={"name": "panels"}).json()
    with monkeypatch.context() as patch:
        patch.setattr("hyperval.web.store.write_text", refuse)
        server.quick.gate.set()
        told = client.get(f"{server.address}/api/v1/runs/{late['id']}", params={"wait": 20}).json()
        assert told["state"] == "failed"
        assert "could not be stored" in told["reason"]
    assert client.post(f"{server.address}/api/v1/predictions", json={"name": "panels"}).status_code == 201
