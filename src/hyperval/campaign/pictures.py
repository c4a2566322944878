"""What the report shows of the imagery: score maps and a picture of the scene."""

from __future__ import annotations

import numpy as np

from hyperval.observe import Observed
from hyperval.report import Quicklook, ScoreMap


def score_maps(observed: Observed) -> dict[str, ScoreMap]:
    """Every score map with its place on the ground and the outlines of its targets."""
    if observed.detected is None or observed.place is None:
        return {}
    cube = observed.place.cube
    size = observed.place.pixel_area_m2
    return {
        name: ScoreMap(
            values,
            tuple(cube.transform)[:6] if cube.transform else None,
            cube.crs.to_wkt() if cube.crs else None,
            observed.detected.outlines.get(name, {}),
            float(np.sqrt(size)) if size else None,
        )
        for name, values in observed.detected.score_maps.items()
    }


def quicklook(observed: Observed) -> Quicklook | None:
    """Red, green and blue of the scene stretched between its 1st and 99th percentiles; None without a cube."""
    if observed.place is None:
        return None
    cube = observed.place.cube
    centre = cube.axis.centre_nm
    bands = [int(np.argmin(np.abs(centre - at))) for at in (650.0, 550.0, 470.0)]
    picture = np.concatenate([block.values[..., bands] for block in cube.blocks(dtype=np.float32)])
    low, high = np.nanpercentile(picture, [1.0, 99.0], axis=(0, 1))
    scaled = np.clip((picture - low) / np.where(high > low, high - low, 1.0), 0.0, 1.0)
    size = observed.place.pixel_area_m2
    regions = dict(observed.place.regions)
    return Quicklook(
        np.nan_to_num(scaled * 255.0).astype(np.uint8),
        regions,
        tuple(float(centre[b]) for b in bands),
        float(np.sqrt(size)) if size else None,
    )
