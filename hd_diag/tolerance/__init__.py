"""What errors of assembly a drive may have: limits on the eccentricity, and what a tolerance yields.

``moments`` the quantities of many moments at once · ``criteria`` which of them are judged · ``limit`` the
eccentricity at which a criterion is first exceeded · ``assembly`` assemblies drawn from tolerances and the
share within the limits · ``sensitivity`` which tolerance matters · ``study`` all of it for one joint.
"""
