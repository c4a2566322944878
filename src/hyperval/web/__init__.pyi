"""The web application: pages and a JSON API over the verbs of the package, served to browsers on this machine."""

from .app import make_app
from .forms import form_data, form_nodes, needs, plain, predefined
from .guard import POLICY, connections_of
from .predictions import walk
from .runs import campaigns_of
from .store import (
    LOOPBACK,
    MEGABYTE,
    TASKS,
    Cancelled,
    Full,
    Runs,
    ServerSettings,
    TaskFailed,
    WebRun,
    WorkerPool,
    WorkerTask,
    carried_out,
    view_name,
)

__all__ = [
    "LOOPBACK", "MEGABYTE", "POLICY", "TASKS", "Cancelled", "Full", "Runs", "ServerSettings", "TaskFailed", "WebRun",
    "WorkerPool", "WorkerTask", "campaigns_of", "carried_out", "connections_of", "form_data", "form_nodes",
    "make_app", "needs", "plain", "predefined", "view_name", "walk",
]  # fmt: skip
