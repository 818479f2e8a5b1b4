"""Press printed blocks with a sensor, store the frames, and analyse them. Nothing here imports a CAD package.

Import the names from this module. Each name is loaded when it is first used, so the import is fast::

    from tacbench_cad.lab import HoldOut, Pixels, press, read, variance

* a rig: :class:`Rig`, :class:`Stage`, :class:`Gauge`, :class:`Sensor`, :class:`RigError`
* a data run with a rig: :func:`press`, :func:`acquire_study`; without hardware: :func:`simulate_study`
* a study file: :func:`read_study`, :class:`Protocol`
* the run folders: :class:`Run`, :func:`find_runs`, :func:`check_run`
* other people's frames as run folders: :func:`import_samples`
* presses as a table and as arrays: :func:`read`, :func:`frames`, :func:`iter_frames`
* for pipelines of scikit-learn: :class:`Pixels`, :class:`Forces`, :class:`HoldOut`
* the analysis: :func:`variance`, :func:`grade`, :func:`classify`, :func:`sweep`, :func:`compare`, :func:`report`
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
