"""The light half: press blocks, keep what the sensor gave, and analyse it. Nothing here imports a CAD package.

Import from here; every name is loaded when it is first used, so this import costs nothing::

    from tacbench_cad.lab import Collection, Run, read_study, simulate_study, variance_table

* a study: :func:`read_study`, :class:`Study`, :class:`Protocol`, :func:`plan_presses`
* a rig: :func:`open_rig`, :class:`Stage`, :class:`Gauge`, :class:`Sensor`, :class:`RigError`
* a data run: :func:`acquire_study`; without hardware :func:`simulate_study`
* its folders: :class:`Run`, :func:`find_runs`, :func:`check_run`
* the same for other tools and for everyone: :func:`export_runs`, :func:`export_tactile_data`, :func:`publish`
* anybody's frames as run folders: :func:`import_samples`
* what a camera sees: :func:`find_region`, :class:`MarkerFinder`, :class:`MarkerTracker`
* the analysis: :class:`Collection`, :func:`variance_table`, :func:`grade`, :func:`classify`, :func:`compare`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
