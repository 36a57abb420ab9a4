"""Pictures for people: one module each, pure functions from arrays to a matplotlib figure.

No picture knows a file, a ROS type or a name out of a bag. Arrays are SI; a picture scales them to what
people read (µm, arcsec, degrees) where it draws. Every figure is made for the width of a phone and scaled up
elsewhere.
"""
