"""Settings of the rendered documentation: ``make docs`` builds it into ``build/docs``; nothing is fetched."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

from docutils import nodes

import hyperval

# The examples print nothing of the machine that they ran on, and leave no progress bars behind.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

project = "hyperval"
release = version = hyperval.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx_gallery.gen_gallery"]
exclude_patterns = ["examples/*", "gallery/*.md5", "gallery/*.ipynb"]
templates_path: list[str] = []

html_theme = "furo"
html_title = f"hyperval {release}"
html_copy_source = False
html_show_copyright = False
html_static_path = ["static"]
html_css_files = ["dark.css"]

myst_heading_anchors = 4
myst_enable_extensions = ["html_image"]
# Files of the repository that are named by the documents and are not documents themselves.
suppress_warnings = ["myst.xref_missing", "myst.header", "config.cache", "ref.python"]
# The notebook is kept without outputs, and runs here.
nb_execution_mode = "force"
nb_execution_raise_on_error = True
nb_execution_timeout = 300

autodoc_typehints = "signature"
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True

sphinx_gallery_conf = {
    "examples_dirs": "examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "within_subsection_order": "FileNameSortKey",
    "capture_repr": ("_repr_html_",),
    "show_memory": False,
    "show_signature": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
    "download_all_examples": False,
    "abort_on_example_error": True,
}


def errors_as_list(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Errors of a docstring as a list: ``Raises`` has "NAME, NAME : when" on lines of their own."""
    if "Raises" not in lines:
        return
    start = lines.index("Raises")
    text = " ".join(line.strip() for line in lines[start + 2 :])
    parts = re.split(r"(?:^|(?<=[.;]) )((?:\w+Error(?:, )?)+) : ", text)[1:]
    lines[start:] = ["**Raises**", ""]
    for names, when in zip(parts[::2], parts[1::2], strict=True):
        lines += [f"- {', '.join(f'``{n}``' for n in names.split(', '))}: {when.strip()}"]
    lines.append("")


def write_reference(app: Any) -> None:
    """The pages that are made from the code: every command, key and metric."""
    for page in ("commands", "files", "metrics"):
        script = Path(app.srcdir).parent / "scripts" / f"{page}_page.py"
        subprocess.run([sys.executable, str(script), "--write"], check=True)  # noqa: S603


def link_files(app: Any, page: str, source: list[str]) -> None:
    """Pages of the repository that are none of the documentation are linked as files."""
    source[0] = re.sub(r"\]\((\.\./[^)#\s]+\.md)(?:#[\w-]+)?\)", r"](<path:\1>)", source[0])


def add_dark_twins(app: Any, tree: nodes.document) -> None:
    """A picture NAME.png with NAME-dark.png beside it is shown on light screens, its twin on dark ones."""
    for image in list(tree.findall(nodes.image)):
        twin = image["uri"].removesuffix(".png") + "-dark.png"
        if (Path(app.srcdir) / app.env.docname / ".." / twin).resolve().is_file():
            dark = image.deepcopy()
            dark["uri"] = twin
            dark["classes"], image["classes"] = [*image["classes"], "only-dark"], [*image["classes"], "only-light"]
            image.parent.insert(image.parent.index(image) + 1, dark)


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("source-read", link_files)
    app.connect("doctree-read", add_dark_twins, priority=400)
    app.connect("builder-inited", write_reference)
    app.connect("autodoc-process-docstring", errors_as_list, priority=400)
