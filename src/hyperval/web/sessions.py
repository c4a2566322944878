"""Who asks: a random name in a cookie, and a token that goes along with whatever changes something."""

from __future__ import annotations

import hashlib
import hmac
import os
import re
import secrets
from dataclasses import dataclass
from pathlib import Path

COOKIE = "hyperval_session"
TOKEN_HEADER = "x-hyperval-token"  # noqa: S105 - a name
_NAME = re.compile(r"[A-Za-z0-9_-]{43}")
_SECRET_BYTES = 32


@dataclass(frozen=True)
class Session:
    """One browser or program.

    Attributes
    ----------
    name : what the cookie holds; whoever knows it is the session
    owner : what its runs are stored under, from which the name does not follow
    token : what a change must bring along
    is_new : whether the cookie is still to be set
    """

    name: str
    owner: str
    token: str
    is_new: bool


class Sessions:
    """Sessions of a server; the secret that makes their tokens stands in a file, so that they outlive a restart."""

    def __init__(self, folder: Path):
        path = folder / "secret"
        try:
            handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        except FileExistsError:
            pass
        else:
            with os.fdopen(handle, "wb") as file:
                file.write(secrets.token_bytes(_SECRET_BYTES))
        self._secret = path.read_bytes()
        if len(self._secret) != _SECRET_BYTES:  # cut off by a full disk: sessions begin anew
            self._secret = secrets.token_bytes(_SECRET_BYTES)
            path.write_bytes(self._secret)

    def session(self, name: str | None) -> Session:
        """The session of a cookie, or a new one where there is none or it is malformed."""
        known = name is not None and _NAME.fullmatch(name) is not None
        own = name if known and name is not None else secrets.token_urlsafe(32)
        owner = hashlib.sha256(b"owner" + own.encode()).hexdigest()[:32]
        token = hmac.new(self._secret, own.encode(), hashlib.sha256).hexdigest()
        return Session(own, owner, token, not known)

    @staticmethod
    def is_token(session: Session, given: str | None) -> bool:
        """Whether a token is that of the session, in a time that does not tell how much of it is."""
        return given is not None and hmac.compare_digest(given.encode(), session.token.encode())
