"""Every command, section and key that a message of the program or a page names is there."""

import ast
import json
import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from string import Formatter

import yaml
from parsed import parsed
from typer.exceptions import TyperException
from typer.main import get_command

from hyperval.cli import app

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted(p for p in (ROOT / "src/hyperval").rglob("*") if p.suffix in (".py", ".j2", ".yaml", ".html"))
MODULES = [path for path in SOURCES if path.suffix == ".py"]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").glob("*.md"))]
# What follows the program's name where it is the subject of a sentence, or of an import.
PROSE = re.compile(r"import|atmospheric|over|with|[a-z]+s")  # "hyperval serves", "hyperval statistics"


PROGRAM = get_command(app)


def refusal_of(words: list[str]) -> str:
    """What the program's own parser says against words after its name; empty where it takes them."""
    command, context, args = PROGRAM, None, words
    try:
        while hasattr(command, "resolve_command"):
            context = command.make_context("hyperval", list(args), parent=context)
            _, command, args = command.resolve_command(context, [*context._protected_args, *context.args])
        command.make_context("hyperval", list(args), parent=context)
    except TyperException as error:
        return error.format_message()
    return ""


def wrong_commands(text: str) -> list[str]:
    """Mentions of a command that the program refuses; a name alone, or dots, may stand for one that needs more."""
    wrong = []
    for mention in re.finditer(r"\bhyperval ([a-z][a-z-]*(?: (?:\"[^\"\n]*\"|[^\s`\"'<>;)]+))*)", text):
        words = [word.rstrip(".,:…") or "..." for word in shlex.split(mention[1])]
        last = max((i for i, word in enumerate(words) if word.startswith("-")), default=0)
        # What follows may be the rest of a sentence: something up to its end is a command, with all its options.
        said = [refusal_of(words[:n]) for n in range(len(words), last, -1) if "--help" not in words]
        is_name = (not last or "..." in words) and any(answer.startswith(("Missing", "Usage")) for answer in said)
        if said and not (is_name or "" in said or PROSE.fullmatch(words[0])):
            wrong.append(f"{mention[0]!r}: {said[0]}")
    return wrong


def test_examples_of_help_are_commands():
    groups = (app, *(group.typer_instance for group in app.registered_groups))
    for command in (command for group in groups for command in group.registered_commands):
        lines = re.findall(r"^  hyperval (.*)$", command.epilog or "", re.MULTILINE)
        assert lines, command.callback
        assert [refusal_of(shlex.split(line)) for line in lines] == [""] * len(lines)


def test_commands_that_are_named_are_there():
    found = {
        p.name: wrong
        for p in (*SOURCES, *PAGES)
        if (wrong := wrong_commands(re.sub(r"\{\{ (\w+) \}\}", r"{\1}", p.read_text("utf-8"))))
    }
    assert found == {}
    assert "No such command 'chekc'" in wrong_commands("run hyperval chekc x.yaml")[0]
    assert "No such option: --sensor" in wrong_commands("run hyperval check x.yaml --sensor y")[0]


def test_sections_that_are_named_are_there():
    text = "\n".join(path.read_text("utf-8") for path in SOURCES)
    told = set(re.findall(r"docs/([\w-]+\.md)(?:, ([A-Z][\w ]+))?", text))
    assert told
    for page, section in told:
        heads = re.findall(r"^#+ (.*)$", (ROOT / "docs" / page).read_text("utf-8"), re.MULTILINE)
        assert not section or any(head.startswith(section) for head in heads), (page, section)


REPLACED = re.compile(
    r"Nothing decides|\bplanted|es? out the same|be ended\b|chosen after|[−-] collected\)|gates see|D \[1\]"
    r"|type of haze|planned range|Capitals decide|do not decide the|nobody foresaw|truth moved|blur of the image"
)


def test_no_text_has_words_that_the_vocabulary_replaced():
    texts = [*SOURCES, *PAGES, *(ROOT / "docs/examples").glob("*.py"), *(ROOT / "campaigns").rglob("*.*")]
    assert {p.name: found for p in texts if (found := REPLACED.findall(p.read_text("utf-8")))} == {}


def keys() -> set[str]:
    """Every key that a file of a user may have."""
    schemas = [json.loads(path.read_text("utf-8")) for path in (ROOT / "src/hyperval/schemas").glob("*.json")]
    parts = [part for schema in schemas for part in (schema, *schema["$defs"].values())]
    return {key for part in parts for key in part.get("properties", ())}


# The words of errors that stand apart from the code.
REFUSALS: dict[str, dict[str, str]] = yaml.safe_load((ROOT / "src/hyperval/refusals.yaml").read_text("utf-8"))


def texts_of(node: ast.AST) -> list[str]:
    """Every text of a piece of code."""
    constants = [n.value for n in ast.walk(node) if isinstance(n, ast.Constant)]
    return [value for value in constants if isinstance(value, str)]


def mends() -> Iterator[str]:
    """Every text that says how to mend an error."""
    yield from (words[key] for words in REFUSALS.values() for key in ("mend", "expected") if key in words)
    for node in (node for path in MODULES for node in ast.walk(parsed(path))):
        if isinstance(node, ast.keyword) and node.arg in ("mend", "expected"):
            yield from texts_of(node.value)


def named_keys(text: str) -> list[str]:
    """Keys as a YAML file has them: ``elm: none``, ``columns: [0, 1]``, ``collection.cube``."""
    told = re.findall(r"(?<![\w.{])([a-z]+(?:_[a-z0-9]+)*): (?:[\[{0-9]|true|false|null)", text)
    dotted = re.findall(
        r"(?<![\w./:{])((?:collection|scene|atmosphere|processing|detection|uncertainty)(?:\.[a-z_0-9]+)+)", text
    )
    return [*told, *(part for path in dotted for part in path.split("."))]


def test_keys_that_are_named_are_there():
    named = {key for text in mends() for key in named_keys(text)}
    assert len(named) > 10
    assert named - keys() == set()
    assert "columns" in named_keys("state columns: [0, 1, 2]")


def test_every_refusal_is_used_and_gets_what_its_words_name():
    """A name without words, words without a use, or a value that is not handed on would be an error in an error."""
    used = set()
    for path in MODULES:
        for node in ast.walk(parsed(path)):
            called = getattr(node.func, "id", getattr(node.func, "attr", "")) if isinstance(node, ast.Call) else ""
            if called not in ("refuse", "refusal", "needed", "content_of"):  # refuse says it in words of its own, too
                continue
            given, texts = {k.arg for k in node.keywords}, texts_of(node.args[called != "refusal"])
            names = {text for text in texts if text in REFUSALS or (called == "refusal" and "." in text)}
            used |= names
            for name in names:
                words = REFUSALS[name]
                assert words.keys() <= {"what", "expected", "mend", "usage", "engine"}, name
                texts = " ".join(str(words.get(key, "")) for key in ("what", "expected", "mend"))
                fields = {re.split(r"[.\[]", f)[0] for _, f, _, _ in Formatter().parse(texts) if f}
                assert fields <= given or None in given, (path.name, node.lineno, name, fields - given)
    assert used == REFUSALS.keys()
