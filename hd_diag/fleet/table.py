"""The table of a fleet: one row for each joint of each bag, as Parquet with units in the column names."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from hd_diag.fleet.rows import FITTED, SCHEMA, Row, readable

_TEXT, _NUMBER, _COUNT, _FLAG = pa.string(), pa.float64(), pa.int64(), pa.bool_()
_TEXTS, _NUMBERS = pa.list_(_TEXT), pa.list_(_NUMBER)
_TIME = pa.timestamp("us", tz="UTC")
_RMS, _BY_FRAME, _OF_OUTPUT = "rad rms at the output", "1/turn or Hz by the frame", "1/turn of the output"


def _column(name: str, kind: pa.DataType, unit: str, about: str) -> pa.Field:
    return pa.field(name, kind, metadata={"unit": unit, "about": about})


COLUMNS = pa.schema(
    [
        _column("bag", _TEXT, "", "the bag, as it was given"),
        _column("robot", _TEXT, "", "which robot, by --robot"),
        _column("joint", _TEXT, "", "name in the configuration; null where a bag has no usable joint"),
        _column("start", _TIME, "UTC", "first log time of the bag, to the microsecond"),
        _column("duration_s", _NUMBER, "s", "time covered by the runs"),
        _column("samples", _COUNT, "1", "samples judged"),
        _column("refused", _COUNT, "1", "samples left out: unreadable, impossible, or by their stamps"),
        _column("last_refusal", _TEXT, "", "why the last of them was left out"),
        _column("runs", _COUNT, "1", "runs in the bag"),
        _column("input_turns", _NUMBER, "1", "turns of the input, both directions counted"),
        *(
            _column(name.format(end), _NUMBER, unit, f"{whose}{about}")
            for name, unit, about in FITTED.values()
            for end, whose in (("", ""), ("_std", "its standard deviation: "))
        ),
        _column("trustworthy", _FLAG, "", "whether one set of refitted parameters is clearly the best"),
        _column("causes", _TEXTS, "", "causes found, most explaining first"),
        _column("cause_classes", pa.list_(_TEXTS), "", "names that the record cannot tell from each cause"),
        _column("cause_amplitudes_rad", _NUMBERS, _RMS, "of each cause"),
        _column("cause_amplitude_stds_rad", _NUMBERS, _RMS, "their standard deviations"),
        _column("cause", _TEXT, "", "the first cause"),
        _column("cause_amplitude_rad", _NUMBER, _RMS, "of the first cause"),
        _column("cause_gain", _NUMBER, "1", "share of the held-out deviance that the first cause explains"),
        _column("cause_gain_low", _NUMBER, "1", "lower end of its interval"),
        _column("cause_gain_high", _NUMBER, "1", "upper end of its interval"),
        _column("cause_p_value", _NUMBER, "1", "corrected for all candidates"),
        _column("tested", _TEXTS, "", "causes that the record could have shown"),
        _column("tested_least_rad", _NUMBERS, _RMS, "least size of each, named with 99 % chance"),
        _column("rms_nominal_rad", _NUMBER, "rad", "held-out residual, simulation as configured"),
        _column("rms_refit_rad", _NUMBER, "rad", "held-out residual, parameters refitted"),
        _column("rms_extended_rad", _NUMBER, "rad", "held-out residual, with the causes found"),
        _column("noise_floor_rad", _NUMBER, "rad", "rms of the noise"),
        _column("noise_floor_low_rad", _NUMBER, "rad", "lower end of its 95 % interval"),
        _column("noise_floor_high_rad", _NUMBER, "rad", "upper end of its 95 % interval"),
        _column("fraction_explained", _NUMBER, "1", "of the nominal mean square, by the extended model"),
        _column("fraction_explained_low", _NUMBER, "1", "lower end of its 95 % interval"),
        _column("fraction_explained_high", _NUMBER, "1", "upper end of its 95 % interval"),
        _column("unexplained_orders", _NUMBERS, _BY_FRAME, "lines that no known cause explains"),
        _column("unexplained_frames", _TEXTS, "", "input, output (orders per turn) or time (Hz) of each"),
        _column("unexplained_amplitudes_rad", _NUMBERS, "rad", "amplitude of each"),
        _column("ripple_orders", _NUMBERS, _OF_OUTPUT, "of a joint with one angle: its torque's lines"),
        _column("ripple_reverses", pa.list_(_FLAG), "", "whether each changes its sign with the direction"),
        _column("ripple_amplitudes_Nm", _NUMBERS, "N m", "amplitude of each, found or not"),
        _column("ripple_stds_Nm", _NUMBERS, "N m", "their standard deviations"),
        _column("ripple_found", pa.list_(_FLAG), "", "whether each stands out of noise"),
        _column("findings", _TEXTS, "", "what comes before the model: ratio, skipped teeth, ramps"),
        _column("verdict", _TEXT, "", "one sentence"),
        _column("error", _TEXT, "", "why it could not be judged; null where it was"),
        _column("problems", _TEXTS, "", "what is unfinished about the bag's files"),
        _column(
            "state", _TEXT, "", "green, amber, red or not_judged: its light, or worse by limits and gaps"
        ),
        _column("light", _TEXT, "", "traffic light of its own page, as of hd-diag diagnose"),
        _column("advice", _TEXT, "", "what to do, as hd-diag diagnose says"),
        _column("judgement", _TEXT, "", "kind of the answer, as of hd-diag diagnose --json"),
        _column("error_rad", _NUMBER, "rad", "transmission error without torsion, peak to peak"),
        _column("error_std_rad", _NUMBER, "rad", "its standard deviation"),
        _column("accuracy_rad", _NUMBER, "rad", "what the catalogue allows it to be"),
        _column("eccentricity_allowed_m", _NUMBER, "m", "eccentricity that the assembly may have"),
        _column("eccentricity_criterion", _TEXT, "", "criterion of hd-diag tolerance that sets the limit"),
        _column("inspect", _TEXTS, "", "what to look at in the joint"),
        _column("bag_duration_s", _NUMBER, "s", "from the first to the last message of the bag"),
        _column("page", _TEXT, "", "file with its own page, by --report"),
        _column("bag_sha256", _TEXT, "", "of the bag's contents"),
        _column("config_sha256", _TEXT, "", "of the joint's parameters that a diagnosis uses"),
        _column("hd_diag_version", _TEXT, "", "of the worker that judged"),
        _column("python_version", _TEXT, "", "the same"),
        _column("numpy_version", _TEXT, "", "the same"),
        _column("scipy_version", _TEXT, "", "the same"),
        _column("numba_version", _TEXT, "", "the same; null where numba was not used"),
    ],
    metadata={"schema": SCHEMA},
)
"""Schema of the Parquet file, every column with unit and meaning in its metadata."""


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows as Parquet; raises OSError if they cannot be written."""
    stored = [{name: readable(value) for name, value in row.items()} for row in rows]
    for row in stored:
        row["start"] = row["start"] // 1000 if row.get("start") is not None else None
    table = pa.Table.from_pylist(stored, schema=COLUMNS)
    with path.open("wb") as file:
        pq.write_table(table, file, compression="zstd")
