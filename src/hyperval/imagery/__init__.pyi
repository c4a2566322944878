"""Images on disk: their readers and writer, regions of interest, truth, places on a map."""

from .cube import (
    Block,
    Cube,
    map_to_spy,
    map_to_xarray,
    needs_header,
    open_cube,
    open_raster,
)
from .description import Description, Raster, acquisition_notes, time_notes
from .envi import EnviRaster, crs_of, envi_writer, pixel_area_m2, pixel_sides_m, transform_of, write_cube
from .placing import (
    COMPANIONS,
    LocationTable,
    companion_file,
    image_record,
    metres_per_degree,
    open_lookup_table,
    sun_zenith_deg,
    table_of,
)
from .products import layouts
from .regions import (
    ImageGrid,
    Region,
    connected_patches,
    groups_by_size,
    guard,
    half_region,
    holes,
    objects,
    outside_error,
    overlaps,
    polygon_mask,
    raster_of_size,
    read_regions,
    rectangle_region,
    ring_region,
)
from .truth import TargetMasks, TargetObject, all_pixels, intersected_objects, mask_window, read_targets, region_objects

__all__ = [
    "COMPANIONS", "Block", "Cube", "Description", "EnviRaster", "ImageGrid", "LocationTable", "Raster", "Region",
    "TargetMasks", "TargetObject", "acquisition_notes", "all_pixels", "companion_file", "connected_patches", "crs_of",
    "envi_writer", "groups_by_size", "guard", "half_region", "holes", "image_record", "intersected_objects", "layouts",
    "map_to_spy", "map_to_xarray", "mask_window", "metres_per_degree", "needs_header", "objects", "open_cube",
    "open_lookup_table", "open_raster", "outside_error", "overlaps", "pixel_area_m2", "pixel_sides_m", "polygon_mask",
    "raster_of_size", "read_regions", "read_targets", "rectangle_region", "region_objects", "ring_region",
    "sun_zenith_deg", "table_of", "time_notes", "transform_of", "write_cube",
]  # fmt: skip
