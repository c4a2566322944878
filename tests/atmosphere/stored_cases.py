"""Cases of the room's tests that are data: cases.yaml."""

from pathlib import Path

import yaml

CASES = yaml.safe_load(Path(__file__).with_name("cases.yaml").read_text("utf-8"))
