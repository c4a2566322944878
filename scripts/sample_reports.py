"""Write reports/sample: finished reports that a visitor opens without running anything.

python scripts/sample_reports.py            (make sample-report)

Runs four campaigns, which need their data (HYPERVAL_DATA or hyperval data fetch), and keeps of each the page, the
planned comparisons and the JUnit file.  The same files and versions give the same bytes.
"""

from __future__ import annotations

import os
import shutil
import sys
import tempfile
from pathlib import Path

from hyperval import cli

SAMPLE = Path("reports") / "sample"
CAMPAIGNS = ("hysu-2018", "pasadena-2017", "radcalnet-baotou-2018", "share2012-independent")
KEPT = ("report.html", "summary.csv", "junit.xml")
NOT_MET = 1  # a criterion that is not met is a result


def main() -> int:
    """Each campaign by itself; what stands in the sample is replaced."""
    os.environ["GIT_DIR"] = os.devnull  # a page cannot name the commit that holds it
    for name in CAMPAIGNS:
        with tempfile.TemporaryDirectory() as scratch:
            out = Path(scratch) / name
            code = cli.run(["--quiet", "validate", f"campaigns/{name}/campaign.yaml", "-o", str(out)])
            if code > NOT_MET and not (out / KEPT[0]).is_file():
                return code
            shutil.rmtree(SAMPLE / name, ignore_errors=True)
            (SAMPLE / name).mkdir(parents=True)
            for kept in KEPT:
                shutil.copy(out / kept, SAMPLE / name / kept)
        size = sum(path.stat().st_size for path in (SAMPLE / name).iterdir())
        print(f"{name}: {size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
