"""Naming of a cause: the class that holds the probability, and doubts about a name."""

import math
import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hd_diag.diagnosis.calibration import CERTAIN_SIZE, CLASS_SHARE, LEAST_SIZE, MOST_ALIKE, NAMED
from hd_diag.diagnosis.evidence.naming import Standing, in_class
from hd_diag.formatting import ARCSEC

KNOWN = frozenset(("hysteresis", "coulomb_windup", "stream_delay"))
PLAIN = {"hysteresis": 0.0, "coulomb_windup": -20.0, "creep": -20.0, "": -20.0}


def standing(
    values: dict[str, float] = PLAIN, own: float = 2.0 * LEAST_SIZE, deviation: float = 0.1 * LEAST_SIZE
) -> Standing:
    return Standing(values, KNOWN, own, deviation)


names = st.sampled_from([*sorted(KNOWN), "creep", "rests", ""])
SHARE = math.log((1.0 - CLASS_SHARE) / CLASS_SHARE)  # log odds at which the better cause just suffices


@given(st.dictionaries(names, st.floats(-900.0, 900.0) | st.floats(-6.0, 6.0), min_size=1))
@example({"hysteresis": 0.0, "stream_delay": SHARE - 0.01, "": -40.0})
@example({"hysteresis": 0.0, "stream_delay": SHARE + 0.01, "": -40.0})
@example({"hysteresis": 0.0, "creep": 0.0, "": 3.0})
@example({"creep": 0.0, "": -3.0})
def test_a_class_is_the_fewest_that_hold_nearly_all_of_the_causes(values: dict[str, float]) -> None:
    alike, probability, chance = in_class(values, KNOWN)
    most = max(values.values())
    weight = {name: math.exp(value - most) for name, value in values.items()}
    causes, total = sum(weight[name] for name in KNOWN & set(values)), sum(weight.values())
    held = [weight[name] for name in alike]
    assert held == sorted((weight[name] for name in KNOWN & set(values)), reverse=True)[: len(alike)]
    assert set(alike) <= KNOWN
    assert sum(held) >= CLASS_SHARE * causes * (1.0 - 1e-12)
    assert not alike or sum(held[:-1]) < CLASS_SHARE * causes
    assert probability == pytest.approx(sum(held) / total)
    assert chance == pytest.approx(weight.get("", 0.0) / total)


# Doubts ---


def many(count: int, own: float = 2.0 * LEAST_SIZE) -> Standing:
    names = [f"cause_{number}" for number in range(count)]
    return Standing({**dict.fromkeys(names, 0.0), "": -20.0}, frozenset(names), own, 0.1 * ARCSEC)


ENOUGH = math.log(NAMED / (1.0 - NAMED))


ASKED = "arcsec rms; certainly more than 0.50 arcsec is needed"


@pytest.mark.parametrize(
    ("made", "doubt"),
    [
        (standing(), ""),
        (many(MOST_ALIKE), ""),
        (standing({"hysteresis": 0.0}, own=0.0), "there was no time to weigh it"),
        (standing({"hysteresis": 0.0, "": -1.01 * ENOUGH}), ""),
        (
            standing({"hysteresis": 0.0, "": -0.9 * ENOUGH}, 0.0),
            "its probability is 98.4 %; 99 % is needed",
        ),
        (standing(deviation=0.99 * LEAST_SIZE / CERTAIN_SIZE), ""),
        (many(MOST_ALIKE + 1, 0.56 * ARCSEC), f"it alone explains 0.56 {ASKED}"),
        (many(MOST_ALIKE + 1), f"{MOST_ALIKE + 1} causes explain it equally well: cause 0, .*"),
    ],
)
def test_the_first_doubt_is_told(made: Standing, doubt: str) -> None:
    """Not weighed, not probable, too small to be certain, too many: each doubt hides the later ones."""
    assert re.fullmatch(doubt, made.doubt)


# In a misfit ---


def test_beside_a_misfit_evidence_weakens_by_its_square() -> None:
    before = standing({"coulomb_windup": 1.0, "hysteresis": 0.0, "": -9.0})
    after = before.beside(2.0)
    assert after.values == {"coulomb_windup": 1.0, "hysteresis": 0.75, "": -1.5}
    assert (after.own, after.deviation) == (before.own, 2.0 * before.deviation)
    assert after.chance > before.chance
    assert (before.doubt, after.doubt != "") == ("", True)


@pytest.mark.parametrize("misfit", [0.3, 1.0])
def test_less_than_the_noise_makes_nothing_surer(misfit: float) -> None:
    assert standing().beside(misfit) == standing()


@given(st.floats(1.0, 50.0), st.floats(1.0, 50.0))
def test_the_greater_the_misfit_the_less_probable_is_a_cause(one: float, other: float) -> None:
    less, more = (standing().beside(misfit) for misfit in sorted((one, other)))
    assert more.values[""] >= less.values[""]
    assert more.chance >= less.chance
    assert more.deviation >= less.deviation
