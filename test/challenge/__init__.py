"""Test records of a harmonic drive with known faults, made without any code under test.

Flanks are polylines, and contact is found by comparing them point by point. Faults enter as geometry or
mechanics: displaced slots, worn teeth, slip elements, delayed streams. No module here may import hd_diag.
The code follows the statement of the problem, not the formulas of the package.

Conventions, for a ratio of +100: the wave generator turns by theta_W = -theta_in; the transmission error is
theta_out - theta_in/100 = beta(theta_W, -T) - cup T + offset. T is the torque that the drive exerts on the
link [N m]; beta(theta_W, M) is the torsion at which the flanks hold a cup torque M. SI units, angles [rad].
"""
