"""Runs through restarts, damage and full disks: the files are the truth."""

import errno
import time
from pathlib import Path

import pytest

pytest.importorskip("fastapi", reason="needs the extra web")
from hyperval.web import RunStore, ServerSettings


@pytest.fixture
def store(tmp_path):
    return RunStore(ServerSettings(tmp_path))


def again(store, **limits):
    return RunStore(ServerSettings(store.folder, **limits))


def finished(store, owner="a", name="x"):
    run = store.new(owner, "prediction", name, "", "1")
    (store.place(run.id) / "charts.json").write_bytes(b"a" * 1000)
    return store.change(run.id, state="finished", summary={"bands": 3})


def test_runs_outlive_a_restart_and_those_on_their_way_are_lost(store):
    done, going = finished(store), store.new("a", "study", "y", "", "1")
    store.change(going.id, state="running")
    second = again(store)
    assert second.run(done.id, "a") == done
    assert second.run(going.id, "a").state == "lost"
    assert "server stopped" in second.run(going.id, "a").reason
    assert any("1 runs had not finished" in words for words in second.notices)
    third = again(second)
    assert third.notices == []  # told once


def test_folder_that_cannot_be_read_is_told_of_and_removed(store):
    good, bad = finished(store), finished(store)
    (store.place(bad.id) / "run.json").write_text('{"id": ')
    second = again(store)
    assert [r.id for r in second.runs("a")] == [good.id]
    assert any("1 folders of runs could not be read" in words for words in second.notices)


def test_oldest_go_first_when_there_are_too_many_bytes_or_days(store):
    runs = [finished(store, name=f"n{i}") for i in range(4)]
    for number, run in enumerate(runs):
        store.change(run.id, created=time.time() - 1000 + number)
    second = again(store, kept_bytes=2900)
    assert {r.id for r in second.runs("a")} == {r.id for r in runs[2:]}
    assert not store.place(runs[0].id).exists()
    second.change(runs[2].id, created=time.time() - 40 * 86400.0)
    third = again(second, kept_days=30.0)
    assert [r.id for r in third.runs("a")] == [runs[3].id]


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
