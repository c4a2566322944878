"""A small synthetic collection, in reflectance or in radiance."""

from collections.abc import Callable

import numpy as np
import pytest
import rasterio
import small_world
import yaml
from affine import Affine


@pytest.fixture
def world(tmp_path) -> small_world.World:
    """A reflectance cube with a region and five targets of two groups, ready to observe."""
    made = small_world.World(tmp_path, small_world.reflectances())
    made.write()
    made.library("library.csv", paint=small_world.TARGET, ground=small_world.BACKGROUND)
    made.text("targets.csv", small_world.target_rows(small_world.PLANTED))
    made.collection = {
        "cube": {"path": "cube.img", "quantity": "reflectance"},
        "regions": [{"name": "corner", "rectangle": [35, 5, 10, 20]}],
        "targets": {"csv": "targets.csv", "guard_pixels": 1},
    }
    made.detection = {
        "targets": [{"name": "paint", "material": "paint", "spectrum": made.source("library.csv", "paint")}],
        "group": "{group}",
    }
    return made


@pytest.fixture
def make_field(world) -> Callable[..., small_world.World]:
    """Turn the world into one region ``all``, by default drawn pixels (lines, samples) of a t law, without targets."""

    def make(
        values: np.ndarray | None = None, dof: float = np.inf, shape: tuple[int, int] = (60, 60)
    ) -> small_world.World:
        if values is None:
            rng = np.random.default_rng(3)
            z = rng.multivariate_normal(np.zeros(small_world.BANDS), small_world.background_spread(), shape)
            if np.isfinite(dof):
                z *= np.sqrt((dof - 2) / rng.chisquare(dof, shape))[..., None]
            values = 0.3 + z
        world.write(values)
        world.detection, world.collection["targets"] = None, None
        world.regions(all=[0, 0, *values.shape[:2]])
        return world

    return make


@pytest.fixture
def make_radiance(world) -> Callable[..., small_world.RadianceWorld]:
    """Turn the world into radiance L = offset + gain rho with two flat panels of known reflectance."""

    def make(relative_noise: float = 0.0) -> small_world.RadianceWorld:
        gain, offset = np.linspace(20.0, 5.0, small_world.BANDS), np.linspace(2.0, 0.1, small_world.BANDS)
        scene = world.values.copy()
        scene[0:4, 30:34] = 0.60
        scene[0:4, 36:40] = 0.05
        noise = np.random.default_rng(8).standard_normal(scene.shape)
        world.write((offset + gain * scene) * (1.0 + relative_noise * noise))
        world.library("panels.csv", white=0.6, black=0.05)
        world.collection["cube"] |= small_world.UNIT
        world.regions(corner=[35, 5, 10, 20], white=[0, 30, 4, 4], black=[0, 36, 4, 4])
        world.collection["leave_out"] = ["white", "black"]
        world.collection["empirical_line"] = {
            "panels": [{"region": n, "spectrum": world.source("panels.csv", n)} for n in ("white", "black")]
        }
        return small_world.RadianceWorld(world, gain, offset, scene)

    return make


@pytest.fixture
def sites(tmp_path) -> small_world.World:
    """Collected spectra of sites: two of one flight line and one of another, without an error; see the constants."""
    made = small_world.World(tmp_path, np.empty(0))
    made.text("bands.txt", "# centre width\n" + "".join(f"{w / 1000:.5f} 0.0020\n" for w in small_world.AXIS.centre_nm))
    made.collection = {
        "spectra": [],
        "bands": {"path": "bands.txt", "wavelength_unit": "um", "centre_column": 0, "fwhm_column": 1},
        "calibration": {"relative": 0.02},
    }
    return made


@pytest.fixture
def panels(make_radiance) -> small_world.World:
    """The collection in radiance with two panels."""
    return make_radiance().world


@pytest.fixture
def by_number(world) -> small_world.World:
    """The same cube, its header without wavelengths, and the target as one value a band."""
    spectrum = world.on_bands()
    world.write(axis=None)
    world.text("paint.txt", "# reflectance\n" + "".join(f"{value:.15g}\n" for value in spectrum))
    world.collection["cube"]["by_number"] = True
    world.detection["targets"][0]["spectrum"] = {"file": "paint.txt"}
    return world


@pytest.fixture
def lawn(sites) -> small_world.World:
    """One collected spectrum."""
    sites.site("lawn", np.linspace(12.0, 1.0, small_world.BANDS))
    return sites


@pytest.fixture
def lines(sites) -> small_world.World:
    """Three sites of one flight line and one of another, their radiances without an error."""
    names = sites.library("field.csv", **small_world.SURFACES, lot=0.3 * small_world.BACKGROUND + 0.05)
    panels = []
    for name in (*small_world.SURFACES, "lot"):
        sites.site(
            name,
            small_world.PATH + small_world.FIELD_GAIN * sites.on_bands(name, names),
            line="b" if name == "lot" else "a",
        )
        source = {"region": name, "spectrum": sites.source(names, name), "relative_uncertainty": 0.02}
        panels.append({**source, "correlation_nm": 200})
    sites.collection["calibration"] = {"relative": 0.05, "uncorrelated": 0.01}
    sites.collection["empirical_line"] = {"panels": panels, "path_radiance": []}
    return sites


@pytest.fixture
def finer(tmp_path) -> small_world.World:
    """A cube of 12 x 10 pixels on the map with two planks, by finer maps of classes, of which two do not fit."""
    small_world.finer_map(tmp_path, small_world.scene_of_a_tenth())
    for name, size, turn in (("turned.tif", 0.2, 0.02), ("coarse.tif", 1.5, 0.0)):
        small_world.finer_map(tmp_path, small_world.scene_of_a_tenth(), name)
        with rasterio.open(tmp_path / name, "r+") as dataset:
            dataset.transform = Affine(size, turn, 300_000, 0, -size, 4_500_000)
    position = "map info = {UTM, 1, 1, 300000, 4500000, 2, 2, 18, North, WGS-84, units=Meters}\n"
    noise = np.random.default_rng(4).standard_normal((12, 10, 5))
    small_world.envi(tmp_path / "cube.img", 0.2 + 0.01 * noise, small_world.WAVES + position)
    truth = {"image": "finer.tif", "classes": {"plank": 1, "panel": 2}, "psf_fwhm_pixels": 0.7, "registration_m": 0.0}
    collection = {"cube": {"path": "cube.img", "quantity": "reflectance"}, "targets": {"finer": truth}}
    return small_world.World(tmp_path, np.empty(0), collection)


@pytest.fixture
def dirsig(tmp_path) -> small_world.World:
    """A radiance image and its truth in DIRSIG's layout, and the campaign c.yaml that reads them."""
    abundance = small_world.dirsig_images(tmp_path)
    made = small_world.World(tmp_path, abundance, yaml.safe_load(small_world.DIRSIG)["collection"])
    made.text("c.yaml", small_world.DIRSIG)
    return made
