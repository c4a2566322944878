"""Coverage-guided damage for the readers written by hand, where atheris is installed.

python validation/robustness/fuzz.py SAMPLE [options of libFuzzer, such as -max_total_time=600]
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import atheris

sys.path.insert(0, str(Path(__file__).parent))

with atheris.instrument_imports(include=["hyperval.spectra", "hyperval.imagery", "hyperval.envi_header",
                                         "hyperval.atmosphere.modtran", "hyperval.config"]):  # fmt: skip
    from samples import samples
from mutation_study import DEFECTS, UNFORESEEN, outcome


def main() -> None:
    """Fuzz the sample named first, from its own content."""
    name, *options = sys.argv[1:]
    folder = Path(tempfile.mkdtemp())
    (folder / "corpus").mkdir()
    (folder / "in").mkdir()
    sample = {s.name: s for s in samples(folder)}[name]
    (damaged, content), *others = sample.files.items()
    (folder / "corpus" / "0").write_bytes(content)
    for other, raw in others:
        (folder / "in" / other).write_bytes(raw)

    def one(raw: bytes) -> None:
        (folder / "in" / damaged).write_bytes(raw)
        kind, words = outcome(sample, folder / "in")
        if kind in (*DEFECTS, UNFORESEEN):
            raise AssertionError(f"{kind}: {words}")

    atheris.Setup([sys.argv[0], *options, "-timeout=20", "-rss_limit_mb=2048", str(folder / "corpus")], one)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
