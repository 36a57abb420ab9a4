"""A drive from its catalogue page: similar to one with known teeth, with the page's stiffness."""
