"""Simulated records of a harmonic drive with known faults, made without any of the code under test.

Flanks are polylines, and comparing them point by point finds the contact. Faults enter as geometry or
mechanics: slots moved, teeth worn, slip elements, streams delayed. Nothing here may import hd_diag. This
code follows the statement of the problem, not the package's formulas.

Conventions, for a ratio of +100: the wave generator turns by theta_W = -theta_in. The transmission error is
theta_out - theta_in/100 = beta(theta_W, -T) - cup T + offset. T is the torque that the drive exerts on the
link [N m], beta(theta_W, M) the torsion at which the flanks hold a cup torque M. SI units, angles [rad].
"""
