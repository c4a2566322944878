"""One file from a public address into a folder: whole, of the right content, or not at all."""

from __future__ import annotations

import gzip
from pathlib import Path
from typing import Any

from hyperval.errors import InputError
from hyperval.files import whole_file

ATTEMPTS = 3
TIMEOUT_S = 60
CHUNK_BYTES = 1 << 14


def download(address: str, target: Path, *, size: int, sha256: str, pack: bool = False, mend: str = "") -> Path:
    """Bring the file at ``address`` to ``target`` and return ``target``.

    Parameters
    ----------
    size, sha256 : of the published content; an answer that grows past ``size`` is cut off
    pack : keep the content gzip-compressed at ``target``, whose name then ends in ``.gz``
    mend : what the user can do when it fails

    Raises
    ------
    InputError : no connection, another content, or no room to write; nothing stands at ``target`` then.
    """
    # Imported here: only a download needs a network client, and its import is slow.
    import pooch
    import requests

    pooch.get_logger().setLevel("WARNING")
    published = target.with_suffix("") if pack else target
    store = pooch.create(
        published.parent,
        base_url="",
        registry={published.name: f"sha256:{sha256}"},
        urls={published.name: address},
        retry_if_failed=ATTEMPTS - 1,
    )

    def attempt(url: str, output: str, _: Any) -> None:
        _stream(url, output, size)

    try:
        store.fetch(published.name, downloader=attempt)
        if pack:
            with whole_file(target) as temporary:
                # No time in the header: the same content gives the same bytes.
                temporary.write_bytes(gzip.compress(published.read_bytes(), mtime=0))
            published.unlink()
    except requests.RequestException as error:
        raise InputError(f"cannot be downloaded: {_reason(error)}", where=address, mend=mend) from error
    except ValueError as error:
        raise InputError(
            "what was downloaded is not the registered file",
            where=address,
            expected=f"{size} bytes, SHA-256 {sha256}",
            mend=mend,
        ) from error
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror or error}", where=str(target)) from error
    return target


def _stream(address: str, output: str, size: int) -> None:
    """Write the answer to ``output``; an answer longer than ``size`` bytes is cut off with ValueError."""
    import requests

    received = 0
    with requests.get(address, stream=True, timeout=TIMEOUT_S) as answer, open(output, "wb") as stream:
        answer.raise_for_status()
        for chunk in answer.iter_content(CHUNK_BYTES):
            received += len(chunk)
            if received > size:
                raise ValueError("the answer is longer than the registered file")
            stream.write(chunk)


def _reason(error: Exception) -> str:
    """The cause in a few words: the text of the exception repeats the address several times."""
    import requests

    if isinstance(error, requests.HTTPError) and error.response is not None:
        return f"the server answered {error.response.status_code}"
    if isinstance(error, requests.Timeout):
        return "no answer in time"
    return "no connection" if isinstance(error, requests.ConnectionError) else type(error).__name__
