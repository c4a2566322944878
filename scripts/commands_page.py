"""Write docs/reference/commands.md: every command of the command line with its help.

python scripts/commands_page.py            print it
python scripts/commands_page.py --write    write it, as the documentation does when it is built
"""

from __future__ import annotations

import sys
from pathlib import Path

import click
from typer.main import get_command

from hyperval.cli import app

PAGE = Path(__file__).resolve().parents[1] / "docs" / "reference" / "commands.md"
HEAD = """# The commands

Made by `scripts/commands_page.py` from the command line itself; `hyperval COMMAND --help` has types, defaults and
examples besides.
"""


def entry(name: str, command: click.Command) -> list[str]:
    """A command and those below it: what it does, its arguments and options."""
    inner = getattr(command, "commands", {})
    lines = [f"## hyperval {name}", "", (command.help or "").strip(), ""]
    rows = [p for p in command.params if not getattr(p, "hidden", False) and p.name != "help"]
    if rows and not inner:
        lines += ["| argument or option | what it is |", "| --- | --- |"]
        for parameter in rows:
            words = " ".join(str(getattr(parameter, "help", "") or "").split()).replace("|", "\\|")
            is_option = parameter.opts[0].startswith("-")
            names = parameter.opts if is_option else [parameter.metavar or str(parameter.name)]
            lines.append(f"| `{', '.join(names)}` | {words} |")
        lines.append("")
    for below in inner:
        lines += entry(f"{name} {below}", inner[below])
    return lines


def page() -> str:
    """The whole page."""
    commands = getattr(get_command(app), "commands", {})
    lines = [line for name, command in commands.items() for line in entry(name, command)]
    return "\n".join([HEAD, *lines]).rstrip("\n") + "\n"


if __name__ == "__main__":
    if "--write" in sys.argv[1:]:
        PAGE.parent.mkdir(exist_ok=True)
        PAGE.write_text(page(), "utf-8")
    else:
        print(page(), end="")
