"""A drive from its catalogue page: similar to one whose teeth are known, as stiff as the page says."""
