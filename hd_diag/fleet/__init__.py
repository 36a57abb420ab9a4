"""Many bags: every joint of every bag diagnosed in parallel, kept as a table, and what changes over time.

A run goes through four steps: `survey` reads which joints each bag holds, `rows` judges one joint of one bag
(the same functions as ``hd-diag diagnose``), `store` keeps each result as it comes, `trend` looks at the rows
over time. The first two run in parallel, on this machine (`process_pool`) or on many (`cluster`).
"""
