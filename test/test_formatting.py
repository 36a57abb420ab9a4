"""Numbers for people to read."""

import json
import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hd_diag import formatting
from hd_diag.effects.quantity import Quantity, amplitude, direction
from hd_diag.report.cards import quantity


@pytest.mark.parametrize(
    ("value", "spread", "expected"),
    [
        (8.829, 0.024, "8.83"),
        (8.829, 0.014, "8.829"),
        (-8.829, 0.3, "−8.8"),
        (12.0, 30.0, "12"),
        (1.234, math.nan, "1.23"),
        (0.001234, 0.0, "0.00123"),
        (29868.4, math.nan, "29868"),
        (0.0, math.nan, "0"),
        (-1e-9, 0.1, "0.00"),
        (math.nan, 0.1, "–"),
        (math.inf, 0.1, "–"),
    ],
)
def test_a_number_has_the_digits_that_its_spread_allows(value: float, spread: float, expected: str) -> None:
    assert formatting.number(value, spread) == expected


@given(st.floats(-1e6, 1e6), st.floats(1e-4, 1e3))
def test_rounding_stays_within_the_spread(value: float, spread: float) -> None:
    assert float(formatting.number(value, spread).replace("−", "-")) == pytest.approx(value, abs=0.5 * spread)


def test_quantities_in_usual_units() -> None:
    lag, swing = amplitude("pitch_2", "m", 1e-4, 1e-6, ""), direction("direction", "", 2)
    assert quantity(lag, 1.234e-6, 2e-8) == "1.23 ± 0.02 µm"
    assert quantity(swing, math.radians(-10.0), math.radians(3.0)) == "170 ± 3° (modulo 180°)"
    assert quantity(Quantity("angle", "rad", 0, 1, 1, ""), math.radians(3.5), 0.0) == "3.50 °"
    assert formatting.si(math.pi / 648000.0, math.nan, "rad") == "1.00 arcsec"
    assert formatting.si(2.5e-5, 5e-6, "s") == "25 ± 5 µs"
    assert formatting.si(4.0, math.nan, "N m") == "4.00 N m"
    assert formatting.direction(math.radians(271.0), math.radians(2.0), math.pi) == "91 ± 2° (modulo 180°)"
    none = formatting.direction(math.radians(-0.004), math.radians(0.03), math.pi)
    assert none == "0.00 ± 0.03° (modulo 180°)"
    assert formatting.direction(math.radians(271.0), math.radians(2.0), 2 * math.pi) == "271 ± 2°"


@given(st.text())
def test_nothing_stays_hidden_in_a_text(text: str) -> None:
    shown = formatting.visible(text)
    assert shown.isprintable()
    assert "".join(c for c in text if c.isprintable()) in shown or not text.isprintable()


def test_a_long_text_is_cut_off_after_it_was_spelled_out() -> None:
    assert formatting.visible("a\u202eb\x07\u200fé") == "a\\u202eb\\x07\\u200fé"
    assert formatting.visible("x" * 10_000, 2000) == "x" * 1999 + "…"
    assert formatting.visible("\0" * 10, 10) == "\\x00\\x00\\…"
    assert formatting.visible("µ \udc80\0", 2000) == "µ \\udc80\\x00"


def test_json_holds_null_for_what_is_not_finite_and_no_type_of_numpy() -> None:
    value = {"a": (np.float64(1.5), math.nan), "b": np.array([[1.0, math.inf]]), "c": np.bool_(True), "d": 3}
    found = formatting.json_ready(value | {"e": None, "f": "nan", "g": np.int64(4)})
    assert found == {"a": [1.5, None], "b": [[1.0, None]], "c": True, "d": 3, "e": None, "f": "nan", "g": 4}
    assert json.loads(json.dumps(found, allow_nan=False)) == found


def test_what_is_not_all_is_not_told_as_all() -> None:
    shares = (0.9997, 1.0, 0.99951, 0.9994, -0.00001, math.nan)
    told = ["99.9 %", "100.0 %", "99.9 %", "99.9 %", "0.0 %", "–"]
    assert [formatting.percent(share) for share in shares] == told
    assert [formatting.percent(share, 0) for share in (0.997, 1.0, 0.5)] == ["99 %", "100 %", "50 %"]
    assert formatting.percents(0.975, 0.99999) == "97.5 to 99.9 %"
