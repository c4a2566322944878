"""Clients that send too slowly or open too much, at the command: the server ends them and answers the others."""

import shlex
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest
import requests

pytest.importorskip("fastapi", reason="needs the extra web")

pytestmark = pytest.mark.slow  # limits of time are waited for
HOST = "127.0.0.1"
MOST = 40  # connections of one address
PATIENCE_S = 25.0  # limits of 10 s, on a busy machine
HEAD = b"POST /api/v1/predictions HTTP/1.1\r\nHost: localhost\r\nContent-Type: application/json\r\n"


@pytest.fixture(scope="module")
def port(tmp_path_factory) -> Iterator[int]:
    """The port of a server of its own process."""
    with socket.socket() as free:
        free.bind((HOST, 0))
        number = free.getsockname()[1]
    command = [sys.executable, "-m", "hyperval", "serve", "--port", str(number), "--workers", "1",
               "--folder", str(tmp_path_factory.mktemp("web")), "--connections", str(MOST)]  # fmt: skip
    with subprocess.Popen(["sh", "-c", f"ulimit -n 400; exec {shlex.join(command)}"]) as server:
        try:
            for _ in range(600):
                with suppress(requests.ConnectionError):  # it listens before it has loaded what answers
                    if requests.get(f"http://{HOST}:{number}/api/v1/sensors", timeout=60).ok:
                        break
                time.sleep(0.2)
            yield number
        finally:
            server.terminate()


def still_open(sockets: list[socket.socket], seconds: float) -> int:
    """How many the server has not ended after so long."""
    end, left = time.monotonic() + seconds, list(sockets)
    while left and time.monotonic() < end:
        for one in list(left):
            one.settimeout(0.05)
            with suppress(TimeoutError):
                with suppress(ConnectionError):
                    while one.recv(65536):
                        pass
                left.remove(one)
    return len(left)


def test_slow_heads_and_bodies_are_ended_and_others_are_answered(port):
    """3 x 12 connections, each sends a byte or a head and then nothing more."""
    parts = (b"", HEAD, HEAD + b"Content-Length: 1000\r\n\r\n{")
    with ExitStack() as stack:
        slow = [stack.enter_context(socket.create_connection((HOST, port), timeout=5)) for _ in range(36)]
        for number, one in enumerate(slow):
            one.sendall(parts[number % 3])
        assert requests.get(f"http://{HOST}:{port}/api/v1/sensors", timeout=10).status_code == 200
        assert still_open(slow, 2.0) == 36
        assert still_open(slow, PATIENCE_S) == 0


def test_body_that_comes_slowly_but_fast_enough_is_taken(port):
    body = b'{"name": "' + b"x" * 160_000 + b'"}'
    with socket.create_connection((HOST, port), timeout=20) as one:
        one.sendall(HEAD + b"Content-Length: %d\r\n\r\n" % len(body))
        step = len(body) // 24 + 1
        for at in range(0, len(body), step):  # 12 s, 13 kB in each
            one.sendall(body[at : at + step])
            time.sleep(0.5)
        assert one.recv(65536).startswith(b"HTTP/1.1 422 ")


def test_client_with_too_many_connections_loses_its_oldest(port):
    with ExitStack() as stack:
        many = [stack.enter_context(socket.create_connection((HOST, port), timeout=5)) for _ in range(3 * MOST)]
        for one in many:
            one.sendall(b"GET / HTTP/1.1\r\n")
        assert requests.get(f"http://{HOST}:{port}/api/v1/sensors", timeout=10).status_code == 200
        assert still_open(many[:MOST], 2.0) == 0  # long before the limit of time
        assert still_open(many[2 * MOST + 1 :], 1.0) == MOST - 1


def test_half_sent_heads_of_many_addresses_leave_room_for_others(port):
    with ExitStack() as stack:
        for number in range(800):
            one = stack.enter_context(socket.create_connection((HOST, port), 5, (f"127.0.0.{2 + number % 25}", 0)))
            one.sendall(b"GET / HTTP/1.1\r\n")
        assert requests.get(f"http://{HOST}:{port}/api/v1/sensors", timeout=5).status_code == 200
