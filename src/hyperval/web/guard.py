"""What every request passes: host, size, session, origin, and the security headers of every response.

A session is a random name in a cookie, which pages of other sites can neither read nor send with a change.  Headers and
bodies arrive in time or the connection ends; a client has a bounded number of connections.
"""

from __future__ import annotations

import asyncio
import hashlib
import math
import os
import re
import secrets
import sys
from http import HTTPStatus
from typing import ClassVar
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.requests import ClientDisconnect, cookie_parser
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from hyperval.errors import internal_error, package_table
from hyperval.web.refusal import FieldMistake, deny, json_error
from hyperval.web.store import ServerSettings

COOKIE = "hyperval_session"
_NAME = re.compile(r"[A-Za-z0-9_-]{43}")
_PORT = re.compile(r"(?<=[^:]):\d+$")


_SAFE = ("GET", "HEAD", "OPTIONS")
_YEAR_S = 365 * 24 * 3600
_MAX_URL = 16_384
_HEADERS = package_table("web/answers.yaml")["headers"]
POLICY = _HEADERS["content-security-policy"]


class RequestGuard:
    """The outermost layer of the application."""

    def __init__(self, app: ASGIApp, settings: ServerSettings):
        self.app, self.settings = app, settings

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or hand it on with its session."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return  # there are no web sockets
        headers, settings = Headers(scope=scope), self.settings
        is_upload = scope["path"].removeprefix("/api/v1").startswith("/uploads")
        bound = settings.upload_bytes if is_upload else settings.body_bytes
        # Whoever knows the name is the session; it is new where the cookie has none, or a malformed one.
        cookie = cookie_parser(headers.get("cookie", "")).get(COOKIE, "")
        is_new = _NAME.fullmatch(cookie) is None
        name = secrets.token_urlsafe(32) if is_new else cookie
        # What its runs are stored under, from which the name does not follow.
        scope["owner"] = hashlib.sha256(b"owner" + name.encode()).hexdigest()[:32]
        refusal = self._refusal(scope, headers, bound)
        size, is_started = 0, False

        async def receive_bounded() -> Message:
            nonlocal size
            message = await receive()
            size += len(message.get("body", b""))
            deny(size > bound, 413, f"larger than {bound:,} bytes", "body")
            return message

        async def send_answer(message: Message) -> None:
            nonlocal is_started
            if message["type"] == "http.response.start":
                is_started = True
                # What another site's page sent comes without the cookie: its answer must not replace the user's.
                self._add_headers(MutableHeaders(scope=message), name if is_new and refusal is None else None)
            await send(message)

        try:
            await (refusal or self.app)(scope, receive_bounded, send_answer)
        except ClientDisconnect:
            pass  # nobody is there to be told
        except Exception as error:
            print(f"hyperval serve: {internal_error(error)}", file=sys.stderr)
            if not is_started:
                words = "an internal error; the server's log has it"
                await json_error(500, [FieldMistake("", words)])(scope, receive_bounded, send_answer)

    def _refusal(self, scope: Scope, headers: Headers, bound: int) -> JSONResponse | None:
        host, stated = headers.get("host", ""), headers.get("content-length", "0")
        origin, site = headers.get("origin"), headers.get("sec-fetch-site", "same-origin")
        is_number = stated.isascii() and stated.isdigit() and len(stated) < 19
        is_other = (origin is not None and urlsplit(origin).netloc != host) or site not in ("same-origin", "none")
        rules = [
            (len(headers.getlist("host")) == 1 and _PORT.sub("", host).lower() in self.settings.hosts,
             400, "host", "this server does not go by that name"),
            (len(scope.get("raw_path") or b"") + len(scope.get("query_string") or b"") <= _MAX_URL,
             414, "url", f"longer than {_MAX_URL:,} bytes"),
        ]  # fmt: skip
        rules += [] if scope["method"] in _SAFE else [
            (is_number, 400, "content-length", "no number of bytes"),
            (is_number and int(stated) <= bound, 413, "body", f"{stated} bytes; at most {bound:,} are taken"),
            (headers.get("content-encoding", "identity") == "identity",
             415, "content-encoding", "bodies are taken as they are, not compressed"),
            (not is_other, 403, "origin", "a page of another site asked for this"),
        ]  # fmt: skip
        bad = (json_error(status, [FieldMistake(field, words)]) for holds, status, field, words in rules if not holds)
        return next(bad, None)

    def _add_headers(self, headers: MutableHeaders, session: str | None) -> None:
        """Add the headers of every answer, and the cookie of a new session."""
        for name, value in _HEADERS.items():
            headers.setdefault(name, value)
        if session is not None and not headers["cache-control"].startswith("public"):
            secure = "; Secure" if self.settings.secure else ""
            cookie = f"{COOKIE}={session}; Path=/; Max-Age={_YEAR_S}; HttpOnly; SameSite=Lax{secure}"
            headers.append("set-cookie", cookie)


HEAD_S = 10.0  # from the first byte that is waited for to the end of the head
BODY_S = 10.0  # a body may take so long, and a second more for each MIN_BYTES of it
MIN_BYTES = 10_000
_LOOK_S = 0.5
_FILES = 256  # open at a time besides connections
_HEAD, _BODY = "IDLE", "SEND_BODY"  # what h11 calls the states of a client that sends them


class _Connection(H11Protocol):
    """One connection.

    A client that has as many as it may loses the oldest of those that ask for nothing when it opens another, and so do
    all together when the process can have few files more; where all of them are at work, the new one is refused.
    """

    most: ClassVar[int]
    most_of_all: ClassVar[int]
    every: ClassVar[set[_Connection]]
    _timer: asyncio.TimerHandle | None = None
    _awaited = ""
    _begun = 0.0
    _received = 0

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count the connection, and wait for its first head."""
        super().connection_made(transport)
        same = [one for one in self.every if one._address == self._address]
        if len(same) >= self.most or len(self.every) >= self.most_of_all:
            crowd = same if len(same) >= self.most else self.every
            idle = min((c for c in crowd if repr(c.conn.their_state) == _HEAD), key=lambda c: c._begun, default=None)
            if idle is None:
                self._close(503)
                return
            self.every.remove(idle)
            idle._close(408)
        self.every.add(self)
        self._check_deadline()

    def data_received(self, data: bytes) -> None:
        """Take what came, and see what is waited for now."""
        self._received += len(data)
        super().data_received(data)
        self._restart_clock()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        super().connection_lost(exc)
        if self._timer is not None:
            self._timer.cancel()
        self.every.discard(self)

    @property
    def _address(self) -> str:
        return self.client[0] if self.client else ""

    def _restart_clock(self) -> None:
        """Count anew where something else is waited for than before, or the delay is this server's own."""
        state = repr(self.conn.their_state)
        if state != self._awaited or self.flow.read_paused:
            self._awaited, self._begun, self._received = state, self.loop.time(), 0

    def _check_deadline(self) -> None:
        """End the connection where a head or a body has not come in time; look again in a moment."""
        self._restart_clock()
        seconds = {_HEAD: HEAD_S, _BODY: BODY_S + self._received / MIN_BYTES}.get(self._awaited, math.inf)
        if self.loop.time() - self._begun > seconds:
            self._close(408)
        else:
            self._timer = self.loop.call_later(_LOOK_S, self._check_deadline)

    def _close(self, status: int) -> None:
        if self.cycle is None or self.cycle.response_complete:
            head = f"HTTP/1.1 {status} {HTTPStatus(status).phrase}\r\ncontent-length: 0\r\nconnection: close\r\n\r\n"
            self.transport.write(head.encode())
        self.transport.close()


def connection_class(most: int) -> type[H11Protocol]:
    """The class of a server's connections, of which one address has at most ``most`` at a time."""
    of_all = max(16, os.sysconf("SC_OPEN_MAX") - _FILES)
    return type("Connection", (_Connection,), {"most": most, "most_of_all": of_all, "every": set()})
