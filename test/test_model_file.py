"""Files of extended models: the reader accepts exactly what the writer writes."""

import functools
import json
import operator
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from live import config, parameters
from models import EFFECTS, REFIT, STATEFUL, VALUES, base_names, content, model, motion, own, write_model
from numpy.testing import assert_allclose

from hd_diag.config import model_file
from hd_diag.config.configuration import ConfigError, load, resolve
from hd_diag.config.model_file import REFITTED, base_hash, model_for, parse, write
from hd_diag.config.parameters import ContentError

NAMES = tuple(VALUES)
AGREEMENT = 1e-9  # [rad]
WHOLE = json.dumps(content(*STATEFUL))


def refused(text: str) -> str:
    with pytest.raises(ConfigError) as caught:
        model_for(text, own())
    reason = str(caught.value)
    assert "\n" not in reason
    assert len(reason) < 400
    return reason


def changed(path: str, value: Any) -> str:
    """File with one value changed, or removed (...); the path has keys and indices."""
    document = json.loads(WHOLE)
    *way, last = (int(key) if key.isdigit() else key for key in path.split("/"))
    place = functools.reduce(operator.getitem, way, document)
    place[last] = value
    if value is ...:
        del place[last]
    return json.dumps(document)


# Round trip ---


@pytest.mark.parametrize("names", [(), STATEFUL, NAMES], ids=len)
def test_what_is_written_predicts_what_was_fitted(tmp_path: Path, names: tuple[str, ...]) -> None:
    write(tmp_path / "m.json", content(*names))
    read = model_for((tmp_path / "m.json").read_text(), own())
    fitted = model(*names)
    time, angle, torque, heat = motion(200)
    expected, _ = fitted.step(fitted.start(), time, angle, None, torque, heat)
    found, _ = read.step(read.start(), time, angle, None, torque, heat)
    assert_allclose(found, expected, rtol=0.0, atol=AGREEMENT)
    assert read.ranges == fitted.ranges
    assert [term.effect.name for term in read.effects] == list(names)
    assert list(tmp_path.iterdir()) == [tmp_path / "m.json"]


def test_values_are_physical_with_units_classes_and_deviations() -> None:
    document = content("resonance")
    document["effects"][0]["class"] = ["resonance", "coupling_misalignment"]
    assert parse(json.dumps(document)).model.effects[0].effect.name == "resonance"
    quantities = document["effects"][0]["parameters"]
    units = {"amplitude": "rad", "phase": "rad", "natural_frequency": "rad/s"}
    assert {name: one["unit"] for name, one in quantities.items() if one["unit"] != "-"} == units
    assert quantities["natural_frequency"]["value"] == 60.0
    assert quantities["natural_frequency"]["std"] is None
    assert document["standard_deviations"] == {"cup_compliance": 1e-7}
    assert document["valid_range"]["torque"] == {"low": -40.0, "high": 45.0, "unit": "N m"}


def test_effects_outside_their_limits_are_not_written(tmp_path: Path) -> None:
    document = content("stream_delay")
    for delay, said in (
        (1.0, "the model cannot be written: .*delay must be from"),
        (np.nan, ".*cannot be written"),
    ):
        document["effects"][0]["parameters"]["delay"]["value"] = delay
        with pytest.raises(ConfigError, match=rf"m\.json: {said}"):
            write(tmp_path / "m.json", document)
    with pytest.raises(ConfigError, match="cannot be written: No such file"):
        write(tmp_path / "none" / "m.json", content())
    assert not list(tmp_path.iterdir())


SECRET = "hunter2"


@pytest.mark.parametrize(
    "text",
    [
        f'{{"password": "{SECRET}"}}',
        f'{{"{SECRET}": 1, "{SECRET}": 2}}',
        f"root:x:0:0:{SECRET}\\n",
        *(changed(path, SECRET) for path in ("schema", "offset", "effects/0/name", "parameters/ratio")),
    ],
)
def test_who_may_not_read_a_file_is_told_nothing_of_what_it_holds(text: str) -> None:
    """A node parameter may name any file that the node can read; only the owner sees its contents."""
    given = {"joint_1.model_file": "/etc/\nshadow"}
    with pytest.raises(ContentError) as caught:
        resolve(given, lambda joint, path: text)
    assert SECRET not in caught.value.discreet
    assert caught.value.discreet.startswith("joint_1.model_file: '/etc/\\nshadow': is not a model")
    assert "\n" not in str(caught.value)


# The joint it was fitted to ---


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("ratio", -100.0),
        ("output", "circular_spline"),
        ("eccentricity.magnitude", 1e-6),
        ("flexspline_tooth.addendum_center", [1.0, 2.0]),
    ],
)
def test_another_joint_is_refused(name: str, value: Any) -> None:
    with pytest.raises(ConfigError, match=rf"was fitted to a joint with another {name}; this one has"):
        model_for(WHOLE, own() | {name: value})
    assert model_for(WHOLE, own() | REFIT) == model_for(WHOLE, own())  # as fitted


def test_the_hash_is_of_the_whole_base() -> None:
    base = {name: own()[name] for name in base_names()}
    assert parse(WHOLE).base == base
    assert set(REFITTED) < set(base)
    assert json.loads(WHOLE)["base"]["sha256"] == base_hash(base)
    assert len({base_hash(base | {name: "other"}) for name in base} | {base_hash(base)}) == len(base) + 1


# In a configuration ---


def test_a_configuration_loads_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_model(tmp_path / "m.json", "hysteresis")
    (joint,), (plain,) = config(joint_1__model_file=str(path)).joints, config().joints
    assert joint.drive == joint.model.drive == model().drive
    assert (joint.configured, plain.model) == (plain.drive, None)
    assert joint.model_text == path.read_text()
    there = tmp_path / "there"
    there.mkdir()
    for name in ("../m", "m"):
        text = f"hd_diag: {{ros__parameters: {{joint_1: {{model_file: {name}.json}}}}}}"
        (there / f"{len(name)}.yaml").write_text(text)
    assert load(there / "4.yaml").joints[0].model == joint.model
    with pytest.raises(ConfigError, match="No such file"):
        load(there / "1.yaml")
    monkeypatch.chdir(tmp_path)
    assert load(there / "1.yaml").joints[0].model == joint.model


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (None, "cannot be read: No such file or directory"),
        (b"\xff\xfe", "not a text in UTF-8"),
        (b" " * 1_000_001, "longer than 1000000 bytes"),
        (b"{", "not JSON"),
        (b"[" * 100_000, "not JSON: nested too deep"),
        (b"[]", "the file: expected an object"),
        (b'{"schema": 1, "schema": 1}', "'schema' appears twice"),
        (b'{"schema": NaN}', "holds NaN, which is not a number"),
        (b'{"schema": "hd_diag/model/1"}', "the file lacks 'version'"),
    ],
    ids=range(9),
)
def test_errors_name_parameter_file_and_cause(tmp_path: Path, data: bytes | None, reason: str) -> None:
    path = tmp_path / "m.json"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(ConfigError, match=rf"^joint_1\.model_file: '.*m\.json': ({reason})"):
        config(joint_1__model_file=str(path))


def test_where_texts_come_from_can_be_given() -> None:
    given, texts = parameters("a", "b", a__model_file="gone.json"), {("a", "gone.json"): WHOLE}
    first, second = resolve(given, lambda *place: texts.pop(place)).joints
    assert (first.model is None, second.model, texts) == (False, None, {})


# Hostile files ---


@pytest.mark.parametrize(
    ("path", "value", "reason"),
    [
        ("schema", "hd_diag/model/2", "schema is 'hd_diag/model/2', not 'hd_diag/model/1'"),
        ("joint", None, "joint: expected a text"),
        ("offset", True, "offset: expected a number, not True"),
        ("offset", 11, "offset: expected a number from -10 to 10"),
        ("ofset", 1, "unknown key 'ofset'; the nearest known is 'offset'"),
        ("evidence", [], "evidence: expected an object"),
        ("parameters/rati", 1.0, "unknown parameter 'rati'; the nearest known is 'ratio'"),
        ("parameters/ratio", ..., "parameters lack 'ratio'"),
        ("parameters/ratio", "100", "ratio: expected a number"),
        ("base/sha256", 5, "sha256 is not that"),
        ("parameters/neutral_curve.semi_major", 0.0302, "sha256 is not that"),
        ("base/before_the_fit/cup_compliance", 1e-7, "sha256 is not that"),
        ("base/before_the_fit/ratio", 50.0, "is not a parameter that a fit changes"),
        ("effects", {}, "effects: expected a list"),
        ("effects", 5000 * [json.loads(WHOLE)["effects"][0]], "5000 are more than the 64 that can run"),
        ("effects/0/name", "histeresis", "unknown effect 'histeresis'; the nearest known is 'hysteresis'"),
        ("effects/0/name", "tooth_skip", "event of one record"),
        ("effects/1/name", "hysteresis", "unknown quantity 'delay'"),
        ("effects/1", json.loads(WHOLE)["effects"][0], "a name appears twice"),
        ("effects/0/parameters/bending_reach", ..., "bending_reach is missing"),
        ("effects/0/parameters/bending_reach/value", 0.0, "bending_reach must be from"),
        ("effects/0/parameters/bending_reach/value", "2", "expected a number"),
        ("effects/0/parameters/bending_reach/unit", "Nm", "expected the unit 'N m', not 'Nm'"),
        ("effects/0/parameters/bending_reach/std", -1.0, "std: expected a number from 0"),
        ("effects/0/parameters/bending_reach", 2.0, "expected an object"),
        ("effects/2/parameters/phase/value", 1e301, "expected a number from"),
        ("valid_range/torque", None, "torque: expected an object"),
        ("valid_range/torque/low", 46.0, r"low \(46\) must not be above high \(45\)"),
        ("valid_range/temperature", ..., "lacks 'temperature'"),
    ],
)
def test_a_wrong_value_is_named(path: str, value: Any, reason: str) -> None:
    assert re.search(reason, refused(changed(path, value)))


LEAVES = [None, True, "", "x" * 500, "hysteresis", -1, 0, 1e308, 10**30, "[]", "{}", "[[]]", '{"value": {}}']


@given(
    st.lists(st.tuples(st.integers(0, 2**32), st.sampled_from(LEAVES), st.booleans()), min_size=1, max_size=3)
)
def test_spoiled_files_give_one_line_or_a_model(spoiling: list[tuple[int, Any, bool]]) -> None:
    """Values anywhere in the file are replaced, or added under another name."""
    document = json.loads(WHOLE)
    for number, value, beside in spoiling:
        place, key, here = document, "schema", document
        while isinstance(here, (dict, list)) and here:
            number, at = divmod(number, len(here))
            place, key = here, list(here)[at] if isinstance(here, dict) else at
            here = place[key]
        made = json.loads(value) if isinstance(value, str) and value[:1] in ("[", "{") else value
        place[f"{key}x" if beside and isinstance(place, dict) else key] = made
    try:
        found, reason = model_for(json.dumps(document), own()), ""
    except ConfigError as error:
        found, reason = None, str(error)
    assert "\n" not in reason
    assert found is None or {term.effect.name for term in found.effects} <= set(EFFECTS)


def test_a_model_that_cannot_be_computed_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(model_file.ExtendedModel, "step", lambda *_: 1 / 0)
    assert "the model cannot be computed: division by zero" in refused(WHOLE)
    monkeypatch.setattr(model_file.ExtendedModel, "step", lambda *_: (np.full(2, np.nan), None))
    assert "no transmission error" in refused(WHOLE)
