"""Every command, section and key that a message of the program or a page names is there."""

from __future__ import annotations

import ast
import importlib
import pkgutil
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from string import Formatter

import click
import yaml
from typer.main import get_command

import hyperval
from hyperval.cli import app
from hyperval.config import Model
from hyperval.metrics import table

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(p for p in (ROOT / "src/hyperval").rglob("*") if p.suffix in (".py", ".j2", ".yaml", ".html"))
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
# What follows the program's name where it is the subject of a sentence, or of an import.
PROSE = re.compile(r"import|atmospheric|over|with|[a-z]+s")  # "hyperval serves", "hyperval statistics"


@cache
def commands() -> dict[str, click.Command]:
    """ "data fetch" -> the command."""
    found: dict[str, click.Command] = {}

    def walk(prefix: str, command: click.Command) -> None:
        found[prefix] = command
        for name, inner in getattr(command, "commands", {}).items():
            walk(f"{prefix} {name}".strip(), inner)

    walk("", get_command(app))
    return found


def wrong_commands(text: str) -> list[str]:
    """Mentions of a command that is not there, or of an option that it does not have."""
    known, wrong = commands(), []
    for mention in re.finditer(r"\bhyperval ((?:-[qv] )*)([a-z][a-z-]*)((?: [^\s`\"'<>;)]+)*)", text):
        words = [mention[2], *mention[3].split()]
        if words[0] not in known:
            wrong += [] if PROSE.fullmatch(words[0]) else [mention[0]]
            continue
        name = words[0]
        if len(words) > 1 and f"{name} {words[1]}" in known:
            name = f"{name} {words[1]}"
        options = {o for c in ("", words[0], name) for p in known[c].params for o in (*p.opts, *p.secondary_opts)}
        named = re.findall(r"(?<!\S)(--[a-z-]+)", " ".join(words).partition(", ")[0].partition(". ")[0])
        wrong += [f"{mention[0]!r}: {o}" for o in named if o not in options | {"--help"}]
    return wrong


def test_commands_that_are_named_are_there():
    found = {p.name: wrong for p in (*SOURCES, *PAGES) if (wrong := wrong_commands(p.read_text("utf-8")))}
    assert found == {}


def test_a_command_and_an_option_that_are_not_there_are_seen():
    assert wrong_commands("run hyperval chekc x.yaml") == ["hyperval chekc x.yaml"]
    assert wrong_commands("run hyperval check x.yaml --sensor y") == ["'hyperval check x.yaml --sensor y': --sensor"]


def test_examples_of_metrics_name_files_that_are_there():
    examples = {m.example for m in table().values() if m.example.startswith("hyperval ")}
    assert examples
    for example in examples:
        command, *words = example.split()[1:]
        if command in ("validate", "check", "benchmark", "study"):
            plain = [w for w, before in zip(words, [command, *words], strict=False) if not f"{before}{w}".count("--")]
            assert all((ROOT / word).is_file() for word in plain), example


def test_sections_that_are_named_are_there():
    told = [
        (path.name, *told)
        for path in SOURCES
        for told in re.findall(r"docs/([\w-]+\.md)(?:, ([A-Z][\w ]+))?", path.read_text("utf-8"))
    ]
    assert told
    for path, page, section in told:
        file = ROOT / "docs" / page
        assert file.is_file(), (path, page)
        heads = re.findall(r"^#+ (.*)$", file.read_text("utf-8"), re.MULTILINE)
        assert not section or any(head.startswith(section) for head in heads), (path, page, section)


def keys() -> set[str]:
    """Every key that a file of the program may have."""
    for module in pkgutil.walk_packages(hyperval.__path__, "hyperval."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)

    def below(model: type[Model]) -> Iterator[str]:
        for name, info in model.model_fields.items():
            yield info.alias or name
        for inner in model.__subclasses__():
            yield from below(inner)

    return set(below(Model))


def refusals() -> dict[str, dict[str, str]]:
    """The words of errors that stand apart from the code."""
    found: dict[str, dict[str, str]] = yaml.safe_load((ROOT / "src/hyperval/refusals.yaml").read_text("utf-8"))
    return found


def mends(path: Path) -> Iterator[str]:
    """Every text that says how to mend an error."""
    if path.name == "refusals.yaml":
        yield from (words[key] for words in refusals().values() for key in ("mend", "expected") if key in words)
    for node in ast.walk(ast.parse(path.read_text("utf-8") if path.suffix == ".py" else "")):
        if isinstance(node, ast.keyword) and node.arg in ("mend", "expected"):
            yield from (
                n.value for n in ast.walk(node.value) if isinstance(n, ast.Constant) and isinstance(n.value, str)
            )


def named_keys(text: str) -> list[str]:
    """Keys as a YAML file has them: ``elm: none``, ``columns: [0, 1]``, ``collection.cube``."""
    told = re.findall(r"(?<![\w.{])([a-z]+(?:_[a-z0-9]+)*): (?:[\[{0-9]|true|false|null)", text)
    dotted = re.findall(
        r"(?<![\w./:{])((?:collection|scene|atmosphere|processing|detection|uncertainty)(?:\.[a-z_0-9]+)+)", text
    )
    return [*told, *(part for path in dotted for part in path.split("."))]


def test_keys_that_are_named_are_there():
    known = keys()
    named = {(key, str(p.relative_to(ROOT))) for p in SOURCES for m in mends(p) for key in named_keys(m)}
    assert len(named) > 10
    assert [x for x in sorted(named) if x[0] not in known] == []
    assert "columns" in named_keys("state columns: [0, 1, 2]")


def test_every_refusal_is_used_and_gets_what_its_words_name():
    """A name without words, words without a use, or a value that is not handed on would be an error in an error."""
    words, used = refusals(), set()
    for path in (p for p in SOURCES if p.suffix == ".py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "refusal":
                names = {n.value for n in ast.walk(node.args[0]) if isinstance(n, ast.Constant) and "." in str(n.value)}
                given = {k.arg for k in node.keywords}
                used |= names
                for name in names:
                    assert words[name].keys() <= {"what", "expected", "mend", "usage"}, name
                    texts = " ".join(str(words[name].get(key, "")) for key in ("what", "expected", "mend"))
                    fields = {f.partition("[")[0] for _, f, _, _ in Formatter().parse(texts) if f}
                    assert fields <= given or None in given, (path.name, node.lineno, name, fields - given)
    assert used == words.keys()
