"""Errors of assembly that a drive may have: limits on the eccentricity, and the yield of a tolerance.

``evaluation`` criteria of many moments at once (compiled in ``kernel``) · ``limit`` the eccentricity at which
a criterion is first exceeded · ``assembly`` assemblies drawn from tolerances and the share within the limits
· ``sensitivity`` which tolerance matters · ``study`` all of it for one joint, and as JSON.
"""
