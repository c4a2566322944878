"""The reference of files, made when the documentation is built, lists the keys that the models read, no others."""

import re
import runpy
from pathlib import Path

from hyperval.scenario import Scenario

PAGE = runpy.run_path(str(Path(__file__).resolve().parents[2] / "scripts" / "files_page.py"))["page"]()


def test_the_reference_of_files_has_every_model_and_its_keys():
    headings = re.findall(r"^### (\w+)$", PAGE, re.MULTILINE)
    assert {*re.findall(r"\[(\w+)\]\(#\w+\)", PAGE), "Campaign", "SceneFile", "StudyFile"} <= {*headings}
    assert len({*headings}) == len(headings)
    section = PAGE.partition("### Scenario\n")[2].partition("\n### ")[0]
    keys = [info.alias or name for name, info in Scenario.model_fields.items()]
    assert re.findall(r"^\| `(\w+)` \|", section, re.MULTILINE) == keys
