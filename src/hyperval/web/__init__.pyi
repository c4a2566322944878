"""The web application: pages and a JSON API over the verbs of the package, served to browsers on this machine."""

from .app import make_app
from .forms import form_data, form_nodes, needs, plain, predefined
from .guard import POLICY, connections_of
from .predictions import walk
from .refusal import said
from .runs import campaigns_of
from .store import (
    LOOPBACK,
    MEGABYTE,
    Cancelled,
    Full,
    Runs,
    ServerSettings,
    TaskFailed,
    WebRun,
    WorkerPool,
    WorkerTask,
    view_name,
)

__all__ = [
    "LOOPBACK", "MEGABYTE", "POLICY", "Cancelled", "Full", "Runs", "ServerSettings", "TaskFailed", "WebRun",
    "WorkerPool", "WorkerTask", "campaigns_of", "connections_of", "form_data", "form_nodes", "make_app", "needs",
    "plain", "predefined", "said", "view_name", "walk",
]  # fmt: skip
