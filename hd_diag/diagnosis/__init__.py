"""Comparison of measured data with the model: residual, causes, extended model, gain.

The flow: ``record`` (cleaned, split into runs) -> ``screening`` (``findings``: wrong signals, units or ratio,
skipped teeth) -> ``subsampling`` (of long records) -> ``fit`` (the model's own parameters, globally;
``noise``) -> ``evidence`` (``search`` for causes of the catalogue one by one, in ``sets`` with their
evidence; ``naming`` of probable causes; ``solution`` with their numbers; ``unexplained`` parts) ->
``diagnosis`` (all steps, the gain on held-out data, ``detectability`` of effects that are not named) ->
``judgement`` -> ``verdict``. In addition: ``orders_only`` without a tooth model, ``ripple`` of a torque.
"""
