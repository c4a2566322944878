"""What every request passes: host, size, session, origin; and the headers that every answer bears."""

from __future__ import annotations

import json
import sys
from http.cookies import CookieError, SimpleCookie
from urllib.parse import urlsplit

from starlette.datastructures import Headers, MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hyperval.errors import internal_error
from hyperval.web.limits import Settings
from hyperval.web.sessions import COOKIE, TOKEN_HEADER, Sessions

UPLOADS = "/uploads"
_SAFE = ("GET", "HEAD", "OPTIONS")
_YEAR_S = 365 * 24 * 3600
_MOST_URL = 16_384
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; "
    "connect-src 'self'; font-src 'self'; form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
)
_HEADERS = {
    "content-security-policy": POLICY,
    "x-content-type-options": "nosniff",
    "x-frame-options": "DENY",
    "referrer-policy": "same-origin",
    "cross-origin-opener-policy": "same-origin",
    "cross-origin-resource-policy": "same-origin",
    "permissions-policy": "camera=(), geolocation=(), microphone=()",
}


class TooLarge(Exception):
    """A body that is larger than it said, or said nothing."""


class Guard:
    """The outermost layer of the application."""

    def __init__(self, app: ASGIApp, settings: Settings, sessions: Sessions):
        self.app, self.settings, self.sessions = app, settings, sessions

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Refuse a request, or hand it on with its session."""
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self.app(scope, receive, send)
            return  # there are no web sockets
        headers = Headers(scope=scope)
        session = self.sessions.session(_cookie(headers))
        scope["session"] = session
        bound = self._bound(scope["path"])
        answer = _Answer(send, self.settings, session.name if session.is_new else None)
        refusal = self._refusal(scope, headers, bound, session.is_new)
        if refusal is not None:
            await answer.refuse(*refusal)
            return
        seen = 0

        async def counted() -> Message:
            nonlocal seen
            message = await receive()
            seen += len(message.get("body", b""))
            if seen > bound:
                await answer.refuse(413, "body", f"larger than {bound:,} bytes")
                raise TooLarge
            return message

        try:
            await self.app(scope, counted, answer)
        except TooLarge:
            pass  # that is said
        except Exception as error:
            print(f"hyperval serve: {internal_error(error)}", file=sys.stderr)
            await answer.refuse(500, "", "an error that nobody foresaw; the server's log has it")

    def _bound(self, path: str) -> int:
        limits = self.settings.limits
        return limits.upload_bytes if path.removeprefix("/api/v1").startswith(UPLOADS) else limits.body_bytes

    def _refusal(self, scope: Scope, headers: Headers, bound: int, is_new: bool) -> tuple[int, str, str] | None:
        host = headers.get("host", "")
        if len(headers.getlist("host")) != 1 or _name_of(host) not in self.settings.hosts:
            return 400, "host", "this server does not go by that name"
        if len(scope.get("raw_path") or b"") + len(scope.get("query_string") or b"") > _MOST_URL:
            return 414, "url", f"longer than {_MOST_URL:,} bytes"
        if scope["method"] in _SAFE:
            return None
        stated = headers.get("content-length")
        if stated is not None and not (stated.isascii() and stated.isdigit() and len(stated) < 19):
            return 400, "content-length", "no number of bytes"
        if stated is not None and int(stated) > bound:
            return 413, "body", f"{int(stated):,} bytes; at most {bound:,} are taken"
        if headers.get("content-encoding", "identity") != "identity":
            return 415, "content-encoding", "bodies are taken as they are, not compressed"
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != host:
            return 403, "origin", "a page of another site asked for this"
        if headers.get("sec-fetch-site", "same-origin") not in ("same-origin", "none"):
            return 403, "origin", "a page of another site asked for this"
        # A request without a cookie has no runs that a foreign page could touch.
        token = headers.get(TOKEN_HEADER)
        if token is not None and not is_new and not self.sessions.is_token(scope["session"], token):
            return 403, TOKEN_HEADER, "not the token of this session"
        return None


class _Answer:
    """Sends an answer with the headers of every one, once."""

    def __init__(self, send: Send, settings: Settings, new_session: str | None):
        self._send, self._settings, self._new_session = send, settings, new_session
        self.started = self.ended = False

    async def __call__(self, message: Message) -> None:
        if self.ended:  # refused before the application had its say
            return
        if message["type"] == "http.response.start":
            self.started = True
            headers = MutableHeaders(scope=message)
            for name, value in _HEADERS.items():
                headers.setdefault(name, value)
            headers.setdefault("cache-control", "no-store")
            if self._new_session is not None and not headers["cache-control"].startswith("public"):
                secure = "; Secure" if self._settings.secure else ""
                headers.append(
                    "set-cookie",
                    f"{COOKIE}={self._new_session}; Path=/; Max-Age={_YEAR_S}; HttpOnly; SameSite=Lax{secure}",
                )
        await self._send(message)

    async def refuse(self, status: int, field: str, words: str) -> None:
        """An answer that names the field."""
        if self.started:
            return
        body = json.dumps({"errors": [{"field": field, "message": words}]}).encode()
        headers = [(b"content-type", b"application/json"), (b"content-length", str(len(body)).encode())]
        if status == 413:
            headers.append((b"connection", b"close"))
        await self({"type": "http.response.start", "status": status, "headers": headers})
        await self._send({"type": "http.response.body", "body": body})
        self.ended = True


def _cookie(headers: Headers) -> str | None:
    try:
        morsel = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
    except CookieError:
        return None
    return None if morsel is None else morsel.value


def _name_of(host: str) -> str:
    """A host without its port."""
    name, colon, port = host.rpartition(":")
    return name.lower() if colon and port.isdigit() and (not name.endswith(":")) else host.lower()
