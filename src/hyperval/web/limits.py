"""What one server takes on, and how long it keeps what came of it."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

MEGABYTE = 1_000_000
LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


@dataclass(frozen=True)
class Limits:
    """Bounds of one server.

    Attributes
    ----------
    body_bytes, upload_bytes : of one request; of one that brings a file
    quick_seconds, long_seconds : of a prediction or chart; of a study, campaign or pipeline
    memory_bytes : of one worker
    quick_workers, long_workers : processes of either kind
    queue : runs that wait, of either kind; per_session : runs of one session that wait or run
    kept_bytes, kept_days : finished runs and uploads; the oldest go first
    points : of a study;  pixels : of an uploaded cube, times its bands
    """

    body_bytes: int = 300_000
    upload_bytes: int = 64 * MEGABYTE
    quick_seconds: float = 60.0
    long_seconds: float = 3600.0
    memory_bytes: int = 3_000 * MEGABYTE
    quick_workers: int = 2
    long_workers: int = 1
    queue: int = 64
    per_session: int = 8
    kept_bytes: int = 5_000 * MEGABYTE
    kept_days: float = 30.0
    points: int = 20_000
    samples: int = 100_000_000


@dataclass(frozen=True)
class Settings:
    """How one server is run.

    Attributes
    ----------
    folder : runs, uploads, index;  campaigns : folder of campaigns that may be run, None: none
    data : folder whose cubes and regions may be named, None: none
    hosts : names under which browsers reach it
    secure : whether it is reached by HTTPS alone, through a proxy
    """

    folder: Path
    campaigns: Path | None = None
    hosts: tuple[str, ...] = LOOPBACK
    secure: bool = False
    limits: Limits = field(default_factory=Limits)
    data: Path | None = None
