"""Every number that decides what a diagnosis says, with its origin."""

from __future__ import annotations

import math

from hd_diag.formatting import ARCSEC

TEMPER = 1.0 / 3.0
"""Power to which the likelihood is raised, because the noise model and the shapes are approximate (Miller and
Dunson, J. Am. Stat. Assoc. 114, 2019). Calibrated once: causes stated with 99 % probability are right in 99 %
of the development records."""

PRESENT = math.log(0.02)
"""Prior log odds of each cause: some twenty are known, and one joint in a few has any."""

LARGER = math.log(0.05)
"""Prior log odds of each half decade by which a remainder or a cause exceeds its usual size."""

LARGER_LINE = math.log(0.5)
"""The same for a line at an order of the input. Chosen: each half decade is half as likely. Joints in the
field have 0.5 to 45 arcsec at order 2 of the input."""

UNKNOWN = math.log(0.02)
"""Prior log odds of a shape without a known cause."""

NAMED, HINTED = 0.99, 0.5
"""Least probability of a named class, and of a hint. The first allows one false alarm in a hundred."""

ODDS = math.log(NAMED / (1.0 - NAMED))
"""Log odds of `NAMED`."""

LEAST_SIZE = 0.5 * ARCSEC
"""Least part that a named cause must explain alone [rad rms]. A smaller part asks for no action: the lines of
any joint are usually larger."""

USUAL_TORSION = 0.1
"""Usual relative change of the compliance with torque. Gears on one catalogue page differ by this much:
catalogues allow ten to twenty per cent."""

USUAL_LINE, USUAL_SLOW = LEAST_SIZE, 0.3 * ARCSEC
"""Usual size of a line and of the slow remainders [rad]. A new gear with an accuracy of one arcminute has
waves of one to two arcsec; bearings, mounts and encoder zeros contribute as much."""

USUAL_LOOP = 60.0 * ARCSEC
"""Usual lost motion between the two directions [rad]: the arcminute that catalogues allow."""

LARGER_BY = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Prior widths of a remainder over its usual size, half a decade apart. Between two widths the evidence
changes little."""

LOOP_BY = LARGER_BY[:4]
"""The same for the loop. At the largest, its four elements have about the usual lost motion: a larger loop is
a cause."""

SLOW = (0.0, 0.3, 1.0, 3.0, 10.0)
"""Standard deviations of the slow noise over that of the innovation. No model describes slow noise."""

SLOW_NOISE = -10.0
"""Prior log odds of any slow noise. Calibrated: in 20 s of pure white noise the evidence gains 6 by chance,
in a minute none."""

SLOW_FOR = (0.1, 0.3, 1.0)
"""Correlation times of the slow noise [s]. Slower noise is a drift."""

SIZES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""Prior widths of a cause over its usual size."""

CLASS_SHARE = 0.99
"""Share of the total probability of all causes that a class must hold: by convention, as `NAMED`."""

CERTAIN_SIZE = 2.326
"""Standard deviations below an estimate at which its one-sided 99 % bound lies."""

TWO_SIDED = 1.96
"""Standard deviations on each side of an estimate in its 95 % interval."""

MOST_ALIKE = 5
"""Largest number of causes in a named class. A larger class does not say where to begin a repair."""

UNPROVED = 10.0
"""A cause that the motion cannot show joins the class of a better fitting cause if its log odds are lower by
less than this, because its form is known no better."""

DISAGREEING = 0.1
"""Blocks that a cause makes worse may hold this share of the predicted gain; the blocks still agree."""

FORETOLD = (0.5, 2.0)
"""Limits of a cause's size in held-out blocks over the size that the other blocks predict. Below a half,
a block gains nothing. The upper limit was chosen as the inverse."""

MISFIT = 1.3
"""Ratio of the held-out residual to the noise above which the model misfits. Chosen above the uncertainty of
ten or twenty per cent with which records determine their noise."""

WORSE = 1.02
"""Ratio of residuals above which a running model with causes is worse than the parameters alone. Chosen above
the thousandth or so by which equivalent models differ."""

MORE = 1.15
"""A misfit is also suspected if its interval's lower end exceeds this and its upper end exceeds `MISFIT`. At
the gear's lines, a larger residual may hide part of a displacement."""

ANOTHER = 3.0
"""A parameter differs from its configured value beyond this many standard deviations: a convention."""

UNDONE = 0.5
"""Largest share of a cause that other causes may cancel. Chosen: if two cancel further, neither is real."""

NOT_BY_TORQUE = 0.1
"""If functions of the torque leave at least this share of a cause, torsion does not cancel it. Chosen: where
torque follows position, a thirtieth was left without a cause and a third with a true one."""

NOTICED = 0.25
"""A larger than usual remainder, or an unexplained part that is no line, is worth watching above this share
of the accuracy, peak to peak: a convention."""
