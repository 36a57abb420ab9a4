"""A torque that is not this joint's is left out, and said."""

import dataclasses
import warnings

import numpy as np
from benches import CONFIGURED, swinging
from joint_records import columns, prepared

from hd_diag.diagnosis.diagnosis import diagnose
from hd_diag.diagnosis.gain import held_out
from hd_diag.diagnosis.screening import without_misleading_torque


def test_a_torque_of_another_joint_is_left_out() -> None:
    record = swinging(40.0)
    test, _ = held_out(record)
    other = 120.0 * np.sin(2.0 * np.pi * record.time / 2.3)
    unloaded = dataclasses.replace(record, output_angle=record.input_angle / 100.0, torque=other)
    blind, finding = without_misleading_torque(unloaded, CONFIGURED, test, np.random.default_rng(0))
    assert finding is not None
    assert (finding.name, finding.fatal, blind.has_torque) == ("torque_misleads", False, False)
    assert not blind.torque.any()
    assert finding.value > 1.3
    for kept in (
        record,
        dataclasses.replace(unloaded, torque=0.003 * other),  # it twists nothing
        dataclasses.replace(unloaded, by_current=True),  # most of it may be the motor's own friction
    ):
        same, finding = without_misleading_torque(kept, CONFIGURED, test, np.random.default_rng(0))
        assert finding is None
        assert same is kept


def test_an_input_encoder_far_off_its_centre_is_no_wrong_torque() -> None:
    """Fitted without it, the parameters of torsion imitate it and predict badly."""
    record = swinging(40.0)
    test, _ = held_out(record)
    read = 12e-3 * np.cos(record.input_angle - 2.0) + 4e-3 * np.cos(2.0 * record.input_angle + 1.0)
    off = dataclasses.replace(record, input_angle=record.input_angle + read)
    for seed in range(2):
        _, finding = without_misleading_torque(off, CONFIGURED, test, np.random.default_rng(seed))
        assert finding is None


def test_a_record_without_torque_is_judged_in_the_gap_between_the_flanks() -> None:
    """At no torque the model has no compliance: nothing may overflow, and the misfit is said."""
    record = prepared({name: column for name, column in columns(seconds=6.0).items() if name != "torque"})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = diagnose(record, CONFIGURED, np.random.default_rng(0))
    assert found.misfit is not None
    assert found.misfit.certain
    assert found.unexplained
