"""The web application: pages and a JSON API over the verbs of the package, served to browsers on this machine."""

from .app import make_app
from .forms import dump, form_data, form_nodes, needs, predefined
from .guard import POLICY, connection_class
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
    perform_task,
    view_name,
)

__all__ = [
    "LOOPBACK", "MEGABYTE", "POLICY", "TASKS", "Cancelled", "Full", "Runs", "ServerSettings", "TaskFailed", "WebRun",
    "WorkerPool", "WorkerTask", "campaigns_of", "connection_class", "dump", "form_data", "form_nodes", "make_app",
    "needs", "perform_task", "predefined", "view_name", "walk",
]  # fmt: skip
