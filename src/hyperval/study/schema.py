"""The study file: a scenario, what moves in it, the outputs, and the figures."""

from __future__ import annotations

import math
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
import numpy.typing as npt
from pydantic import Field, model_validator

from hyperval.config import FileModel, Model, OneOf, load_model, twice, unknown
from hyperval.errors import reader, refuse
from hyperval.model.world import as_column

Name = Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_.-]*$", max_length=60)]
Probability = Annotated[float, Field(gt=0, lt=1)]
MAX_POINTS = 100_000_000
Value = float | str | bool | None | list[Any] | dict[str, Any]


class Grid(Model):
    """Evenly spaced values."""

    start: float
    stop: float
    count: int = Field(ge=2, le=1_000_000)
    spacing: Literal["linear", "log"] = "linear"

    refused: ClassVar = {
        "start lies below stop": lambda g: not g.start < g.stop,
        "a logarithmic grid starts above 0": lambda g: g.spacing == "log" and g.start <= 0,
    }


class Random(OneOf):
    """A distribution that a random design draws from."""

    one_of = ("uniform", "log_uniform", "normal")
    uniform: tuple[float, float] | None = None
    log_uniform: tuple[float, float] | None = None
    normal: tuple[float, float] | None = Field(None, description="mean and standard deviation")
    within: tuple[float, float] | None = Field(None, description="with normal: cut at these ends")

    refused: ClassVar = {
        "within and normal go together: a normal distribution is cut at stated ends": lambda r: (
            (r.within is None) != (r.normal is None)
        ),
        "the lower end lies below the upper one": lambda r: not r.limits[0] < r.limits[1],
        "log_uniform starts above 0": lambda r: r.log_uniform and r.limits[0] <= 0,
        "a standard deviation is above 0": lambda r: r.normal and r.normal[1] <= 0,
    }

    @property
    def limits(self) -> tuple[float, float]:
        """Least and greatest value that can be drawn."""
        return self.uniform or self.log_uniform or self.within or (math.nan, math.nan)


class Move(Model):
    """One entry of the scenario that an input moves: offset + factor times the input's value."""

    path: str = Field(description="dotted path into the scenario, or pfa: the false-alarm probability of the outputs")
    factor: float = 1.0
    offset: float = 0.0

    def apply(self, value: Any) -> Any:
        """Value of the entry at a value, or values (n,), of the input; what is no number stays as it is."""
        is_number = isinstance(value, int | float | np.ndarray) and not isinstance(value, bool)
        return self.offset + self.factor * value if is_number else value


class Moving(Model):
    """A quantity that moves one entry of the scenario, or several together."""

    name: Name
    label: str = Field("", description="in words, for axes; default: the name")
    unit: str = "1"
    path: str | None = Field(None, description=Move.model_fields["path"].description)
    moves: list[Move] = Field([], description="in place of path: several entries together")

    refused: ClassVar = {"give either path or moves": lambda m: (m.path is None) == (not m.moves)}

    @property
    def entries(self) -> list[Move]:
        """The entries that it moves."""
        return self.moves or [Move(path=str(self.path))]

    @property
    def title(self) -> str:
        """Label with unit, for axes."""
        return (self.label or self.name) + (f" [{self.unit}]" if self.unit != "1" else "")


class Input(Moving, OneOf):
    """What moves: one entry of the scenario or several together, over values, a grid, or a distribution."""

    one_of = ("values", "grid", "random")
    values: list[Value] | None = Field(
        None, min_length=1, description="as they stand; with moves, a list with one value for each is also taken"
    )
    grid: Grid | None = None
    random: Random | None = None

    refused: ClassVar = Moving.refused | {
        "factor and offset go with numbers": lambda i: (
            any(m.factor != 1.0 or m.offset != 0.0 for m in i.moves)
            and not all(isinstance(v, int | float) for v in i.values or ())
        ),
        "with moves, a list has one value for each": lambda i: any(
            isinstance(v, list) and len(i.moves) not in (0, 1, len(v)) for v in i.values or ()
        ),
    }

    @property
    def size(self) -> int:
        """Number of its listed values; 1 where random."""
        return len(self.values) if self.values else self.grid.count if self.grid else 1

    @cached_property
    def listed_values(self) -> npt.NDArray[Any] | None:
        """Its values in the order of the file, numbers as floats and anything else as objects; None where random."""
        if self.grid is not None:
            spaced = np.geomspace if self.grid.spacing == "log" else np.linspace
            return spaced(self.grid.start, self.grid.stop, self.grid.count)
        return as_column(self.values) if self.values is not None else None

    def is_axis(self, scale: str) -> bool:
        """Whether its values are numbers, which on a logarithmic scale lie above 0.

        >>> some = [0.1, 0.2], [0, 1], ["emit", "sbg"]
        >>> [Input(name="x", path="y", values=v).is_axis(scale) for v in some for scale in ("linear", "log")]
        [True, True, True, False, False, False]
        """
        # What is drawn lies above the lower end.
        values = self.listed_values if self.random is None else np.nextafter(self.random.limits, np.inf)
        return values is not None and values.dtype != object and (scale == "linear" or bool(values.min() > 0))


class Design(Model):
    """Which combinations of the inputs are evaluated.

    ``grid``: all combinations of values; distributions are drawn ``count`` times for each.  ``one-at-a-time``: the
    scenario as it stands, and each input alone at each of its values.
    """

    kind: Literal["grid", "one-at-a-time"] = "grid"
    count: int = Field(1024, ge=2, le=MAX_POINTS, description="points drawn (Sobol) where an input is random")
    seed: int = Field(0, ge=0)


class Output(Model):
    """A number asked of every point.

    ``pd``: P_D at a false-alarm probability; ``log10-pfa``: the logarithm of P_FA at a P_D; ``auc``; ``log-auc``:
    mean P_D evenly in log P_FA; ``snr`` and ``radiance``: at a band or as the mean over a range of bands.
    """

    name: Name
    kind: Literal["pd", "log10-pfa", "auc", "log-auc", "snr", "radiance"]
    subject: str = Field(description="target population, or for snr and radiance a class, panel or site")
    label: str = ""
    detector: str | None = Field(None, description="default: the scenario's first")
    by: Literal["pixel", "object"] = Field("pixel", description="what counts as detected")
    pfa: Probability | None = Field(None, description="for pd; None: from the input pfa")
    pd: Probability = Field(0.5, description="for log10-pfa")
    pfa_range: tuple[Probability, Probability] = Field((1e-6, 1e-1), description="for log-auc")
    band_nm: float | None = Field(None, description="the band whose centre lies nearest")
    range_nm: tuple[float, float] | None = Field(None, description="mean over the bands outside absorption bands")

    refused: ClassVar = {
        "give exactly one of band_nm, range_nm": lambda o: (
            o.is_spectral and (o.band_nm is None) == (o.range_nm is None)
        ),
        "snr and radiance are asked at a band_nm or over a range_nm, and nothing else is": lambda o: (
            not o.is_spectral and (o.band_nm or o.range_nm)
        ),
        "only pd counts objects": lambda o: o.kind in ("log10-pfa", "auc", "log-auc") and o.by == "object",
        "pfa belongs to kind: pd": lambda o: o.kind != "pd" and o.pfa is not None,
        "pfa_range rises": lambda o: not o.pfa_range[0] < o.pfa_range[1],
    }

    @property
    def is_spectral(self) -> bool:
        """Whether it is of spectra, and not of detection."""
        return self.kind in ("snr", "radiance")

    @property
    def unit(self) -> str:
        """Unit of the number."""
        return "uW cm-2 sr-1 nm-1" if self.kind == "radiance" else "1"

    @property
    def title(self) -> str:
        """Label with unit, for axes."""
        return (self.label or self.name) + " [µW cm⁻² sr⁻¹ nm⁻¹]" * (self.kind == "radiance")


class Required(Moving):
    """An inverse question: the value of an input at which an output takes a value, at every point of the design.

    Where an input moves the same entry, the answer is the same at all of its values.
    """

    between: tuple[float, float] = Field(description="range searched")
    spacing: Literal["linear", "log"] = Field("linear", description="spacing of the search between the ends")
    scan: int = Field(9, ge=3, le=200, description="values tried first, to bracket the solution")
    output: str = Field(description="name of an output")
    equals: float = Field(description="what the output is to be")
    report: list[str] = Field([], description="outputs reported at the solution")

    refused: ClassVar = Moving.refused | {
        "between rises, and starts above 0 with spacing: log": lambda q: (
            not q.between[0] < q.between[1] or (q.spacing == "log" and q.between[0] <= 0)
        )
    }


class Knee(Model):
    """Where a curve bends most."""

    output: str
    along: str = Field(description="name of an input with numbers")
    scale: Literal["linear", "log"] = Field("linear", description="of the input, within which the bend is sought")
    bend: Literal["any", "concave", "convex"] = Field(
        "any", description="concave: where a rising curve levels off; convex: where it sets in"
    )


class Plot(Model):
    """A figure: ``lines`` of an output along one input, a family of them along another; ``heat`` over two inputs;
    ``tornado`` of a one-at-a-time design.
    """

    kind: Literal["lines", "heat", "tornado"]
    output: str = Field(description="name of an output or of a required input")
    x: str | None = None
    family: str | None = Field(None, description="for lines: an input, a line for each of its values")
    y: str | None = Field(None, description="for heat: an input")
    scale: Literal["linear", "log"] = Field("linear", description="of x")
    title: str = ""

    refused: ClassVar = {
        "lines and heat need x, a tornado takes none": lambda p: (p.kind == "tornado") != (p.x is None),
        "a heat map needs y, nothing else takes it": lambda p: (p.kind == "heat") != (p.y is not None),
        "family belongs to lines": lambda p: p.family is not None and p.kind != "lines",
    }


class AtmosphereTable(Model):
    """How the atmosphere is interpolated where its inputs are random or many."""

    nodes: int = Field(7, ge=4, le=60, description="engine runs along each input")
    checked: int = Field(3, ge=1, le=50, description="held-out points at which the error is measured")
    above: int = Field(40, ge=1, le=400, description="states up to which each is run; a table beyond")


class StudyFile(FileModel):
    """One study."""

    scenario: str = Field(description="a built-in scenario by name, or a file")
    settings: dict[str, Value] = Field({}, description="dotted path: value, for every point")
    inputs: list[Input] = Field(min_length=1)
    design: Design = Design()
    atmosphere: AtmosphereTable = AtmosphereTable()
    outputs: list[Output] = Field(min_length=1)
    required: list[Required] = Field([])
    knees: list[Knee] = Field([])
    plots: list[Plot] = Field([])
    references: list[str] = Field([])

    refused: ClassVar = {
        "one-at-a-time takes values or grids, and no input that moves pfa": lambda s: (
            s.design.kind == "one-at-a-time" and ("pfa" in s.moved_paths or any(i.random for i in s.inputs))
        ),
        "a tornado goes with design: {kind: one-at-a-time}, and other plots do not": lambda s: any(
            (p.kind == "tornado") != (s.design.kind == "one-at-a-time") for p in s.plots
        ),
        "two inputs move {names}": lambda s: twice(s.moved_paths),
        "output {!r}: give pfa, or an input that moves pfa, and not both": lambda s: [
            o.name for o in s.outputs if o.kind == "pd" and (o.pfa is None) != ("pfa" in s.moved_paths)
        ],
        "knees: {!r} is random; a knee needs values or a grid": lambda s: [
            k.along for k in s.knees if any(i.random and i.name == k.along for i in s.inputs)
        ],
    }

    @model_validator(mode="after")
    def _check_names(self) -> StudyFile:
        named: list[Input | Output | Required] = [*self.inputs, *self.outputs, *self.required]
        names = [x.name for x in named] + [f"{q.name}.{r}" for q in self.required for r in q.report]
        if wrong := twice([*names, "point", "reason"]):
            raise ValueError(f"names occur twice: {', '.join(wrong)}; every table has point and reason besides")
        inputs, outputs = {i.name for i in self.inputs}, {o.name for o in self.outputs}
        results = outputs | {q.name for q in self.required}

        used = [(f"required {q.name!r}", name, outputs) for q in self.required for name in (q.output, *q.report)]
        used += [("knees", k.output, results) for k in self.knees]
        used += [("plots", p.output, results) for p in self.plots]
        used += [("plots", name, inputs) for p in self.plots for name in (p.x, p.y, p.family) if name is not None]
        numbers = {scale: {i.name for i in self.inputs if i.is_axis(scale)} for scale in ("linear", "log")}
        along = [("knees", k.along, k.scale) for k in self.knees]
        along += [("heat maps", *pair) for p in self.plots if p.x and p.y for pair in ((p.x, p.scale), (p.y, "linear"))]
        used += [(f"{owner} along numbers on a {scale} scale", name, numbers[scale]) for owner, name, scale in along]
        for where, name, among in used:
            if wrong := unknown([name], sorted(among) or ["none"]):
                raise ValueError("{}: {!r} is not one of {}".format(where, *wrong))
        return self

    @property
    def columns(self) -> dict[Any, Any]:
        """The columns of its table by name: inputs, outputs, answers, and outputs told at the answers."""
        columns: list[Input | Output | Required] = [*self.inputs, *self.outputs]
        for q in self.required:
            reported = (next(o for o in self.outputs if o.name == name) for name in q.report)
            named = ((o, f"{q.name}.{o.name}", f"{o.label or o.name} at {q.label or q.name}") for o in reported)
            columns += [q, *(o.model_copy(update={"name": name, "label": label}) for o, name, label in named)]
        return {column.name: column for column in columns}

    @property
    def moved_paths(self) -> list[str]:
        """Paths that its inputs move."""
        return [m.path for i in self.inputs for m in i.entries]

    @property
    def all_inputs(self) -> list[Input | Required]:
        """Inputs of the design, and those that are solved for."""
        return [*self.inputs, *self.required]

    @property
    def count(self) -> int:
        """Number of points of the design."""
        if self.design.kind == "one-at-a-time":
            return 1 + sum(i.size for i in self.inputs)
        return math.prod(i.size for i in self.inputs) * (self.design.count if any(i.random for i in self.inputs) else 1)


@reader
def load_study(path: Path) -> StudyFile:
    """Read a study file.

    Raises
    ------
    UsageError : every mistake of the file with its line.
    InputError : no such file.
    """
    study = load_model(StudyFile, path)
    refuse(study.count > MAX_POINTS, "study.points", str(path), count=study.count, most=MAX_POINTS)
    return study
