"""Measured data against the model: what it gets wrong, the cause, the extended model, the gain.

The flow: ``record`` (cleaned, split into runs) -> ``screening`` (``findings``: wrong signals, units or ratio,
skipped teeth) -> ``subsampling`` (of long records) -> ``fit`` (the model's own parameters, globally;
``noise``) -> ``search`` (causes from the catalogue, one by one: ``ranking`` of the candidates, ``acceptance``
of the best, ``exchange`` of those chosen for better ones, ``causes`` with their numbers; ``unexplained``
parts) -> ``diagnosis`` (all of it, with the gain on data that no fit saw, ``detectability`` of what is not
named) -> ``judgement`` -> ``verdict``. Beside it: ``orders_only`` without a tooth model, ``ripple`` of a
torque.
"""
