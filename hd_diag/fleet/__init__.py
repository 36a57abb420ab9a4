"""Many bags: every joint of every bag diagnosed in parallel, kept as a table, and what changes over time.

`run` finds the bags and surveys and judges them in parallel, on processes of this machine
(`hd_diag.process_pool`) or on many machines (`cluster`). `rows` diagnoses one joint of one bag with the
functions of ``hd-diag diagnose``, `journal` keeps each result as it comes, `table` writes them all, `series`
and `trend` look at them over time, `standing` tells how each joint stands; `summary`, `plots` and
`health_page` show that.
"""


class FleetError(RuntimeError):
    """A run that cannot begin or go on; the text says why in one line."""
