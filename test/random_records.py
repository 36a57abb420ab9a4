"""Random records as joints, loggers and spreadsheets give them: a seed gives a file and a command."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

_PAGES = (
    "--size 25 --ratio 100 --rated-torque 56 --k1 31e3 --k2 50e3 --k3 57e3",
    "--size 14 --ratio 50 --rated-torque 6.89 --k1 4580 --k2 7330 --k3 8470",
    "--size 65 --ratio -50 --rated-torque 952 --k1 63e4 --k2 101e4 --k3 117e4",
    "--size 17 --ratio 81 --rated-torque 15.5 --k1 10500 --k2 16900 --k3 19500 --output circular_spline",
)
GEARS = tuple(tuple(page.split()) for page in _PAGES)
"""Options of ``hd-diag gear``: several sizes, both outputs, a negative ratio."""

_RATIOS, _RATED = (100.0, 50.0, -50.0, 81.0), (56.0, 6.89, 952.0, 15.5)
_MOST_ROWS = 1400


class Case(NamedTuple):
    """A verb with its options except for the configuration, and the index of the gear in `GEARS`."""

    arguments: tuple[str, ...]
    gear: int


Columns = dict[str, np.ndarray]


def case(seed: int, folder: Path) -> Case:
    """Write a record into a folder and return the command for it."""
    rng = np.random.default_rng(seed)
    gear = int(rng.integers(len(GEARS)))
    columns = _motion(rng, _RATIOS[gear], _RATED[gear])
    for change in rng.choice(len(_CHANGES), int(rng.choice((0, 1, 2, 3), p=(0.1, 0.4, 0.3, 0.2))), False):
        columns = _CHANGES[change](columns, rng)
    file = folder / f"record_{seed}.csv"
    _write(file, columns, rng)
    return Case(_command(file, columns, rng), gear)


def _motion(rng: np.random.Generator, ratio: float, rated: float) -> Columns:
    """Equal moves with rests between them, at one rate, with a few waves and some noise."""
    rate, rows = float(np.exp(rng.uniform(*np.log((5.0, 5000.0))))), int(np.exp(rng.uniform(5.2, 7.2)))
    rows = min(rows, _MOST_ROWS)
    time = np.arange(rows) / rate
    move, rest = np.exp(rng.uniform(-3.0, 3.0, 2)) * rng.choice((0.02, 0.2, 1.0))
    phase = np.mod(time, move + rest)
    moving = (phase < move) & (time > rng.choice((0.0, 0.0, 0.9)) * time[-1])
    turn = np.where(np.floor(time / (move + rest)) % 2 == 0, 1.0, rng.choice((-1.0, 1.0)))
    speed = np.exp(rng.uniform(0.0, 6.0)) * np.where(moving, turn, 0.0)
    angle = np.cumsum(speed) / rate + rng.uniform(-1e3, 1e3)
    torque = rated * rng.uniform(0.0, 1.0) * np.sin(angle / ratio + rng.uniform(0.0, 6.0))
    error = rng.uniform(0.0, 4e-4) * np.cos(2.0 * angle) - torque / (600.0 * rated)
    noise = rng.choice((0.0, 1e-7, 1e-5, 1e-3)) * rng.standard_normal((3, rows))
    output = angle / ratio + error + noise[0]
    heat = 25.0 + 10.0 * time / time[-1] if rows > 1 else np.full(rows, 25.0)
    return {"t": time, "x": angle + noise[1], "y": output, "q": torque + rated * noise[2], "h": heat}


def _any(columns: Columns, rng: np.random.Generator, names: str = "txyqh") -> str:
    return str(rng.choice([name for name in names if name in columns]))


def _with(columns: Columns, name: str, values: np.ndarray) -> Columns:
    return {**columns, name: np.asarray(values, dtype=np.float64)}


def _constant(columns: Columns, rng: np.random.Generator) -> Columns:
    name = _any(columns, rng)
    value = float(rng.choice((0.0, 1.0, -1e-310, 5e-324, columns[name][0], 1e5)))
    return _with(columns, name, np.full(columns[name].size, value))


def _no_number(columns: Columns, rng: np.random.Generator) -> Columns:
    name, value = _any(columns, rng), float(rng.choice((np.nan, np.inf, -np.inf)))
    rows = rng.random(columns[name].size) < rng.choice((0.01, 0.3, 0.6, 1.0))
    return _with(columns, name, np.where(rows, value, columns[name]))


def _scaled(columns: Columns, rng: np.random.Generator) -> Columns:
    name = _any(columns, rng)
    factor = float(rng.choice((-1.0, 1e-300, 1e-9, 1e-3, 57.3, 1e3, 1e6, 1e9, 1e15, 1e300)))
    with np.errstate(over="ignore"):
        return _with(columns, name, factor * columns[name])


def _shuffled(columns: Columns, rng: np.random.Generator) -> Columns:
    time = columns["t"].copy()
    some = np.flatnonzero(rng.random(time.size) < rng.choice((0.01, 0.2, 1.0)))
    time[some] = time[rng.permutation(some)]
    return _with(columns, "t", time)


def _equal_stamps(columns: Columns, rng: np.random.Generator) -> Columns:
    step = float(rng.choice((2.0, 3.0, 10.0, 100.0))) * max(float(np.ptp(columns["t"])), 1.0)
    every = step / columns["t"].size
    return _with(columns, "t", np.floor(columns["t"] / every) * every)


def _later(columns: Columns, rng: np.random.Generator) -> Columns:
    return _with(columns, "t", columns["t"] + rng.choice((-5e8, 1.7e9, 8e9)))


def _gaps(columns: Columns, rng: np.random.Generator) -> Columns:
    time = columns["t"].copy()
    for at in rng.integers(0, max(time.size, 1), int(rng.choice((1, 5, 200)))):
        time[at:] += np.exp(rng.uniform(-5.0, 8.0))
    return _with(columns, "t", time)


def _still(columns: Columns, rng: np.random.Generator) -> Columns:
    """Hold all but a few rows at rest."""
    count = columns["t"].size
    held = np.minimum(np.arange(count), int(count * rng.choice((0.0, 0.01, 0.1, 0.5))))
    return {name: column if name in "th" else column[held] for name, column in columns.items()}


def _held(columns: Columns, rng: np.random.Generator) -> Columns:
    """Repeat values for some rows: in one column, or in all but the stamps."""
    count, rows = columns["t"].size, int(rng.choice((2, 5, 50)))
    held, names = np.arange(count) // rows * rows, rng.choice(("x", "y", "q", "xyqh"))
    return {name: column[held] if name in names else column for name, column in columns.items()}


def _counted(columns: Columns, rng: np.random.Generator) -> Columns:
    name, step = _any(columns, rng, "xyq"), 2.0 * np.pi / 2.0 ** int(rng.integers(4, 20))
    return _with(columns, name, np.round(columns[name] / step) * step)


def _wrapped(columns: Columns, rng: np.random.Generator) -> Columns:
    name = _any(columns, rng, "xy")
    return _with(columns, name, np.mod(columns[name], 2.0 * np.pi))


def _swapped(columns: Columns, _: np.random.Generator) -> Columns:
    return {**columns, "x": columns["y"], "y": columns["x"]}


def _cut(columns: Columns, rng: np.random.Generator) -> Columns:
    count = int(rng.choice((0, 1, 2, 3, 10, 199, 201, 230)))
    return {name: column[:count] for name, column in columns.items()}


def _recordings(columns: Columns, rng: np.random.Generator) -> Columns:
    """Split into recordings of a few rows each."""
    number = np.arange(columns["t"].size) // int(rng.choice((1, 2, 5, 30, 400)))
    return {**columns, "r": number.astype(np.float64)}


def _spikes(columns: Columns, rng: np.random.Generator) -> Columns:
    name = _any(columns, rng, "xyq")
    rows = rng.random(columns[name].size) < 0.02
    return _with(columns, name, np.where(rows, rng.choice((0.0, 10.0, 1e6)), columns[name]))


def _noise_alone(columns: Columns, rng: np.random.Generator) -> Columns:
    name = _any(columns, rng, "xyq")
    return _with(columns, name, rng.standard_normal(columns[name].size))


_CHANGES: Sequence[Callable[[Columns, np.random.Generator], Columns]] = (
    _constant,
    _no_number,
    _scaled,
    _shuffled,
    _equal_stamps,
    _later,
    _gaps,
    _still,
    _held,
    _counted,
    _wrapped,
    _swapped,
    _cut,
    _recordings,
    _spikes,
    _noise_alone,
)


def _write(file: Path, columns: Columns, rng: np.random.Generator) -> None:
    digits = str(rng.choice((".17g", ".12g", ".6g")))
    lines = [",".join(columns)]
    lines += [",".join(format(value, digits) for value in row) for row in zip(*columns.values(), strict=True)]
    file.write_text("\n".join(lines) + rng.choice(("\n", "")))


def _command(file: Path, columns: Columns, rng: np.random.Generator) -> tuple[str, ...]:
    verb = str(rng.choice(("diagnose", "report", "ripple"), p=(0.55, 0.25, 0.2)))
    unit = str(rng.choice(("", "[A]*1", "[A]*0.3", "[mA]"), p=(0.7, 0.1, 0.1, 0.1)))
    given = {
        "time": "t",
        "input": "x",
        "output": "y",
        "torque": f"q{unit}",
        "temperature": "h",
        "record": "r",
    }
    given["input"] += str(rng.choice(("", "[rad/s]", "[rpm]", "[deg]"), p=(0.85, 0.05, 0.05, 0.05)))
    left_out = set() if "r" in columns else {"record"}
    left_out |= {name for name, share in _LEFT_OUT.items() if rng.random() < share}
    pairs = ",".join(f"{name}={column}" for name, column in given.items() if name not in left_out)
    more = ["--columns", pairs]
    if "time" in left_out:
        more += ["--rate", "100"]
    if verb != "ripple":
        more += ["--time-limit", str(rng.choice(("0", "0.5", "1")))]
    if verb == "report":
        more += ["--out", str(file.with_suffix(".html"))]
    if verb == "diagnose":
        extra = {"--model": ".model", "--report": ".html", "--json": ".json"}
        if rng.random() < 0.2:
            more, extra = [*more, "--orders-only"], {"--json": ".json"}
        for option, suffix in extra.items():
            if rng.random() < 0.4:
                more += [option, str(file.with_suffix(suffix))]
    return (verb, str(file), *more)


_LEFT_OUT = {"time": 0.04, "input": 0.04, "output": 0.06, "torque": 0.15, "temperature": 0.6}
