"""Mechanics of a harmonic drive (strain wave gear) with wave generator eccentricity.

Pure functions of arrays. Lengths in metres, angles in radians, forces in newtons, torques in newton metres.

Frames
    Housing frame: origin on the circular spline's axis, angles counter-clockwise positive. The circular
    spline is fixed in it; slot 0 lies on its x axis.
    Tooth frame: origin on the flexspline's neutral layer, x outward along the tooth axis, y
    counter-clockwise.
    Slot frame: x outward along the slot axis, measured from the circular spline's datum radius.

Signs
    theta_W     angle of the wave generator's long axis [rad]
    theta_F     rotation of the flexspline; without error -theta_W (Z_G - Z_R) / Z_R [rad]
    flank +     the tooth's counter-clockwise flank; it closes when the cup turns counter-clockwise
    b           rotation of the cup that brings a flank into contact, in the flank's own direction [rad];
                negative: the flanks interfere; nan: they cannot touch
    beta        torsion: rotation of the cup under load, beta > 0 loads + flanks [rad]
    M           torque that turns the cup: sum of r cos(alpha) F over + flanks less that over - flanks [N m]
    alpha       pressure angle, positive where the flexspline pushes the circular spline outward [rad]
    E           housing eccentricity: displacement of the wave generator's centre, fixed in the housing [m]
    tilt        gamma e^(i chi): lean of its axis in the housing; its centre is at E + tilt z [rad]
    z           place of a section along the width from the middle one, positive to the open end [m]
    runout      part of that displacement that turns with the wave generator [m]
    s_0         arc offset of tooth 0 along the neutral curve [m]

Nomenclature
    c_k         harmonics of the neutral curve's support function R_b + sum c_k cos 2k mu [m]
    L           cup length, from its bottom, which stays round, to the middle section [m]
    R_b         radius of the circle as long as the neutral curve [m]
    Z_R, Z_G    numbers of teeth of the flexspline and the circular spline
    r_0         datum radius: origin of the slot's x [m]
    K1 + K2     compliance of a tooth pair: deflection per force [m/N]
    D = r b     circumferential backlash [m]

Source: H. Dong, T. Chen, D. Wang, B. Dong, Kinematic Model of Harmonic Drive in Robot Joints with Input
Eccentricity Error, ROMANSY 22, CISM 584, pp. 134-140, 2019, doi 10.1007/978-3-319-78963-7_18. The paper's
tables leave some numbers open; the place where such a number is defined says how it was read.
"""
