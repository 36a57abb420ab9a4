"""Test records of a harmonic drive whose faults are known, made without any of the code under test.

Flanks are polylines and contact is found by comparing them point by point; faults are put in as geometry or
mechanics: slots moved, teeth worn, slip elements, streams delayed. Nothing here may import hd_diag, and what
is here is written against the statement of the problem, not against the package's formulas.

Conventions, for a ratio of +100: the wave generator turns by theta_W = -theta_in; the transmission error is
theta_out - theta_in/100 = beta(theta_W, -T) - cup T + offset, T the torque that the drive exerts on the link
[N m] and beta(theta_W, M) the torsion at which the flanks hold a cup torque M. SI units, angles [rad].
"""
