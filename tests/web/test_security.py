"""What is refused, by whom it is seen, and what an answer never holds."""

import json
import socket

import pytest
import requests
from processes import awaited
from web_server import ORDERED, REFUSED

from hyperval.web import POLICY, ServerSettings, campaigns_of

EASY = {"name": "panels"}
JSON = {"content-type": "application/json"}


def test_no_session_sees_the_runs_of_another(server):
    mine, other = server.session(), server.session()
    run = mine.post(f"{server.address}/api/v1/predictions", json=EASY).json()["id"]
    for path in (f"/runs/{run}", f"/api/v1/runs/{run}/charts", f"/runs/{run}/files/scenario.yaml",
                 f"/api/v1/runs/{run}", f"/predict?run={run}"):  # fmt: skip
        assert mine.get(server.address + path).status_code == 200
        assert other.get(server.address + path).status_code == 404
    assert other.get(f"{server.address}/api/v1/runs").json() == []
    assert other.delete(f"{server.address}/api/v1/runs/{run}").status_code == 404
    own = other.post(f"{server.address}/api/v1/predictions", json=EASY).json()["id"]
    assert other.get(f"{server.address}/runs/{own}", params={"beside": run}).status_code == 404
    url = f"{server.address}/api/v1/runs/{run}"
    assert [mine.delete(url).status_code, mine.get(url).status_code] == [204, 404]


def test_change_that_another_site_asks_for_is_refused_and_takes_no_session_away(server, client):
    """A browser sends such a form without the cookie (SameSite); the answer must not set another one."""
    form = {"url": f"{server.address}/predict", "data": {"action": "run"}, "allow_redirects": False}
    for headers in ({"Origin": "http://elsewhere.example"}, {"Sec-Fetch-Site": "cross-site"}, {"Origin": "null"},
                    {"Sec-Fetch-Site": "same-site"}):  # fmt: skip
        answer = requests.post(headers=headers, timeout=20, **form)
        assert answer.status_code == 403
        assert "set-cookie" not in answer.headers
        told = client.post(f"{server.address}/api/v1/predictions", json=EASY, headers=headers)
        assert (told.status_code, told.json()["errors"][0]["field"]) == (403, "origin")
    run = client.post(f"{server.address}/api/v1/predictions", json=EASY).json()["id"]
    for method, path in (("POST", f"/runs/{run}/remove"), ("POST", f"/runs/{run}/cancel"),
                         ("DELETE", f"/api/v1/runs/{run}")):  # fmt: skip
        answer = client.request(method, server.address + path, headers={"Origin": "http://elsewhere.example"})
        assert answer.status_code == 403
    assert client.get(f"{server.address}/api/v1/runs/{run}").json()["state"] == "finished"


@pytest.mark.parametrize("host", ["elsewhere.example", "127.0.0.1.elsewhere.example", "", "127.0.0.1:80:80"])
def test_host_is_checked(server, host):
    assert requests.get(server.address, headers={"Host": host}, timeout=20).status_code == 400


def test_every_answer_has_the_policy_and_the_cookie_its_attributes(server):
    for path in ("/", "/predict", "/docs", "/nowhere", "/api/v1/sensors", "/static/app.css"):
        answer = requests.get(server.address + path, timeout=20)
        assert answer.headers["content-security-policy"] == POLICY
        assert ORDERED["headers"].items() <= dict(answer.headers).items()
        assert (answer.headers["cache-control"] == "no-store") == (path != "/static/app.css")
    assert "script-src 'self'" in POLICY
    assert "unsafe" not in POLICY.replace("style-src 'self' 'unsafe-inline'", "")
    assert (
        "<li>there is no such page"
        in requests.get(f"{server.address}/no", headers={"accept": "text/html"}, timeout=20).text
    )
    cookie = requests.get(server.address, timeout=20).headers["set-cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Lax" in cookie


def test_pages_hold_no_script_of_their_own_and_nothing_from_elsewhere(server, client):
    run = client.post(f"{server.address}/api/v1/predictions", json=EASY).json()["id"]
    for path in ("/", "/predict?scenario=panels", "/trade", "/validate", "/bring", "/runs", "/docs", f"/runs/{run}"):
        text = client.get(server.address + path).text
        assert "<script>" not in text
        assert "onclick" not in text
        assert "http://" not in text.replace(server.address, "").replace("http://127.0.0.1", "")


ROWS = {"scenario": {"scene": {"classes": [{"fraction": "q"}] * 4500}}}
WRONG = [
    *(({**EASY, **order}, field) for order, field in REFUSED["orders"]),
    ({"name": "x" * 5000}, "name"), (ROWS, "scenario.scene.classes"),
    ({**EASY, "settings": {"atmosphere.aot550": float("nan")}}, "atmosphere.aot550"),
    ({**EASY, "settings": {"processing.bands.ranges": [[1, 2]] * 6000}}, "processing.bands.ranges"),
    ({**EASY, "settings": {"a": [[1] * 4000] * 6}}, "a.4.3992"),
]  # fmt: skip


@pytest.mark.parametrize("case", range(len(WRONG)), ids=[field for _, field in WRONG])
def test_wrong_order_is_refused_at_its_field_at_once(server, client, case):
    order, field = WRONG[case]
    text = json.dumps(order)
    answer = client.post(f"{server.address}/api/v1/predictions", data=text, headers=JSON)
    assert answer.status_code == 422
    assert any(e["field"].endswith(field) for e in answer.json()["errors"]), answer.text


def test_body_of_too_much_is_refused_by_its_size_alone(server, client, monkeypatch):
    """A check of each of 4500 backgrounds took two thirds of a second."""
    monkeypatch.setattr("hyperval.scenario.Scenario.__pydantic_validator__", None)
    assert client.post(f"{server.address}/api/v1/predictions", json=ROWS).json()["errors"] == [
        {"field": "scenario.scene.classes", "message": "4,500 entries; at most 100 are taken"}]  # fmt: skip


def test_campaign_file_is_read_again_only_when_it_has_changed(make_server, tmp_path, monkeypatch):
    """To name a campaign that there is not took 0.7 s beside eleven that there are."""
    path = tmp_path / "campaigns" / "one" / "campaign.yaml"
    path.parent.mkdir(parents=True)
    path.write_text("name: one\ntitle: Line {line}")
    settings = ServerSettings(tmp_path, campaigns=tmp_path / "campaigns")
    assert [(c.name, c.title) for c in campaigns_of(settings)] == [("one", "Line …")]
    with monkeypatch.context() as patch:
        patch.setattr("hyperval.web.runs.load_yaml", None)
        assert [c.name for c in campaigns_of(settings)] == ["one"]
    path.write_text("name: another")
    assert [c.name for c in campaigns_of(settings)] == ["another"]


def scenario_with(**source):
    scene = {"classes": [{"name": "a", "fraction": 1, "spectrum": source}]}
    return {"name": "x", "sensor": "prospectir-vs", "atmosphere": None, "scene": scene}


@pytest.mark.parametrize(("source", "field"), REFUSED["sources"])
def test_files_of_the_server_are_not_named(server, client, source, field):
    answer = client.post(f"{server.address}/api/v1/predictions", json={"scenario": scenario_with(**source)})
    assert answer.status_code == 422
    assert f"scene.classes.0.spectrum.{field}" in [e["field"] for e in answer.json()["errors"]]


def test_number_beyond_all_numbers_and_depth_beyond_all_depth(server, client):
    url = f"{server.address}/api/v1/predictions"
    text = '{"name": "panels", "settings": {"atmosphere.aot550": 1e400}}'
    assert client.post(url, data=text, headers=JSON).json()["errors"][0]["field"] == "atmosphere.aot550"
    for body in ("[" * 100_000, '{"a":' * 50_000, '{"name": ' + "9" * 5000 + "}", *REFUSED["bodies"]):
        answer = client.post(url, data=body, headers=JSON)
        assert answer.status_code in (400, 422)
        assert answer.json()["errors"][0]["field"] in ("body", "name")


def test_study_of_a_thousand_million_points_is_refused(server, client):
    grid = {"start": 0, "stop": 1, "count": 1000}
    study = {
        "name": "x", "scenario": "panels",
        "inputs": [{"name": f"i{n}", "path": f"scene.classes.{n}.gain", "grid": grid}
                   for n in range(3)],
        "outputs": [{"name": "snr", "kind": "snr", "subject": "grass", "band_nm": 550}],
    }  # fmt: skip
    answer = client.post(f"{server.address}/api/v1/studies", json={"study": study})
    assert answer.status_code == 422
    assert "1,000,000,000 evaluations" in answer.json()["errors"][0]["message"]
    late = {"inputs": [{"name": "a", "path": "sensor", "values": ["prospectir-vs"] * 100 + ["/etc/passwd"]}]}
    for part, field in [*REFUSED["studies"], (late, "inputs.0.path")]:
        inputs = [{"name": "a", "path": "scene.classes.0.gain", "values": [1]}]
        own = {"study": {**study, "inputs": inputs, **part}}
        told = [client.post(f"{server.address}/api/v1/studies", json=each).json() for each in (own, own | {"more": 1})]
        assert (told[0]["errors"][0]["field"], told[1]["errors"][-1]["field"]) == (field, "more"), told


SENT = [*REFUSED["files"], ([["regions", "r.json", "a" * 4_100_000]], "regions")]


@pytest.mark.parametrize(("files", "field"), SENT)
def test_file_that_is_no_such_file_is_refused(server, client, files, field):
    sent = [(of, (name, text.encode("latin-1"))) for of, name, text in files]
    answer = client.post(f"{server.address}/api/v1/uploads", files=sent)
    assert answer.status_code == 422
    assert field in [e["field"] for e in answer.json()["errors"]]


def test_header_that_lies_about_its_cube_fails_and_names_no_path(server, client):
    lie = b"ENVI\nsamples = 100000\nlines = 100000\nbands = 1000\ndata type = 4\ninterleave = bsq\nbyte order = 0\n"
    files = [("cube", ("a.img", b"\x00" * 8)), ("header", ("a.hdr", lie)), ("regions", ("r.geojson", b"{}"))]
    answer = client.post(f"{server.address}/api/v1/uploads", files=files)
    assert (answer.status_code, answer.json()["errors"][0]["field"]) == (422, "cube")
    assert str(server.folder) not in answer.text


def raw(server, request: bytes) -> bytes:
    host, port = server.address.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=10) as s:
        s.sendall(request.replace(b"HOST", f"{host}:{port}".encode()))
        return s.recv(65536).split(b"\r\n")[0]


def test_large_body_is_refused_before_it_is_sent(server):
    start = b"POST /api/v1/predictions HTTP/1.1\r\nHost: HOST\r\n"
    assert b" 413 " in raw(server, start + b"Content-Length: 99999999999\r\n\r\n")
    assert b" 400 " in raw(server, start + b"Content-Length: -5\r\n\r\n")
    assert b" 415 " in raw(server, start + b"Content-Encoding: gzip\r\nContent-Length: 5\r\n\r\nabcde")
    chunk = b"%x\r\n%s\r\n" % (60_000, b"a" * 60_000)
    body = start + b"Content-Type: application/json\r\nTransfer-Encoding: chunked\r\n\r\n" + chunk * 20 + b"0\r\n\r\n"
    assert b" 413 " in raw(server, body)
    form = {"cube": ("a.zip", b"a" * 400_000)}
    assert requests.post(f"{server.address}/uploads", files=form, timeout=20).status_code == 422, "a file may be larger"


@pytest.mark.parametrize(
    "path",
    ["/static/../app.py", "/static/%2e%2e%2fapp.py", "/static/..%2f..%2fapp.py", "/runs/../../etc/passwd",
     "/runs/%2e%2e", "/runs/" + "a" * 16 + "/files/../run.json", "/static/.%00", "/" + "a" * 20_000],
)  # fmt: skip
def test_no_path_leads_out(server, client, path):
    assert client.get(server.address + path).status_code in (404, 414, 422)


def test_files_of_a_run_are_those_it_offers(server, client):
    run = client.post(f"{server.address}/api/v1/predictions", json=EASY).json()["id"]
    for name in ("run.json", "charts.json", "..%2frun.json", "%2fetc%2fpasswd", "figures/..", ""):
        assert client.get(f"{server.address}/api/v1/runs/{run}/files/{name}").status_code in (404, 405)


def test_error_that_nobody_foresaw_says_nothing_of_the_server(server, client, monkeypatch):
    def broken(*args, **options):
        raise RuntimeError(f"at {server.folder}")

    monkeypatch.setattr(server.app.state.runs, "visible_to", broken)
    answer = client.get(f"{server.address}/api/v1/runs")
    assert answer.status_code == 500
    assert str(server.folder) not in answer.text
    assert "Traceback" not in answer.text


def test_too_many_runs_of_one_session_and_a_full_queue(make_server):
    small = make_server(per_session=2, queue=3)
    small.quick.gate.clear()
    url = f"{small.address}/api/v1/predictions?wait=0"
    first, second = small.session(), small.session()
    assert [first.post(url, json=EASY).status_code for _ in range(3)] == [201, 201, 429]
    # One is at the worker, three wait.
    assert awaited(lambda: small.quick.waiting.qsize() == 1)
    assert [second.post(url, json=EASY).status_code for _ in range(2)] == [201, 201]
    answer = small.session().post(url, json=EASY)
    assert answer.status_code == 503
    assert int(answer.headers["retry-after"]) > 0
    small.quick.gate.set()
    run = first.get(f"{small.address}/api/v1/runs").json()[0]["id"]
    assert first.get(f"{small.address}/api/v1/runs/{run}", params={"wait": 20}).json()["state"] == "finished"
