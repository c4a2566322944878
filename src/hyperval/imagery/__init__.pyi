"""Images on disk: their readers and writer, regions of interest, truth, places on a map."""

from .acquisition import acquisition_notes, time_notes
from .cube import Block, Cube, needs_header, open_cube, open_raster, raster_of_size
from .description import Description, Raster, record
from .drawing import outside_error, polygon_mask
from .envi import EnviRaster, crs_of, pixel_area_m2, pixel_sides_m, transform_of
from .interchange import cube_to_spy, cube_to_xarray, map_to_spy, map_to_xarray
from .placing import (
    LocationTable,
    LookupTable,
    companion,
    location_table,
    metres_per_degree,
    open_lookup_table,
    sun_zenith_deg,
    table_of,
)
from .products import layouts, sun_of_observation
from .regions import (
    Region,
    groups_by_size,
    guard,
    half_region,
    holes,
    objects,
    overlaps,
    patches,
    read_regions,
    rectangle_region,
    ring_region,
)
from .truth import TargetMasks, TargetObject, all_pixels, cut_out, intersected_objects, read_targets, region_objects
from .write import envi_writer, write_cube

__all__ = [
    "Block",
    "Cube",
    "Description",
    "EnviRaster",
    "LocationTable",
    "LookupTable",
    "Raster",
    "Region",
    "TargetMasks",
    "TargetObject",
    "acquisition_notes",
    "all_pixels",
    "companion",
    "crs_of",
    "cube_to_spy",
    "cube_to_xarray",
    "cut_out",
    "envi_writer",
    "groups_by_size",
    "guard",
    "half_region",
    "holes",
    "intersected_objects",
    "layouts",
    "location_table",
    "map_to_spy",
    "map_to_xarray",
    "metres_per_degree",
    "needs_header",
    "objects",
    "open_cube",
    "open_lookup_table",
    "open_raster",
    "outside_error",
    "overlaps",
    "patches",
    "pixel_area_m2",
    "pixel_sides_m",
    "polygon_mask",
    "raster_of_size",
    "read_regions",
    "read_targets",
    "record",
    "rectangle_region",
    "region_objects",
    "ring_region",
    "sun_of_observation",
    "sun_zenith_deg",
    "table_of",
    "time_notes",
    "transform_of",
    "write_cube",
]
