"""One file from a public address into a folder: whole, of the right content, or not at all."""

from __future__ import annotations

import gzip
from pathlib import Path
from time import monotonic
from typing import Any

from hyperval.errors import InputError
from hyperval.files import has_digest, scratch_folder, whole_file

ATTEMPTS = 3
TIMEOUT_S = 60
# Small, since nothing is seen of a chunk before it is full; the registered files have a few MB at most.
CHUNK_BYTES = 1 << 8
PATIENCE_S = 60.0
LEAST_BYTES_PER_S = 200.0


def download(address: str, target: Path, *, size: int, digest: str, pack: bool = False, mend: str = "") -> Path:
    """Bring the file at ``address`` to ``target`` and return ``target``.

    Parameters
    ----------
    size, digest : of the published content, as ``sha256:HEX`` or ``git-blob:HEX``; an answer that grows past
        ``size`` is cut off
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

    def attempt(url: str, output: str, _: Any) -> None:
        _stream(url, output, size)
        if not has_digest(Path(output), digest):
            raise ValueError("another content")

    try:
        with scratch_folder("fetch", target.parent) as folder:
            # A folder for this process alone: others may fetch the same file at this moment.
            store = pooch.create(
                folder,
                base_url="",
                registry={"published": None},  # checked above: git's digest is none of pooch's
                urls={"published": address},
                retry_if_failed=ATTEMPTS - 1,
            )
            published = Path(store.fetch("published", downloader=attempt))
            with whole_file(target) as temporary:
                # No time in the header: the same content gives the same bytes.
                content = published.read_bytes()
                temporary.write_bytes(gzip.compress(content, mtime=0) if pack else content)
    except _TooSlow as error:
        raise InputError(f"cannot be downloaded: {error}", where=address, mend=mend) from error
    except requests.RequestException as error:
        raise InputError(f"cannot be downloaded: {_reason(error)}", where=address, mend=mend) from error
    except ValueError as error:
        raise InputError(
            "what was downloaded is not the registered file",
            where=address,
            expected=f"{size} bytes, {digest}",
            mend=mend,
        ) from error
    except OSError as error:
        raise InputError(f"cannot write: {error.strerror or error}", where=str(target)) from error
    return target


class _TooSlow(Exception):
    """A server that sends so little that it is given up, and not asked again."""


def _stream(address: str, output: str, size: int) -> None:
    """Write the answer to ``output``.

    An answer longer than ``size`` bytes is cut off with ValueError, one that comes at less than
    LEAST_BYTES_PER_S over PATIENCE_S with _TooSlow.
    """
    import requests

    received, since, mark = 0, monotonic(), 0
    with requests.get(address, stream=True, timeout=TIMEOUT_S) as answer, open(output, "wb") as stream:
        answer.raise_for_status()
        for chunk in answer.iter_content(CHUNK_BYTES):
            received += len(chunk)
            if received > size:
                raise ValueError("the answer is longer than the registered file")
            stream.write(chunk)
            passed = monotonic() - since
            if passed > PATIENCE_S:
                if received - mark < LEAST_BYTES_PER_S * passed:
                    raise _TooSlow(f"the server sends {(received - mark) / passed:.0f} bytes a second")
                since, mark = monotonic(), received


def _reason(error: Exception) -> str:
    """The cause in a few words: the text of the exception repeats the address several times."""
    import requests

    if isinstance(error, requests.HTTPError) and error.response is not None:
        return f"the server answered {error.response.status_code}"
    if isinstance(error, requests.Timeout):
        return "no answer in time"
    return "no connection" if isinstance(error, requests.ConnectionError) else type(error).__name__
