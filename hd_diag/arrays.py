"""Names of array types: what the columns and tables of this package hold."""

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
Integers = npt.NDArray[np.int64]
Times = npt.NDArray[np.int64]
"""[ns]"""
Rows = npt.NDArray[np.bool_]
"""Mask that selects rows."""
Bytes = npt.NDArray[np.uint8]
Steps = npt.NDArray[np.int16]
"""Whole steps of a quantity: the tables of a torsion map."""
Singles = npt.NDArray[np.float32]
