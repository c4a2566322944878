"""Scene files: what is accepted, and one clear message for what is not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import yaml
from small_scene import area, planks, scene_data

from hyperval.errors import UsageError
from hyperval.simulate import lay_out, load_inputs, load_scene, regions

TWIN = Path(__file__).parents[2] / "campaigns" / "share2012-twin"


@pytest.mark.parametrize("name", ["scene.yaml", "scene-broken.yaml"])
def test_the_twin_scenes_are_valid_and_as_large_as_they_should_be(name):
    scene = load_scene(TWIN / name)
    assert scene.mode == ("closure" if name == "scene.yaml" else "broken")
    assert 2 * scene.lines * scene.samples * 360 <= 150e6
    ground = lay_out(scene)
    masks = regions(scene, ground)
    assert masks["grass-field"].sum() > 50_000
    assert masks["asphalt-court"].sum() > 50_000
    assert [masks[p.name].sum() for p in scene.panels] == [36] * 4
    for material in ("yellow-paint-plank", "green-paint-plank"):
        groups = [g for g in scene.targets if g.material == material]
        assert len({g.fill for g in groups}) == 5
        assert all(g.count >= 60 for g in groups)
    assert 42.0 < scene.atmosphere.sun[0] < 43.0


def test_the_two_twins_differ_in_the_broken_assumptions_alone():
    closure, broken = (load_scene(TWIN / n).model_dump() for n in ("scene.yaml", "scene-broken.yaml"))
    for data in (closure, broken):
        for group in data["targets"]:
            group["phase"] = group["heading_deg"] = None
    differing = {key for key in closure if closure[key] != broken[key]}
    assert differing == {"name", "mode", "broken"}


ADMIXTURE = {"host": "grass", "surface": "soil", "mean": 0.05, "sd": 0.02}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"psf_fwhm_pixel": 1.0}, "did you mean 'psf_fwhm_pixels'"),
        ({"schema": 2}, "schema"),
        ({"mode": "broken"}, "needs at least one option under 'broken'"),
        ({"broken": {"soft_edges": True}}, "mode 'closure' takes none"),
        ({"layout": [area("grass", [0, 61], [0, 48])]}, "outside the image"),
        ({"layout": [area("grass", [5, 5], [0, 48])]}, "first < end"),
        ({"targets": [planks(side_m=1.0)]}, "exactly one of fill, side_m"),
        ({"targets": [planks(count=7)]}, "7 planks on a grid of 2 x 3"),
        ({"targets": [planks(host="water")]}, "'water' covers no area"),
        ({"targets": [planks(), planks()]}, "two target groups carry the same name"),
        ({"regions": [{"name": "white", "surface": "grass"}]}, "two regions carry the same name"),
        ({"mode": "broken", "broken": {"admixtures": [ADMIXTURE | {"sd": 0.4}]}}, "no share between 0 and 1"),
        ({"name": "../escape"}, "a name of letters"),
    ],
)  # fmt: skip
def test_a_mistake_is_named_with_its_file_and_line(tmp_path, changes, words):
    path = tmp_path / "scene.yaml"
    data = json.loads(json.dumps(scene_data(**changes)))  # no part twice: YAML would make it an anchor
    path.write_text(yaml.safe_dump(data, sort_keys=False), encoding="utf-8")
    with pytest.raises(UsageError, match=words) as error:
        load_scene(path)
    assert "scene.yaml:" in str(error.value)
    assert error.value.exit_code == 2


def test_a_surface_that_is_none_is_told_before_the_engine_runs(tmp_path, monkeypatch):
    def engine(*_, **__):
        raise AssertionError("the engine ran")

    monkeypatch.setattr("hyperval.atmosphere.atmospheric_terms", engine)
    scene = load_scene(TWIN / "scene.yaml")
    painted = [scene.layout[0].model_copy(update={"surface": "gras"}), *scene.layout[1:]]
    with pytest.raises(UsageError, match="unknown built-in surface 'gras'"):
        load_inputs(scene.model_copy(update={"layout": painted}), tmp_path)
