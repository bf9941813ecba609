"""Twins of objects: masses from recorded pushes, grasps and their trials, hands of people on robot hands, sim-ready assets, simulation.

Units are SI. World z is up. A pose is a row x, y, z, qw, qx, qy, qz (metres, unit quaternion) of a body's own frame in the world;
where poses go in, 4 x 4 matrices do too. Joint vectors have the order of ``joint_names``, rad.

What drex refuses is a ``drex.Error`` (a ``ValueError``), a file that cannot be read an ``OSError``; both say what to do. Long calls let
other threads run and can be interrupted. ``RAYON_NUM_THREADS`` limits their threads; results do not depend on it.
"""

import numpy as _numpy  # the compiled part needs it, and says less clearly that it is missing  # noqa: F401

from ._drex import (
    Asset,
    Batch,
    Busy,
    Command,
    Error,
    Grasp,
    Identification,
    Mass,
    MeshCheck,
    Motion,
    NoCommand,
    Outcome,
    Policy,
    PredictedGrasp,
    Prediction,
    Push,
    PushReport,
    Retargeter,
    Retargeting,
    Robot,
    Runner,
    Trial,
    TriedGrasp,
    Twin,
    __version__,
    find_grasp,
    identify,
    mesh_asset,
    mesh_check,
    retarget,
    simulate,
)

__all__ = [
    "Asset",
    "Batch",
    "Busy",
    "Command",
    "Error",
    "Grasp",
    "Identification",
    "Mass",
    "MeshCheck",
    "Motion",
    "NoCommand",
    "Outcome",
    "Policy",
    "PredictedGrasp",
    "Prediction",
    "Push",
    "PushReport",
    "Retargeter",
    "Retargeting",
    "Robot",
    "Runner",
    "Trial",
    "TriedGrasp",
    "Twin",
    "__version__",
    "find_grasp",
    "identify",
    "mesh_asset",
    "mesh_check",
    "retarget",
    "simulate",
]
