"""What the API does: each verb takes paths or objects and gives an object of :mod:`hyperval.api.objects`."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from hyperval import baseline, imagery, model, spectra
from hyperval import campaign as campaigns
from hyperval.api.objects import Collection, Metrics, Observation, Prediction, Results, Study, Validation
from hyperval.run import Run
from hyperval.scenario import Scenario, load_scenario

if TYPE_CHECKING:
    from hyperval.campaign import Job
    from hyperval.simulate.schema import SceneFile

__all__ = [
    "check", "compare", "explain", "load_campaign", "load_scenario", "metrics", "observe", "open", "predict",
    "simulate", "study", "validate",
]  # fmt: skip


def load_campaign(path: Path | str) -> Job:
    """Read and check a campaign file of one run; its parts are below ``campaign``.

    >>> load_campaign("campaign.yaml").campaign.name
    'small'

    Raises
    ------
    InputError, UsageError : of the file.
    """

    return campaigns.job_of(Path(path))


def explain(
    file: Path | str, *, header: Path | str | None = None, key: str | None = None
) -> list[tuple[str, str, str]]:
    """What a file is as its reader sees it: thing, value, and where the value comes from or what mends its lack.

    Parameters
    ----------
    file : an image, or a file of spectra
    header : ENVI header that does not lie beside the image
    key : which array of the file is the image, where it holds several

    >>> [value for what, value, origin in explain("collection/small_rad.img") if what == "wavelengths"]
    ['16, 450 to 2200 nm']

    Raises
    ------
    InputError, UsageError : neither, or damaged; in the words of the reader.
    """
    from hyperval.envi_header import header_beside

    path = Path(file)
    is_image = header is not None or path.is_dir() or path.suffix == ".hdr" or header_beside(path) is not None
    if is_image or not imagery.needs_header(path):
        raster = imagery.open_raster(path, header=header, variable=key)
        if not (isinstance(raster, imagery.EnviRaster) and "library" in raster.header.file_type.lower()):
            return imagery.record(raster)
        path = raster.path
    rows = []
    for spectrum in spectra.read_records(path, quantity="other"):
        nm = spectrum.wavelength_nm
        rows.append(("spectrum", f"{spectrum.name}: {nm.size} values, {nm[0]:g} to {nm[-1]:g} nm", spectrum.source))
        rows += [("assumed", note, "reader") for note in spectrum.notes]
    return rows


def predict(
    scenario: Scenario | Path | str, *, objects: bool | int = False, object_curves: bool = True, **origins: Any
) -> Prediction:
    """What the model says of a scenario, a scenario file or a built-in name.

    >>> predict("scenario.yaml").radiance["grey-panel-35"].mean.shape
    (16,)

    Parameters
    ----------
    objects, object_curves : of :func:`hyperval.model.predict`
    origins : entries of :class:`hyperval.model.Origins`, such as ``axis``

    Raises
    ------
    InputError, UsageError, EngineError : of the scenario.
    """

    known = scenario if isinstance(scenario, Scenario) else load_scenario(str(scenario))
    return Prediction(model.predict(known, model.Origins(**origins), objects=objects, object_curves=object_curves))


def observe(campaign: Job | Path | str, *, show_progress: bool | None = None) -> Observation:
    """What the collection of a campaign says.

    >>> sorted(observe("campaign.yaml").reflectance)[:3]
    ['black-panel', 'court', 'field']

    Raises
    ------
    InputError, UsageError : of the campaign; MissingDataError where its data are not at hand.
    """

    with campaigns.collected(_job(campaign, compares=False), show_progress=show_progress) as collection:
        return Observation(collection.observed.observation)


def compare(
    prediction: Prediction | Scenario | Path | str,
    observation: Observation | Job | Path | str,
    *,
    name: str = "comparison",
    method: str = "model",
) -> Results:
    """Compare two sides on the same bands: a row for each metric of each product, none of which gates.

    A scenario is predicted on the bands of the observation, a campaign is observed.

    >>> rows = compare("scenario.yaml", "campaign.yaml")
    >>> rows.to_dataframe()["product"].unique().tolist()[:2]
    ['radiance', 'snr']

    Raises
    ------
    UsageError : the two sides are not on the same bands.
    """
    from hyperval.compare import compare_products
    from hyperval.results import of_campaign

    measured = (observation if isinstance(observation, Observation) else observe(observation)).products
    known = prediction if isinstance(prediction, Prediction) else predict(prediction, axis=measured.axis)
    return Results(of_campaign(compare_products(known.products, measured, method=method), name))


def validate(
    campaign: Job | Path | str, *, output: Path | str | None = None, show_progress: bool | None = None
) -> Validation:
    """Predict, observe and compare a campaign of one run; with ``output`` the folder of results is written, too.

    >>> run = validate("campaign.yaml")
    >>> run.results.exit_code()
    0
    >>> run.prediction.axis.centre_nm.size
    16

    Raises
    ------
    InputError, UsageError, EngineError : of the campaign.  Data that are not at hand make its rows SKIPPED.
    """
    from hyperval.report.outputs import write_outputs
    from hyperval.storage import whole_folder

    report = campaigns.run_campaign(_job(campaign), show_progress=show_progress)
    if output is not None:
        with whole_folder(Path(output)) as folder:
            write_outputs(report, folder)
    sides = {"predicted": report.prediction, "observed": report.observation}
    return Validation(report.campaign, Run(report.table, report.provenance, sides), tuple(report.notes))


def study(path: Path | str, *, output: Path | str | None = None, show_progress: bool | None = None) -> Study:
    """Evaluate a study file; without ``output`` nothing is kept on disk.

    >>> table = study("study.yaml").to_dataframe()
    >>> table.columns.tolist()
    ['fill', 'pd']

    Raises
    ------
    UsageError, InputError, EngineError : of the study or its scenario.
    """
    from hyperval.study import study_to_folder

    with TemporaryDirectory(prefix="hyperval-study-") as scratch:
        folder = Path(scratch) / "study" if output is None else Path(output)
        study_to_folder(Path(path), folder, show_progress=show_progress)
        return _study(folder)


def check(
    campaigns: Path | str | Iterable[Path | str] = (),
    sensors: str | Iterable[str] = (),
    *,
    baselines: Path | str | None = None,
    show_progress: bool | None = None,
) -> Results:
    """Compare campaigns and sensors with the accepted numbers; ``exit_code()`` of the rows is that of the command.

    >>> check(sensors="prospectir-vs", baselines="nothing-accepted").exit_code()
    1

    Raises
    ------
    UsageError, InputError : of the campaigns, sensors or baselines.
    """

    files = [campaigns] if isinstance(campaigns, Path | str) else list(campaigns)
    names = [sensors] if isinstance(sensors, str) else list(sensors)
    folder = Path(baselines or baseline.DEFAULT_FOLDER)
    outcome = baseline.check([Path(f) for f in files], names, baselines=folder, show_progress=show_progress)
    return Results(outcome.table)


def simulate(scene: SceneFile | Path | str, output: Path | str, *, show_progress: bool | None = None) -> Collection:
    """Write a simulated collection with its truth into a folder.

    >>> simulate("scene.yaml", "simulated").cube.name
    'small_rad.img'

    Raises
    ------
    UsageError, InputError, EngineError : of the scene.
    """
    from hyperval.simulate import simulate as simulate_scene
    from hyperval.simulate.schema import SceneFile

    known = scene if isinstance(scene, SceneFile) else Path(scene)
    return Collection(**simulate_scene(known, Path(output), show_progress=show_progress))


def open(folder: Path | str) -> Validation | Study:
    """A folder of results of an earlier run, or of a study.

    >>> run = validate("campaign.yaml", output="results")
    >>> open("results").results.to_dataframe().shape == run.results.to_dataframe().shape
    True

    Raises
    ------
    InputError : no folder of results.
    """
    folder = Path(folder)
    if (folder / "table.nc").is_file():
        return _study(folder)
    run = Run.open(folder)
    return Validation(next((row.campaign for row in run.table), folder.name), run)


def metrics() -> Metrics:
    """Every metric of the results: unit, range, direction, formula.

    >>> metrics().to_dataframe().loc["bias_ratio", "unit"]
    '1'
    """
    from hyperval.metrics import table

    return Metrics(table())


def _job(campaign: Job | Path | str, *, compares: bool = True) -> Any:
    """The campaign as it is, or that of a file of one run; ``compares`` as for :func:`jobs_of`."""

    if isinstance(campaign, campaigns.Job):
        return campaign
    jobs = campaigns.jobs_of(Path(campaign), compares=compares)
    return jobs[0] if len(jobs) == 1 else load_campaign(campaign)  # which says what is wrong with several


def _study(folder: Path) -> Study:
    import xarray as xr

    from hyperval.hdf5 import check_hdf5

    check_hdf5(folder / "table.nc")
    with xr.open_dataset(folder / "table.nc", engine="h5netcdf") as data:
        table = data.load()
    run = Run.open(folder)
    return Study(table=table, results=Results(run.table), provenance=run.provenance)
