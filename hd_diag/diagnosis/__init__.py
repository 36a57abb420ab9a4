"""Measured data against the model: what it gets wrong, the cause, the extended model, the gain.

The flow: ``record`` (clean, split into runs) -> ``refit`` (the model's own parameters, globally) ->
``noise`` (what is left at least) -> ``search`` (causes from the catalogue, one by one: ``ranking`` of the
candidates, ``acceptance`` of the best, ``causes`` with their numbers) -> ``testability`` and
``unexplained`` (what cannot be said) -> ``diagnosis`` (all of it, with the gain on data that nothing was
fitted to).
"""
