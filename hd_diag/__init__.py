"""Harmonic drives in robot joints: mesh model, live diagnostics and criticism of the model by data.

Two flows use the same columns, the same alignment and the same model::

    live     joint_states -> messages -> streams -> monitor -> messages -> ros: topics, diagnostics, log
    offline  bag -> messages -> streams -> diagnosis: record -> findings -> fit -> residual -> search for
             causes -> refit -> held-out gain -> verdict -> report

A replay is the live flow fed from a bag. Time is a message's stamp; a monotonic clock only times silence.

Rooms. Each imports only those above it:

=================== ===================================================================================
arrays              names of array types; also `formatting`, `memory`, `process_pool`, `whole_file`
model               the mechanics: frames and signs, geometry, contact, load sharing, torsion and its map
drive               one drive: a mesh in its frame, with ratio and rated torque
gears               a drive from its catalogue page, and the characteristics of a drive in a page's terms
effects             causes that the model leaves out
extended_model      a drive with causes
streams             columns of samples; input, output and torque aligned; clock rules
monitor             the running part: predictions, health, orders of the residual; rows in, rows out
diagnosis           errors of the model in a record, and their causes
config              parameters and files of them, as checked joints
messages            ROS messages as bytes, without ROS
bag                 reading, writing and recovering recordings
records             records of joints from bags and CSV files
public              functions that ``import hd_diag`` offers to a notebook
replay              events of a log, and the monitor over a bag
simulation          simulated joints, and bags of them
ros                 the node
tolerance           studies over many drives
report              a bag or a verdict on one page
fleet               studies over many bags, and the state of each joint
watch               a running node in the terminal
cli                 one module per verb
=================== ===================================================================================
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hd_diag.public import diagnose as diagnose
    from hd_diag.public import gear as gear
    from hd_diag.public import load as load
    from hd_diag.public import mesh_state as mesh_state
    from hd_diag.public import read as read
    from hd_diag.public import transmission_error as transmission_error
    from hd_diag.public import verdict as verdict

__version__ = "0.1.0"
__all__ = ["diagnose", "gear", "load", "mesh_state", "read", "transmission_error", "verdict"]


def __getattr__(name: str) -> Any:
    """A name of `hd_diag.public`, which is imported at the first use of one."""
    if name not in __all__:
        raise AttributeError(f"module 'hd_diag' has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module("hd_diag.public"), name)


def __dir__() -> list[str]:
    return [*globals(), *__all__]
