"""Every number that decides what is said of a record, with where it comes from."""

from __future__ import annotations

import math

from hd_diag.formatting import ARCSEC

TEMPER = 1.0 / 3.0
"""Share of the log likelihood that counts: noise and shapes are approximate (Miller and Dunson, J. Am. Stat.
Assoc. 114, 2019). Calibrated once: causes stated with 99 % are right in 99 % of the development records."""

PRESENT = math.log(0.02)
"""Prior log odds of each cause: some twenty are known, and a joint with any is one in a few."""

LARGER = math.log(0.05)
"""The same of a remainder half a decade larger than usual, and of each further half: it needs no cause."""

LARGER_LINE = math.log(0.5)
"""The same of a line of the input's turn. Chosen, half as likely with each half decade: joints in the field
have 0.5 to 45 arcsec at twice the input."""

UNKNOWN = math.log(0.02)
"""The same of a shape without a known cause."""

NAMED, HINTED = 0.99, 0.5
"""Probability from which a class is named, and from which it is a hint: one false alarm in a hundred."""

ODDS = math.log(NAMED / (1.0 - NAMED))
"""Log odds of the first."""

LEAST_SIZE = 0.5 * ARCSEC
"""Own part that a cause must have [rad rms]: less than any joint's lines have as a rule asks for nothing."""

USUAL_TORSION = 0.1
"""Change of the compliance from torque to torque, by which gears of one page differ: catalogues allow ten to
twenty per cent."""

USUAL_LINE, USUAL_SLOW = LEAST_SIZE, 0.3 * ARCSEC
"""What is usual of a line and of the slow remainders [rad]: a new gear of one arcminute has waves of one to
two arcsec, and so have bearings, mounts and zeros."""

USUAL_LOOP = 60.0 * ARCSEC
"""Lost motion between both ways that is usual [rad]: the arcminute that catalogues allow."""

LARGER_BY = (1.0, 3.0, 10.0, 30.0, 100.0)
"""Sizes of a remainder over its usual one, half a decade apart: between two, the evidence changes little."""

LOOP_BY = LARGER_BY[:4]
"""The same of the loop. Its four elements have about the usual lost motion then: a larger one is a cause."""

SLOW = (0.0, 0.3, 1.0, 3.0, 10.0)
"""Sizes of the slow noise over the innovation: what no model describes."""

SLOW_NOISE = -10.0
"""Prior log odds of any. Calibrated: in 20 s of white noise alone it seems to bring 6, in a minute none."""

SLOW_FOR = (0.1, 0.3, 1.0)
"""How long it lasts [s]: longer, it is a drift."""

SIZES = (0.1, 0.3, 1.0, 3.0, 10.0)
"""The same of a cause's prior width over its usual size."""

CLASS_SHARE = 0.99
"""Share of the probability of all causes that a class holds: the same convention."""

CERTAIN_SIZE = 2.326
"""Standard deviations below a size that leave 99 %."""

TWO_SIDED = 1.96
"""Standard deviations to either side of a value that make its 95 % interval."""

MOST_ALIKE = 5
"""Causes that a class may hold and still say something: a repair has to begin with one."""

UNPROVED = 10.0
"""Log odds within which a cause that the motion cannot show is in the class of one that fits better: its form
is known no better than that."""

DISAGREEING = 0.1
"""Share of what blocks foretell that may lie in blocks which it makes worse, where all count as agreeing."""

FORETOLD = (0.5, 2.0)
"""Size of a cause in blocks over what the others foretell of it, from and to which it stands. A block gains
nothing from less than half; the other end is as far to the other side, chosen."""

MISFIT = 1.3
"""What is left of held-out data, over the noise, from which it is not noise: chosen, beyond the tenth or two
to which records tell their noise."""

WORSE = 1.02
"""What a model with causes leaves as it runs, over what the parameters alone leave, from which it is worse:
chosen, beyond the thousandth or so by which models that are alike differ."""

MORE = 1.15
"""The same for the lower end of its interval, where its upper end is beyond that. At the gear's lines: from
here on what is left may be a part of a displacement."""

ANOTHER = 3.0
"""Standard deviations from its configured value from which a parameter is another: a convention."""

UNDONE = 0.5
"""Share of what a cause does that others may undo: chosen. Two that undo each other further are neither."""

NOT_BY_TORQUE = 0.1
"""Share of a cause that no function of the torque makes, from which torsion undoes none: chosen. Joints whose
torque goes with the place had a thirtieth where nothing was there, and a third of a true cause."""

NOTICED = 0.25
"""Share of the accuracy, peak to peak, from which a remainder that is larger than usual asks to be watched: a
convention. So does what is unexplained and no line."""
