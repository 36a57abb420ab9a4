"""How a cause is named: which known causes hold the probability, and what speaks against a name."""

import math

import pytest
from hypothesis import given
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


# Classes ---


def test_a_clear_winner_is_alone() -> None:
    alike, probability, chance = in_class(PLAIN, KNOWN)
    assert alike == ("hysteresis",)
    assert probability == pytest.approx(1.0 / (1.0 + 3.0 * math.exp(-20.0)), rel=1e-12)
    assert chance == pytest.approx(math.exp(-20.0), rel=1e-6)


def test_two_alike_are_one_class_the_better_first() -> None:
    alike, probability, _ = in_class({"hysteresis": 0.0, "coulomb_windup": 0.5, "": -20.0}, KNOWN)
    assert alike == ("coulomb_windup", "hysteresis")
    assert probability > NAMED


@pytest.mark.parametrize(("share", "expected"), [(0.5, 1), (2.0, 2)])
def test_a_class_ends_where_it_holds_nearly_all(share: float, expected: int) -> None:
    """Of two causes the lesser one belongs to it where the better one alone has less than that."""
    lesser = math.log(share * (1.0 - CLASS_SHARE) / CLASS_SHARE)
    assert len(in_class({"hysteresis": 0.0, "stream_delay": lesser, "": -40.0}, KNOWN)[0]) == expected


def test_a_shape_without_a_cause_takes_probability_and_is_no_name() -> None:
    alike, probability, chance = in_class({"hysteresis": 0.0, "creep": 0.0, "": -40.0}, KNOWN)
    assert alike == ("hysteresis",)
    assert probability == pytest.approx(0.5)
    assert chance < 1e-12


def test_none_may_win() -> None:
    alike, probability, chance = in_class({"hysteresis": 0.0, "": 3.0}, KNOWN)
    assert alike == ("hysteresis",)
    assert chance == pytest.approx(1.0 / (1.0 + math.exp(-3.0)))
    assert probability == pytest.approx(1.0 - chance)


def test_without_a_known_cause_there_is_no_class() -> None:
    assert in_class({"creep": 0.0, "": -3.0}, KNOWN)[:2] == ((), 0.0)


@given(
    st.dictionaries(
        st.sampled_from([*sorted(KNOWN), "creep", "rests", ""]), st.floats(-900.0, 900.0), min_size=1
    )
)
def test_a_class_is_the_fewest_that_hold_nearly_all_of_the_causes(values: dict[str, float]) -> None:
    alike, probability, chance = in_class(values, KNOWN)
    most = max(values.values())
    weight = {name: math.exp(value - most) for name, value in values.items()}
    causes, total = sum(weight[name] for name in KNOWN & set(values)), sum(weight.values())
    held = [weight[name] for name in alike]
    assert held == sorted((weight[name] for name in KNOWN & set(values)), reverse=True)[: len(alike)]
    assert sum(held) >= CLASS_SHARE * causes * (1.0 - 1e-12)
    assert not alike or sum(held[:-1]) < CLASS_SHARE * causes
    assert probability == pytest.approx(sum(held) / total)
    assert chance == pytest.approx(weight.get("", 0.0) / total)


# Doubts ---


def many(count: int) -> Standing:
    names = [f"cause_{number}" for number in range(count)]
    return Standing({**dict.fromkeys(names, 0.0), "": -20.0}, frozenset(names), 2.0 * LEAST_SIZE, 0.0)


def test_what_is_plain_has_no_doubt() -> None:
    assert standing().doubt == ""
    assert many(MOST_ALIKE).doubt == ""


def test_what_was_not_weighed_is_not_named() -> None:
    assert standing({"hysteresis": 0.0}, own=0.0).doubt == "there was no time to weigh it"


def test_what_is_not_probable_enough_is_not_named() -> None:
    share = math.log(NAMED / (1.0 - NAMED))
    assert standing({"hysteresis": 0.0, "": -1.01 * share}).doubt == ""
    doubt = standing({"hysteresis": 0.0, "": -0.9 * share}, own=0.0).doubt
    assert doubt == "its probability is 98.4 %, of 99 % asked for"


def test_what_explains_too_little_for_certain_is_not_named() -> None:
    assert standing(deviation=0.99 * LEAST_SIZE / CERTAIN_SIZE).doubt == ""
    doubt = standing(own=0.56 * ARCSEC, deviation=0.1 * ARCSEC).doubt
    assert doubt == "what it alone explains is 0.56 arcsec rms, and 0.50 arcsec for certain are asked for"


def test_too_many_alike_are_no_name() -> None:
    count, names = many(MOST_ALIKE + 1).doubt.split(" causes explain it alike: ")
    assert count == str(MOST_ALIKE + 1)
    assert sorted(names.split(", ")) == [f"cause {number}" for number in range(MOST_ALIKE + 1)]


def test_the_first_doubt_is_told() -> None:
    """Not weighed, not probable, too small, too many: each hides those after it."""
    every = {**dict.fromkeys((f"cause_{number}" for number in range(MOST_ALIKE + 1)), 0.0), "": 0.0}
    known = frozenset(every) - {""}
    assert Standing({"cause_1": 0.0}, known, 0.0, 0.0).doubt.startswith("there was no time")
    assert Standing(every, known, 0.0, 0.0).doubt.startswith("its probability")
    assert Standing({**every, "": -20.0}, known, 0.0, 0.0).doubt.startswith("what it alone explains")


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
