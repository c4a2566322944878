"""
Do model and pixels agree?
==========================

The campaign of the tutorial: a small collection is simulated, observed as collected imagery would be, and compared.
Real collections are compared in the same way: ``hyperval validate campaign.yaml -o report``.
"""

import re
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt

from hyperval.api import validate

tutorial = Path("../first-campaign.md").read_text("utf-8")
files = re.findall(r"<!-- file: (\S+) -->\n```\w*\n(.*?)```", tutorial, re.DOTALL)
with TemporaryDirectory() as folder:
    for name, text in files:
        (Path(folder) / name).write_text(text, "utf-8")
    run = validate(Path(folder) / "campaign.yaml", show_progress=False)

figure, axes = plt.subplots(figsize=(8, 4), layout="constrained")
run.plot.spectra("reflectance", ax=axes)

# %%
# What was judged, with its 95 % interval and the range that was accepted beforehand.
columns = ["product", "subject", "metric", "value", "lower", "upper", "limit_low", "limit_high", "outcome"]
run.summary[columns].head(12)

# %%
# Both ROC curves, predicted and measured.
figure, axes = plt.subplots(figsize=(7, 5), layout="constrained")
run.plot.roc(ax=axes)
