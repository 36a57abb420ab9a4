"""All faults: those of the catalogue, by its names, and those that no catalogue has."""

from __future__ import annotations

from challenge.cause import Cause
from challenge.drive_causes import (
    BearingPassage,
    CoulombWindup,
    CouplingMisalignment,
    Hysteresis,
    Resonance,
    ThermalDrift,
    TorsionalHardening,
    ViscousWindup,
)
from challenge.mesh_causes import (
    CircularSplineForm,
    CircularSplinePitch,
    FlexsplinePitch,
    ToothDamage,
    ToothSkip,
    WearBacklash,
)
from challenge.sensor_causes import (
    EncoderInterpolation,
    InputEncoderEccentricity,
    OutputEncoderEccentricity,
    OutputRunout,
    RatioError,
    StreamDelay,
    TorqueOffset,
)
from challenge.unknown_causes import (
    BeltCreep,
    Cogging,
    EncoderSector,
    EvenTorque,
    FloorVibration,
    LooseHub,
    OneSidedRipple,
    OutputOrder,
    StrangeOrder,
    Unbalance,
    Unknown,
)

CATALOGUE: tuple[type[Cause], ...] = (
    OutputRunout,
    OutputEncoderEccentricity,
    CircularSplineForm,
    CouplingMisalignment,
    BearingPassage,
    CircularSplinePitch,
    FlexsplinePitch,
    ToothDamage,
    WearBacklash,
    TorsionalHardening,
    Hysteresis,
    CoulombWindup,
    ViscousWindup,
    InputEncoderEccentricity,
    EncoderInterpolation,
    StreamDelay,
    ThermalDrift,
    RatioError,
    ToothSkip,
    Resonance,
    TorqueOffset,
)
UNKNOWN: tuple[type[Unknown], ...] = (
    StrangeOrder,
    OneSidedRipple,
    Cogging,
    BeltCreep,
    EncoderSector,
    Unbalance,
    FloorVibration,
    EvenTorque,
    OutputOrder,
    LooseHub,
)
