"""A flight line in scanner geometry whose map positions are known in closed form, and its lookup table."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from affine import Affine
from rasterio.crs import CRS
from scipy.ndimage import distance_transform_edt

from hyperval.imagery import write_cube

LINES, SAMPLES = 240, 80
UTM18 = CRS.from_epsg(32618)
EAST, NORTH = 275400.0, 4753700.0


@dataclass
class ScannedLine:
    """Pixels of ``size`` metres, flown at ``heading`` degrees, rolling by ``roll`` metres on the ground."""

    heading: float = 20.0
    size: float = 1.0
    roll: float = 3.0
    period: float = 60.0  # [lines]

    def on_map(self, sample, line):
        """(n, 2) map coordinates of continuous raw coordinates."""
        sample, line = np.asarray(sample, float), np.asarray(line, float)
        across = (sample - SAMPLES / 2) * self.size + self.roll * np.sin(2 * np.pi * line / self.period)
        along = -(line - LINES / 2) * self.size  # lines run against the heading
        h = np.radians(self.heading)
        east = EAST + across * np.cos(h) + along * np.sin(h)
        north = NORTH - across * np.sin(h) + along * np.cos(h)
        return np.stack([east, north], axis=-1)

    def raw(self, points):
        """(n, 2) continuous raw coordinates (sample, line) of map coordinates: the inverse."""
        h = np.radians(self.heading)
        dx, dy = np.asarray(points, float)[..., 0] - EAST, np.asarray(points, float)[..., 1] - NORTH
        across, along = dx * np.cos(h) - dy * np.sin(h), dx * np.sin(h) + dy * np.cos(h)
        line = LINES / 2 - along / self.size
        sample = (across - self.roll * np.sin(2 * np.pi * line / self.period)) / self.size + SAMPLES / 2
        return np.stack([sample, line], axis=-1)

    def table(self, cell: float = 1.0):
        """Stored (rows, cols, 2) lookup table and its transform, built as the producers do."""
        sample, line = np.meshgrid(np.arange(SAMPLES), np.arange(LINES))
        xy = self.on_map(sample + 0.5, line + 0.5)
        left, top = np.floor(xy[..., 0].min()) - 10, np.ceil(xy[..., 1].max()) + 10
        cols = int(np.ceil((xy[..., 0].max() - left) / cell)) + 10
        rows = int(np.ceil((top - xy[..., 1].min()) / cell)) + 10
        stored = np.zeros((rows, cols, 2), np.int32)
        place = np.stack([(top - xy[..., 1]) / cell, (xy[..., 0] - left) / cell], axis=-1).reshape(-1, 2)
        # Of several pixels in a cell the one nearest to its centre is written last and stays.
        order = np.argsort(-np.hypot(*(place % 1.0 - 0.5).T), kind="stable")
        at = np.floor(place[order]).astype(int)
        stored[at[:, 0], at[:, 1]] = np.stack([sample.ravel() + 1, line.ravel() + 1], axis=-1)[order]
        # Cells inside the line where no pixel landed take their nearest neighbour's, with a minus sign.
        row, col = np.indices((rows, cols))
        raw = self.raw(np.stack([left + (col + 0.5) * cell, top - (row + 0.5) * cell], axis=-1))
        inside = (raw[..., 0] > 0) & (raw[..., 0] < SAMPLES) & (raw[..., 1] > 0) & (raw[..., 1] < LINES)
        empty = stored[..., 0] == 0
        near = distance_transform_edt(empty, return_distances=False, return_indices=True)
        fill = inside & empty
        stored[fill] = -stored[near[0][fill], near[1][fill]]
        return stored, Affine(cell, 0, left, 0, -cell, top)


def write_table(path: Path, stored: np.ndarray, transform: Affine | None, **options) -> Path:
    """Write a lookup table as ENVI."""
    given = {"data_type": 3, "transform": transform, "crs": UTM18 if transform else None,
             "extra": {"band names": "{GLT Sample Look-up, GLT Line Look-up}"}}  # fmt: skip
    return write_cube(path, stored, **(given | options))
